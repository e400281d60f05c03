"""Latency of the field, field of the motors, and whether a robot drove, by the smoother.

Most robots have no latency, and the smoother's prior says so. It is removed from the latency's
posterior, so that a latency is reported only if the samples determine it.
"""

from __future__ import annotations

import math
from contextlib import suppress
from dataclasses import dataclass

import numpy as np

from magcal_ros.core.doctor.alignment import LAG
from magcal_ros.core.doctor.axes_hypotheses import AxesHypothesis
from magcal_ros.core.doctor.doctor_tuning import FINE
from magcal_ros.core.doctor.segment import liveliest
from magcal_ros.core.errors import Refusal
from magcal_ros.core.geometry.arrays import FloatArray, interpolated
from magcal_ros.core.geometry.attitude import STANDARD_GRAVITY, usual_size
from magcal_ros.core.knowledge import Belief, Knowledge
from magcal_ros.core.samples.window import SensorLog, Steps, Window
from magcal_ros.core.smoother.kinds_of_motion import EVIDENCE_WEIGHT, Smoothed, smooth
from magcal_ros.core.smoother.unknowns import AT, BODY_FIELD, DRIVES, MICROTESLA, USUAL


@dataclass(frozen=True, eq=False)
class TurnFit:
    """Latency, motors and kind of motion by the smoother's fit of a turn."""

    latency: Belief  # of the field, seconds
    motors: FloatArray | None
    """Field of the motors in body axes while the robot turns, tesla; None without a rest. (3,)."""
    motors_sigma: float  # tesla, largest over all directions
    drove: bool  # whether the robot drove in its turns


def fit_turn(
    log: SensorLog, hypothesis: AxesHypothesis, knowledge: Knowledge, up_is_down: bool
) -> TurnFit | None:
    """Return the fit of a log in rad/s and body axes by a hypothesis; None if it is refused.

    The smoother interpolates the rotation between its nodes, which is inexact for a large latency.
    If the hypothesis has one, a second fit is made with it subtracted from the stamps, and the
    likelier of the two is used.
    """
    lag = float(hypothesis.state[LAG])
    found: list[tuple[float, Smoothed]] = []
    for each in (0.0, lag) if abs(lag) > FINE.late else (0.0,):
        window = _window(log, hypothesis, each, up_is_down)
        if window is None:
            continue
        with suppress(Refusal):
            found.append((each, smooth(window, knowledge)))
    if not found:
        return None
    lag, best = max(found, key=lambda one: _log_odds(one[1]))
    return TurnFit(_latency(best, lag), *_motors(best), _drove(best))


def _log_odds(found: Smoothed) -> float:
    """Return the log evidence of all kinds of motion together."""
    own = math.log(USUAL.get(found.mode, 1.0) / found.weights[found.mode])
    return own - EVIDENCE_WEIGHT * found.fit.evidence


def _window(
    log: SensorLog, hypothesis: AxesHypothesis, lag: float, up_is_down: bool
) -> Window | None:
    """Return the part of a log in which the robot turns most, in the body axes of a hypothesis."""
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
    field = log.field[inside] @ hypothesis.field.T
    window = Window(stamps[inside], field, force[rows], rate[rows])
    return window.with_steps(Steps.straight(every, force, rate).over(rows))


def _latency(found: Smoothed, lag: float) -> Belief:
    """Return the latency by the samples alone, after `lag` seconds were subtracted."""
    at, best = AT["latency"].start, found.fit
    prior = float(best.model.priors.scale[at]) * best.point.groups["latency"]
    if not prior > 0.0:
        return Belief.unknown()
    weights = np.array(list(found.weights.values()))
    value = np.array([fit.state.shared[at] for fit in found.fits.values()])
    variance = np.array([fit.covariance[at, at] for fit in found.fits.values()])
    mean = float(weights @ value)
    both = 1.0 / float(weights @ (variance + (value - mean) ** 2))
    own = both - prior**-2.0
    if own <= 0.0:
        return Belief.unknown()
    return Belief(lag + mean * both / own, math.hypot(own**-0.5, FINE.least))


def _motors(found: Smoothed) -> tuple[FloatArray | None, float]:
    """Return the mean field of the motors in the turn beyond that at rest, and its sigma, tesla."""
    fit, nodes = found.fit, found.nodes
    still, turns = fit.point.course.still, np.abs(nodes.rate[:, 2]) > FINE.turns
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
    turns = np.abs(rate) > FINE.turns
    if not turns.any():
        return False
    by_shift = shared[AT["force_moving"]] / np.median(np.abs(rate[turns])) ** 2
    radius = course.axes[:, :2].T @ (by_shift - shared[AT["lever_arm"]])
    return bool(np.linalg.norm(radius) > FINE.radius)
