"""Latencies, errors of the gyro, field of the motors, and whether a robot drove, by fits of a turn.

The field's latency and the gyro's bias and scale are unknowns of the smoother, which also knows
rests and the accelerations of a drive. Its priors say that most sensors have small errors. They are
removed from the posterior, so that an error is reported only if the samples determine it.

The accelerometer's latency is that of gravity, which is constant in the world, in the fit of the
axes (`AlignmentFit`). The accelerometer's lever arm is fitted with it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from magcal_ros.core.doctor.alignment import (
    LAG,
    PARAMETERS,
    START_NOISE,
    AlignmentFit,
    inefficiency,
    noise_of,
)
from magcal_ros.core.doctor.axes_hypotheses import AxesHypothesis, per_metre
from magcal_ros.core.doctor.doctor_tuning import AXES, TURN, WIDE
from magcal_ros.core.doctor.prepared import liveliest, segment_of_log
from magcal_ros.core.errors import Refusal
from magcal_ros.core.geometry.arrays import FloatArray, interpolated, running_mean
from magcal_ros.core.geometry.attitude import STANDARD_GRAVITY, usual_size
from magcal_ros.core.knowledge import CLEAR, Belief, Knowledge, in_level_axes
from magcal_ros.core.samples.window import Steps, Window
from magcal_ros.core.smoother.kinds_of_motion import EVIDENCE_WEIGHT, Smoothed, smooth
from magcal_ros.core.smoother.unknowns import AT, BODY_FIELD, DRIVES, MICROTESLA, USUAL


@dataclass(frozen=True, eq=False)
class TurnFit:
    """Errors of the sensors, motors and kind of motion by the smoother's fit of a turn."""

    latency: Belief  # of the field, seconds
    bias: FloatArray  # of the gyro, rad/s, body axes, shape (3,)
    bias_sigma: float  # rad/s, largest of all axes
    scale: Belief  # relative error of the gyro's scale about z
    motors: FloatArray | None
    """Field of the motors in body axes while the robot turns, tesla; None without a rest. (3,)."""
    motors_sigma: float  # tesla, largest over all directions
    drove: bool  # whether the robot drove in its turns
    log_odds: float  # log evidence of the hypothesis by the smoother

    def in_axes(self, rotation: FloatArray) -> TurnFit:
        """Return the same errors in rotated body axes."""
        motors = None if self.motors is None else rotation @ self.motors
        return replace(self, bias=rotation @ self.bias, motors=motors)


def fit_turn(hypothesis: AxesHypothesis, knowledge: Knowledge, up_is_down: bool) -> TurnFit | None:
    """Return the fit of a log by a hypothesis; None if it is refused.

    The smoother interpolates the rotation between its nodes, which is inexact for a large latency.
    If the hypothesis clearly has one, it is subtracted from the stamps.
    """
    lag = float(hypothesis.state[LAG])
    if abs(lag) <= max(AXES.settled, CLEAR * float(hypothesis.sigma[LAG])):
        lag = 0.0
    window = _window(hypothesis, lag, up_is_down)
    if window is None:
        return None
    # The field is already in body axes.
    nominal = replace(knowledge.mounting, gains=np.ones(3), pose=np.eye(3))
    return _fit_window(window, replace(knowledge, mounting=nominal), lag)


@in_level_axes
def _fit_window(window: Window, knowledge: Knowledge, lag: float) -> TurnFit | None:
    """Return the fit of a window, from whose stamps a latency (s) was subtracted."""
    try:
        best = smooth(window, knowledge)
    except Refusal:
        return None
    late, scale = _by_samples(best, "latency"), _by_samples(best, "gyro_matrix", 8)
    biases = [_by_samples(best, "gyro_bias", axis) for axis in range(3)]
    return TurnFit(
        Belief(lag + late.value, math.hypot(late.sigma, TURN.least)),
        np.array([each.value for each in biases]),
        max(each.sigma for each in biases),
        scale,
        *_motors(best),
        _drove(best),
        _log_odds(best),
    )


def _log_odds(found: Smoothed) -> float:
    """Return the log evidence of all kinds of motion together."""
    own = math.log(USUAL.get(found.mode, 1.0) / found.weights[found.mode])
    return own - EVIDENCE_WEIGHT * found.fit.evidence


def _window(hypothesis: AxesHypothesis, lag: float, up_is_down: bool) -> Window | None:
    """Return the part of a log in which the robot turns most, in the body axes of a hypothesis."""
    log = hypothesis.log
    stamps = log.field_time - lag
    span = liveliest(log, stamps)
    if span is None:
        return None
    inside = (stamps >= span[0]) & (stamps <= span[1])
    every = np.union1d(log.imu_time, stamps[inside])
    size = (-1.0 if up_is_down else 1.0) * STANDARD_GRAVITY / usual_size(log.force)
    force = interpolated(every, log.imu_time, size * log.force)
    rate = interpolated(every, log.imu_time, log.rate @ hypothesis.gyro)
    rows = np.searchsorted(every, stamps[inside])
    field = log.field[inside] @ hypothesis.field
    window = Window(stamps[inside], field, force[rows], rate[rows])
    return window.with_steps(Steps.straight(every, force, rate).over(rows))


