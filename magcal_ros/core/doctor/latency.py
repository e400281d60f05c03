"""Latency of field and accelerometer, the field of the motors, and turns on the spot.

A vector that is constant in the world shows by its rotation when a sensor measured it. Fitted
together with the latency are the sensor's installation, scale and offset, the gyro's bias, scale
and random walk, and the accelerometer's lever arm. The sigma follows from the residuals, so it is
the one that the rates and the noise of this movement allow.

One metre from the axis of a turn, the centripetal acceleration in m/s² is the rate squared. A
vehicle in a bend measures more, and drives to places where the field is different.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from magcal_ros.core.doctor.axes_hypotheses import LIMITS, AxesHypothesis
from magcal_ros.core.geometry.arrays import BoolArray, FloatArray, running_mean, runs
from magcal_ros.core.geometry.attitude import STANDARD_GRAVITY, unit
from magcal_ros.core.geometry.rotations import skews
from magcal_ros.core.samples.alignment import (
    BIAS,
    FIELD,
    IRON,
    LAG,
    PARAMETERS,
    SCALE,
    SOFT,
    START_NOISE,
    WIDE,
    AlignmentFit,
    inefficiency,
    turned,
)
from magcal_ros.core.samples.window import SensorLog, segment_of_log, white_noise

FIELD_PRIORS = replace(WIDE, field_floor=1e-3, freedom=10.0)
FORCE_PRIORS = replace(FIELD_PRIORS, installation=math.radians(3.0), soft_iron=0.02, hard_iron=0.3)
"""Priors of both; the accelerometer's offset is relative to the changing part of gravity."""


@dataclass(frozen=True)
class LatencyTuning:
    """Priors and settings of the fit of a latency."""

    most: int = 1500  # samples; more are averaged
    lever: float = 0.3
    """Standard deviation of the accelerometer's lever arm from the turn's axis, metres."""
    walk_steps: int = 40  # of the gyro's random walk
    walk: float = math.radians(0.01)  # radians in a second, random walk of a noise-free gyro
    shaken: float = 1.5  # seconds over which the noise is averaged
    least: float = 1e-3  # seconds, standard deviation of the stamps' systematic errors
    steps: int = 4  # of the fit between two estimates of the noise
    motors: float = 20e-6  # tesla, standard deviation of the motors' field in a turn
    turns: float = math.radians(5.0)  # rad/s about the vertical from which motors turn the robot
    starts: float = 0.2  # seconds over which this rate is averaged
    in_time: float = 5e-3  # seconds, standard deviation of a known latency


class Latency(NamedTuple):
    """A sensor's latency and its standard deviation, seconds."""

    lag: float
    sigma: float


TUNING = LatencyTuning()


def field_latency(log: SensorLog, hypothesis: AxesHypothesis) -> Latency | None:
    """Return the field's latency by a hypothesis, or None. The log is in rad/s and body axes."""
    before = float(hypothesis.state[LAG])
    start = _fit_of_the_field(log, hypothesis, before)
    if start is None:
        return None
    motors, fit, state = _motors_columns(*start, log), start[0], _linearisation_point(*start)
    found, beside = (_latency(before, *_fitted(fit, state, log, m)) for m in (None, motors))
    # Between rests, a field of the motors looks like a latency: the difference adds to the sigma.
    return found._replace(sigma=math.hypot(found.sigma, found.lag - beside.lag))


def motors_field(
    log: SensorLog, hypothesis: AxesHypothesis, lag: float
) -> tuple[FloatArray, FloatArray] | None:
    """Return the field of the motors while the robot turns about up, tesla in body axes.

    Shape (3,), with the covariance (3, 3); this is the prior's unless the robot both rests and
    turns. `lag` is the field's latency, seconds; the other arguments are as in `field_latency`.
    """
    start = _fit_of_the_field(log, hypothesis, lag)
    if start is None:
        return None
    start[0].prior[LAG, LAG] = TUNING.in_time**-2
    found, covariance = _fitted(
        start[0], _linearisation_point(*start), log, _motors_columns(*start, log)
    )
    return TUNING.motors * found[-3:], TUNING.motors**2 * covariance[-3:, -3:]


def _motors_columns(fit: AlignmentFit, state: FloatArray, log: SensorLog) -> FloatArray:
    """Return the columns, of unit prior, of the motors' field outside and in turns, (n, 3, 6)."""
    # The nose may be lifted by hand or by motors.
    rate = (1.0 + state[0, SCALE]) * fit.rate[0] - state[0, BIAS]
    width = rows_in(TUNING.starts, fit.segment.time)
    about_up = np.abs(rate @ unit(np.median(log.force, axis=0)))
    turning, moving = (
        running_mean(each, width) > TUNING.turns
        for each in (about_up, np.linalg.norm(rate, axis=1))
    )
    when = np.repeat(np.column_stack([moving & ~turning, turning]), 3, axis=1)
    size = TUNING.motors / fit.segment.size
    return np.asarray(size * when[:, None] * np.tile(np.eye(3), 2))


