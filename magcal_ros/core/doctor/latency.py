"""Latency of field and accelerometer, the field of the motors, and turns on the spot.

A vector that is constant in the world shows by its rotation when a sensor measured it. Fitted
together with the latency are the sensor's installation, scale and offset, the gyro's bias, scale
and random walk, and the accelerometer's lever arm. The sigma follows from the residuals, so it is
the one that the rates and the noise of this movement allow.

One metre from the axis of a turn, the centripetal acceleration in m/s² is the rate squared. A
vehicle in a bend measures more, and drives to places where the field is different: the evidence of
both models decides.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from magcal_ros.core.doctor.alignment import (
    BIAS,
    FIELD,
    IRON,
    LAG,
    SCALE,
    SOFT,
    START_NOISE,
    AlignmentFit,
    Linearisation,
    inefficiency,
    turned,
)
from magcal_ros.core.doctor.axes_hypotheses import AxesHypothesis
from magcal_ros.core.doctor.doctor_tuning import (
    AXES,
    FIELD_PRIORS,
    FINE,
    FORCE_PRIORS,
    AlignmentPriors,
)
from magcal_ros.core.doctor.segment import Segment, segment_of_log
from magcal_ros.core.geometry.arrays import FloatArray, running_mean
from magcal_ros.core.geometry.attitude import unit
from magcal_ros.core.geometry.rotations import skews
from magcal_ros.core.knowledge import Belief
from magcal_ros.core.samples.window import SensorLog, white_noise


class SingleSampleFit:
    """The fit of a field or force that is constant in the world, to single samples and a gyro.

    It is linear about `at`; `lag` is the latency that is already subtracted from the stamps,
    seconds.
    """

    def __init__(self, fit: AlignmentFit, at: Linearisation, log: SensorLog, lag: float) -> None:
        self.fit, self.log, self.lag = fit, log, lag
        for _ in range(2):
            at = fit.descend(at, fit.noise(at, 0), AXES.looks)
        self.at = at

    @property
    def rate(self) -> FloatArray:
        """The corrected rates of the gyro, rad/s, shape (n, 3)."""
        state = self.at.state[0]
        return np.asarray((1.0 + state[SCALE]) * self.fit.rate[0] - state[BIAS])

    def solve(
        self, more: FloatArray | None = None, taken: FloatArray | None = None
    ) -> tuple[FloatArray, FloatArray]:
        """Fit all parameters, the gyro's random walk and `more` columns of unit prior (n, 3, m).

        Return the parameters and their covariance. `taken` (m,) are amounts of these columns that
        are already subtracted from the samples: they are as late as the samples, and the latency is
        the whole one.
        """
        fit, state, time = self.fit, self.at.state, self.fit.segment.time
        residual, jacobian = self.at.residual[0, 0], self.at.jacobian[0, 0]
        attitude, _ = fit.propagate(state)
        walked = turned(attitude @ state[0, FIELD], _walk(attitude, time, self.log))[0]
        parts = [jacobian, (np.eye(3) + state[0, SOFT].reshape(3, 3)) @ walked]
        design = np.concatenate(parts if more is None else [*parts, more], axis=2)
        count = design.shape[2]
        prior = np.eye(count)
        prior[: len(fit.prior), : len(fit.prior)] = fit.prior
        start = np.concatenate([state[0], np.zeros(count - len(fit.prior))])
        left, nu = residual, fit.tuning.freedom
        if more is not None and taken is not None:
            start[LAG] += self.lag
            residual = residual + more @ taken
            design[..., LAG] -= np.gradient(more @ taken, time, axis=0)
        for _ in range(AXES.rounds):
            variance = _noise_around(left, time)
            weight = (nu + 3.0) / (nu + np.sum(left**2, axis=1) / variance) / variance
            weight /= inefficiency(left / np.sqrt(variance)[:, None])
            root = np.sqrt(weight)[:, None]
            # The product of an array with itself takes half the time of one with another array.
            rows = (root[:, None] * design).reshape(-1, count)
            information = rows.T @ rows + prior
            slope = rows.T @ (root * residual).ravel() - prior @ start
            step = np.linalg.solve(information, slope)
            left = residual - design @ step
        return start + step, np.linalg.inv(information)

    def latency(self, more: FloatArray | None = None) -> Belief:
        """Return the latency, seconds, if the columns `more` are fitted, too."""
        found, covariance = self.solve(more)
        off = math.hypot(math.sqrt(float(covariance[LAG, LAG])), FINE.least)
        return Belief(self.lag + float(found[LAG]), off)

    def motors_columns(self) -> FloatArray:
        """Return the columns, of unit prior, of the motors' field outside and in turns."""
        # The nose may be lifted by hand or by motors.
        rate = self.rate
        width = rows_in(FINE.starts, self.fit.segment.time)
        about_up = np.abs(rate @ unit(np.median(self.log.force, axis=0)))
        turning, moving = (
            running_mean(each, width) > FINE.turns
            for each in (about_up, np.linalg.norm(rate, axis=1))
        )
        when = np.repeat(np.column_stack([moving & ~turning, turning]), 3, axis=1)
        size = FINE.motors / self.fit.segment.size
        return np.asarray(size * when[:, None] * np.tile(np.eye(3), 2))

    def lever_columns(self) -> FloatArray:
        """Return the columns, of unit prior, of the accelerometer's lever arm."""
        return FINE.lever * _per_metre(self.fit.rate[0], self.fit.segment)