def _by_samples(found: Smoothed, name: str, element: int = 0) -> Belief:
    """Return an unknown by the samples alone, without its prior, over all kinds of motion."""
    at, best = AT[name].start + element, found.fit
    prior = float(best.model.priors.scale[at]) * best.point.groups[name]
    if not prior > 0.0:
        return Belief.unknown()
    weights = np.array(list(found.weights.values()))
    value = np.array([fit.state.shared[at] for fit in found.fits.values()])
    variance = np.array([fit.covariance[at, at] for fit in found.fits.values()])
    mean = float(weights @ value)
    both = 1.0 / float(weights @ (variance + (value - mean) ** 2))
    own = both - prior**-2.0
    return Belief(mean * both / own, own**-0.5) if own > 0.0 else Belief.unknown()


def _motors(found: Smoothed) -> tuple[FloatArray | None, float]:
    """Return the mean field of the motors in the turn beyond that at rest, and its sigma, tesla."""
    fit, nodes = found.fit, found.nodes
    still, turns = fit.point.course.still, np.abs(nodes.rate[:, 2]) > TURN.turns
    if not (still.any() and turns.any()):
        return None, math.inf
    by = np.zeros((3, len(fit.state.shared)))
    by[:, AT["motors_moving"]] = np.eye(3)
    by[:, AT["motors_rate"]] = np.median(nodes.rate[turns, 2]) * np.eye(3)
    local = fit.state.local[:, BODY_FIELD]
    field = by @ fit.state.shared + local[turns].mean(axis=0) - local[still].mean(axis=0)
    sigma = math.sqrt(float(np.linalg.eigvalsh(by @ fit.covariance @ by.T)[-1]))
    return field / MICROTESLA, sigma / MICROTESLA


def _drove(found: Smoothed) -> bool:
    """Return whether the robot drove: by the kind of motion, or by the radius of its circle.

    In a steady circle between rests, the smoother may explain the centripetal acceleration by a
    shift of the accelerometer in motion. The shift then shows the radius.
    """
    if sum(found.weights.get(kind, 0.0) for kind in DRIVES) > 0.5:
        return True
    rate, course, shared = found.nodes.rate[:, 2], found.fit.point.course, found.fit.state.shared
    turns = np.abs(rate) > TURN.turns
    if not turns.any():
        return False
    by_shift = shared[AT["force_moving"]] / np.median(np.abs(rate[turns])) ** 2
    radius = course.axes[:, :2].T @ (by_shift - shared[AT["lever_arm"]])
    return bool(np.linalg.norm(radius) > TURN.radius)


def force_latency(hypothesis: AxesHypothesis) -> Belief:
    """Return the accelerometer's latency; only a changing tilt shows it."""
    log = hypothesis.log
    found, lag, axes = Belief.unknown(), 0.0, (np.eye(3)[None], hypothesis.gyro[None])
    gravity = replace(log, field_time=log.imu_time, field=log.force)
    for _ in range(AXES.rounds):
        part = segment_of_log(gravity, lag, TURN.most, TURN.most)
        if part is None:
            break
        fit = AlignmentFit(part, *axes, with_up=False)
        found = _force_latency_by(fit, lag)
        if abs(found.value - lag) < AXES.settled:
            break
        lag = found.value
    return found


def _force_latency_by(fit: AlignmentFit, lag: float) -> Belief:
    """Return the latency by a fit to single samples, if `lag` is already subtracted."""
    at = fit.descend(fit.start(), START_NOISE, AXES.rounds)
    for _ in range(2):
        at = fit.descend(at.state, noise_of(at.residual[0], at.state[0]), AXES.rounds)
    residual, jacobian = (values[0, 0] for values in fit.residuals(at.state))
    nu = WIDE.freedom
    arm = AXES.lever * per_metre(fit.rate[0], fit.segment.time) / fit.segment.size
    design = np.concatenate([jacobian, arm], axis=2)
    prior = np.eye(design.shape[2])
    prior[:PARAMETERS, :PARAMETERS] = fit.prior
    start = np.append(at.state[0], np.zeros(3))
    left = residual
    for _ in range(AXES.rounds):
        variance = _noise_around(left, fit.segment.time)
        weight = (nu + 3.0) / (nu + np.sum(left**2, axis=1) / variance) / variance
        weight /= inefficiency(left / np.sqrt(variance)[:, None])
        root = np.sqrt(weight)[:, None]
        # The product of an array with itself takes half the time of one with another array.
        rows = (root[:, None] * design).reshape(-1, design.shape[2])
        information = rows.T @ rows + prior
        step = np.linalg.solve(information, rows.T @ (root * residual).ravel() - prior @ start)
        left = residual - design @ step
    variance_of_lag = float(np.linalg.inv(information)[LAG, LAG])
    off = math.hypot(math.sqrt(variance_of_lag), TURN.least)
    return Belief(lag + float(start[LAG] + step[LAG]), off)


def _noise_around(left: FloatArray, time: FloatArray) -> FloatArray:
    """Return the local variance per axis, shape (n,): movement adds vibration."""
    power = np.sum(left**2, axis=1)
    usual = float(np.median(power)) + 1e-12
    rows = 1 + int(AXES.span / max(float(np.median(np.diff(time))), 1e-4))
    calm = running_mean(np.minimum(power, 20.0 * usual), rows)
    return np.asarray(np.maximum(calm, 0.3 * usual) / 3.0)