def rows_in(seconds: float, time: FloatArray) -> int:
    """Return the number of rows with stamps `time` (n,) in a span of `seconds`; at least one."""
    return max(1, int(seconds / max(float(np.median(np.diff(time))), 1e-4)))


def _fit_of_the_field(
    log: SensorLog, hypothesis: AxesHypothesis, lag: float
) -> tuple[AlignmentFit, FloatArray] | None:
    """Return the fit of the field to single samples, and its initial state (1, 23)."""
    part = segment_of_log(log, lag, TUNING.most, TUNING.most)
    if part is None:
        return None
    state = hypothesis.state[None].copy()
    state[:, LAG] = 0.0
    state[:, FIELD.start : IRON.stop] *= hypothesis.part.size / part.size
    return AlignmentFit(part, hypothesis.field[None], hypothesis.gyro[None], FIELD_PRIORS), state


def fit_of_the_force(log: SensorLog, gyro: FloatArray, lag: float = 0.0) -> AlignmentFit | None:
    """Return the fit of the force to a gyro with axes (3, 3); None for too few samples."""
    gravity = replace(log, field_time=log.imu_time, field=log.force)
    part = segment_of_log(gravity, lag, TUNING.most, TUNING.most)
    if part is None:
        return None
    return AlignmentFit(part, np.eye(3)[None], gyro[None], FORCE_PRIORS, with_up=False)


def force_latency(log: SensorLog, hypothesis: AxesHypothesis) -> Latency | None:
    """Return the accelerometer's latency, as `field_latency`; only a changing tilt shows it."""
    before, found = 0.0, None
    for _ in range(LIMITS.looks):
        fit = fit_of_the_force(log, hypothesis.gyro, before)
        if fit is None:
            break
        state = fit.descend(fit.start(), START_NOISE, TUNING.steps)
        turns, part = skews(fit.rate[0]), fit.segment
        lever = skews(np.gradient(fit.rate[0], part.time, axis=0)) + turns @ turns
        lever *= TUNING.lever / part.size
        found = _latency(before, *_fitted(fit, _linearisation_point(fit, state), log, lever))
        if abs(found.lag - before) < LIMITS.settled:
            break
        before = found.lag
    return found


def _linearisation_point(fit: AlignmentFit, state: FloatArray) -> FloatArray:
    """Return the linearisation point (1, 23) of the final fit."""
    for _ in range(2):
        state = fit.descend(state, fit.noise(state, 0), TUNING.steps)
    return state


def _fitted(
    fit: AlignmentFit, state: FloatArray, log: SensorLog, more: FloatArray | None = None
) -> tuple[FloatArray, FloatArray]:
    """Fit all parameters, the gyro's random walk and `more` columns; return the covariance, too."""
    time = fit.segment.time
    residual, jacobian = (values[0, 0] for values in fit.linearised(state))
    attitude, _ = fit.propagate(state)
    walked = turned(attitude @ state[0, FIELD], _walk(attitude, time, log))[0]
    parts = [jacobian, (np.eye(3) + state[0, SOFT].reshape(3, 3)) @ walked]
    if more is not None:
        parts.append(more)
    design = np.concatenate(parts, axis=2)
    count = design.shape[2]
    prior = np.eye(count)
    prior[: len(fit.prior), : len(fit.prior)] = fit.prior
    slope = np.concatenate([fit.prior @ state[0], np.zeros(count - len(fit.prior))])
    left, nu = residual, fit.tuning.freedom
    for _ in range(LIMITS.rounds):
        variance = _noise_around(left, time)
        weight = (nu + 3.0) / (nu + np.sum(left**2, axis=1) / variance) / variance
        weight /= inefficiency(left / np.sqrt(variance)[:, None])
        root = np.sqrt(weight)[:, None]
        # The product of an array with itself takes half the time of one with another array.
        rows = (root[:, None] * design).reshape(-1, count)
        information = rows.T @ rows + prior
        step = np.linalg.solve(information, rows.T @ (root * residual).ravel() - slope)
        left = residual - design @ step
    found = np.concatenate([state[0], np.zeros(count - len(fit.prior))]) + step
    return found, np.linalg.inv(information)


def _latency(before: float, found: FloatArray, covariance: FloatArray) -> Latency:
    off = math.hypot(math.sqrt(float(covariance[LAG, LAG])), TUNING.least)
    return Latency(before + float(found[LAG]), off)


def _noise_around(left: FloatArray, time: FloatArray) -> FloatArray:
    """Return the local variance per axis, shape (n,): movement adds vibration."""
    power = np.sum(left**2, axis=1)
    usual = float(np.median(power))
    calm = running_mean(np.minimum(power, 20.0 * usual), rows_in(TUNING.shaken, time))
    return np.asarray(np.maximum(calm, 0.3 * usual) / 3.0)