def field_latency(log: SensorLog, hypothesis: AxesHypothesis) -> Belief:
    """Return the field's latency by a hypothesis. The log is in rad/s and body axes."""
    fit = _fit_of_the_field(log, hypothesis, float(hypothesis.state[LAG]), FIELD_PRIORS)
    if fit is None:
        return Belief.unknown()
    found, beside = fit.latency(), fit.latency(fit.motors_columns())
    # Between rests, a field of the motors looks like a latency: the difference adds to the sigma.
    return replace(found, sigma=math.hypot(found.sigma, found.value - beside.value))


def motors_field(
    log: SensorLog, hypothesis: AxesHypothesis, lag: float
) -> tuple[FloatArray, FloatArray] | None:
    """Return the field of the motors while the robot turns about up, tesla in body axes.

    Shape (3,), with the covariance (3, 3); this is the prior's unless the robot both rests and
    turns. `lag` is the field's latency, seconds; the other arguments are as in `field_latency`.
    """
    fit = _fit_of_the_field(log, hypothesis, lag, replace(FIELD_PRIORS, lag=FINE.in_time))
    if fit is None:
        return None
    found, covariance = fit.solve(fit.motors_columns())
    return FINE.motors * found[-3:], FINE.motors**2 * covariance[-3:, -3:]


def force_latency(log: SensorLog, hypothesis: AxesHypothesis) -> Belief:
    """Return the accelerometer's latency, as `field_latency`; only a changing tilt shows it."""
    found, lag = Belief.unknown(), 0.0
    for _ in range(AXES.looks):
        fit = _fit_of_the_force(log, hypothesis.gyro, lag)
        if fit is None:
            break
        found = fit.latency(fit.lever_columns())
        if abs(found.value - lag) < AXES.settled:
            break
        lag = found.value
    return found


def _fit_of_the_field(
    log: SensorLog, hypothesis: AxesHypothesis, lag: float, priors: AlignmentPriors
) -> SingleSampleFit | None:
    """Return the fit of the field that begins with a hypothesis; None for too few samples."""
    part = segment_of_log(log, lag, FINE.most, FINE.most)
    if part is None:
        return None
    state = hypothesis.state[None].copy()
    state[:, LAG] = 0.0
    state[:, FIELD.start : IRON.stop] *= hypothesis.part.size / part.size
    fit = AlignmentFit(part, hypothesis.field[None], hypothesis.gyro[None], priors)
    return SingleSampleFit(fit, fit.linearised(state), log, lag)


def _fit_of_the_force(log: SensorLog, gyro: FloatArray, lag: float = 0.0) -> SingleSampleFit | None:
    """Return the fit of the force to a gyro with axes (3, 3); None for too few samples."""
    part = _part_of_the_force(log, lag)
    return None if part is None else _fit_of_the_part(log, part, gyro, lag)


def _part_of_the_force(log: SensorLog, lag: float) -> Segment | None:
    """Return the force, with a latency subtracted, in place of the field; None as above."""
    gravity = replace(log, field_time=log.imu_time, field=log.force)
    return segment_of_log(gravity, lag, FINE.most, FINE.most)