def _walk(attitude: FloatArray, time: FloatArray, log: SensorLog) -> FloatArray:
    """Return the rotation by each step of the gyro's random walk, of unit prior, (1, n, 3, m)."""
    seconds = float(time[-1] - time[0]) / TUNING.walk_steps
    done = np.clip((time[:, None] - time[0]) / seconds - np.arange(TUNING.walk_steps), 0.0, 1.0)
    period = float(np.median(np.diff(log.imu_time)))
    noise = float(white_noise(log.rate).max()) * math.sqrt(period)
    size = math.hypot(noise, TUNING.walk) * math.sqrt(seconds)
    each = size * attitude[..., None] * done[None, :, None, None, :]
    return np.asarray(each.reshape(*attitude.shape[:3], -1))


@dataclass(frozen=True)
class SpotTuning:
    """How the acceleration in a turn is compared with that at rest."""

    mean: float = 0.5  # seconds over which rates and forces are averaged
    at_rest: float = 1.5  # seconds at the ends of a rest that show gravity
    longest: float = 10.0  # seconds from a rest within which the gyro's attitude is used
    drift: float = math.radians(0.1)
    lean: float = math.radians(0.2)
    """Standard deviations of the bias measured at rest, rad/s, and of an attitude, radians."""
    offset: float = 0.3  # m/s², standard deviation of the accelerometer's offset
    independent: float = 5.0  # effective number of independent samples in all turns
    beyond: float = 2.0  # times the acceleration that a turn on the spot explains


SPOT = SpotTuning()


def drove_while_turning(
    log: SensorLog, gyro: FloatArray = np.eye(3), bias: FloatArray = np.zeros(3)
) -> bool:
    """Return whether the acceleration is beyond that of a turn on the spot; False if not shown.

    The log needs a gyro. Rows of `gyro` (3, 3) are its axes in the body's, and `bias` (3,) is its
    approximate bias, rad/s.
    """
    fit = fit_of_the_force(log, gyro)
    if fit is None:
        return False
    part, rate = fit.segment, fit.rate[0]
    turned, up = rate - bias, unit(np.median(log.force, axis=0))
    width = rows_in(SPOT.mean, part.time)
    still = running_mean(np.linalg.norm(turned, axis=1), width) < TUNING.turns
    about_up = running_mean(turned @ up, width)
    rests = _ends_of_rests(still, rows_in(SPOT.at_rest, part.time))
    if not rests:
        return False
    away = np.abs(part.time[:, None] - part.time[[edge for edge, _ in rests]])
    nearest, since = np.argmin(away, axis=1), away.min(axis=1)
    seen = (np.abs(about_up) > TUNING.turns) & (since < SPOT.longest)
    if seen.sum() * max(float(np.median(np.diff(part.time))), 1e-4) < SPOT.mean:
        return False
    state = np.zeros((1, PARAMETERS))
    state[:, BIAS] = np.median(rate[still], axis=0)
    attitude = fit.propagate(state)[0][0]
    force = np.column_stack([running_mean(axis, width) for axis in part.size * part.field.T])
    world = np.einsum("nji,nj->ni", attitude, force)
    gravity = np.array([world[rows].mean(axis=0) for _, rows in rests])
    to_world = np.array([attitude[rows].mean(axis=0).T for _, rows in rests])
    felt = force[seen] - np.einsum("nij,nj->ni", attitude[seen], gravity[nearest[seen]])
    unsure = STANDARD_GRAVITY * np.hypot(SPOT.drift * since[seen], SPOT.lean)
    allowed = np.hypot(LIMITS.lever * about_up[seen] ** 2, unsure)
    left = _without_offset(felt, attitude[seen] @ to_world[nearest[seen]], up, allowed)
    return bool(np.median(np.linalg.norm(left, axis=1) / allowed) > SPOT.beyond)


def _ends_of_rests(still: BoolArray, width: int) -> list[tuple[int, slice]]:
    """Return the first and the last row of each rest, each with the rows that show gravity."""
    found = []
    for first, end in runs(still):
        if end - first >= min(width, 3):
            found.append((first, slice(first, min(first + width, end))))
            found.append((end - 1, slice(max(end - width, first), end)))
    return found


def _without_offset(
    felt: FloatArray, turned: FloatArray, up: FloatArray, sigma: FloatArray
) -> FloatArray:
    """Return the horizontal acceleration (n, 3) minus the part that an offset explains."""
    # At rest the offset was taken for gravity, and rotated with gravity (n, 3, 3) from then on.
    level = np.eye(3) - np.outer(up, up)
    seen = felt @ level
    design = level @ (np.eye(3) - turned)
    share = SPOT.independent / len(felt)
    rows = share * design / sigma[:, None, None] ** 2
    normal = np.einsum("nji,njk->ik", rows, design) + np.eye(3) / SPOT.offset**2
    offset = np.linalg.solve(normal, np.einsum("nji,nj->i", rows, seen))
    return np.asarray(seen - design @ offset)