def _fit_of_the_part(
    log: SensorLog, part: Segment, gyro: FloatArray, lag: float
) -> SingleSampleFit:
    """Return the fit of the force that `part` has in place of the field."""
    fit = AlignmentFit(part, np.eye(3)[None], gyro[None], FORCE_PRIORS, with_up=False)
    at = fit.descend(fit.linearised(fit.start()), START_NOISE, AXES.looks)
    return SingleSampleFit(fit, at, log, lag)


def rows_in(seconds: float, time: FloatArray) -> int:
    """Return the number of rows with stamps `time` (n,) in a span of `seconds`; at least one."""
    return max(1, int(seconds / max(float(np.median(np.diff(time))), 1e-4)))


def _noise_around(left: FloatArray, time: FloatArray) -> FloatArray:
    """Return the local variance per axis, shape (n,): movement adds vibration."""
    power = np.sum(left**2, axis=1)
    usual = float(np.median(power))
    calm = running_mean(np.minimum(power, 20.0 * usual), rows_in(FINE.steady, time))
    return np.asarray(np.maximum(calm, 0.3 * usual) / 3.0)


def _walk(attitude: FloatArray, time: FloatArray, log: SensorLog) -> FloatArray:
    """Return the rotation by each step of the gyro's random walk, of unit prior, (1, n, 3, m)."""
    seconds = float(time[-1] - time[0]) / FINE.walk_steps
    done = np.clip((time[:, None] - time[0]) / seconds - np.arange(FINE.walk_steps), 0.0, 1.0)
    period = float(np.median(np.diff(log.imu_time)))
    noise = float(white_noise(log.rate).max()) * math.sqrt(period)
    size = math.hypot(noise, FINE.walk) * math.sqrt(seconds)
    each = size * attitude[..., None] * done[None, :, None, None, :]
    return np.asarray(each.reshape(*attitude.shape[:3], -1))


def _per_metre(rate: FloatArray, part: Segment) -> FloatArray:
    """Return the acceleration at each metre from the axis of turns, over `size`, (n, 3, 3)."""
    turns = skews(rate)
    return np.asarray((skews(np.gradient(rate, part.time, axis=0)) + turns @ turns) / part.size)


def _calm(rate: FloatArray, part: Segment) -> FloatArray:
    """Return the means of rates (n, 3): the derivative of single samples is mostly noise."""
    width = rows_in(FINE.starts, part.time)
    return np.column_stack([running_mean(axis, width) for axis in rate.T])


def drove_while_turning(log: SensorLog, gyro: FloatArray = np.eye(3)) -> bool:
    """Return whether the robot drove in its turns, rather than turn on the spot.

    Two models are compared by their evidence. On the spot, the accelerometer has a lever arm. In a
    drive, it also has the radius of a circle, and a velocity that is constant in body axes. The log
    needs a gyro; rows of `gyro` (3, 3) are its axes in the body's.
    """
    return _evidence_of_a_drive(log, gyro) > FINE.drove


def _evidence_of_a_drive(log: SensorLog, gyro: FloatArray) -> float:
    """Return the log of the evidence of a drive over that of a turn on the spot.

    Each fit is linear about the latency and the acceleration that the one before has found.
    """
    up = unit(np.median(log.force, axis=0))
    level = np.eye(3) - np.outer(up, up)
    driven, lag, taken = -math.inf, 0.0, np.zeros(9)
    for _ in range(FINE.looks):
        part = _part_of_the_force(log, lag)
        if part is None:
            break
        rate = _calm(part.rate @ gyro, part)
        arm, by_velocity = _per_metre(rate, part), skews(rate) @ level / part.size
        sizes = [FINE.lever * arm, FINE.circle * arm @ level, FINE.velocity * by_velocity]
        columns = np.concatenate(sizes, axis=2)
        rest = replace(part, field=part.field - columns @ taken)
        found, covariance = _fit_of_the_part(log, rest, gyro, lag).solve(columns, taken)
        # A drive without radius and velocity is a turn on the spot: the prior's density there, over
        # the posterior's, is the ratio of the evidences (Savage and Dickey).
        drive, spread = found[-6:], covariance[-6:, -6:]
        square = float(drive @ np.linalg.solve(spread, drive))
        before, driven = driven, 0.5 * (square + float(np.linalg.slogdet(spread)[1]))
        # Whole steps of a large latency may oscillate.
        lag += (0.5 if taken.any() else 1.0) * (float(found[LAG]) - lag)
        taken = found[-9:]
        if abs(driven - before) < 1.0:
            break
    return driven
