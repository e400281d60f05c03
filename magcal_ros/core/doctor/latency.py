"""Latency of the accelerometer against the gyro.

Gravity, which is constant in the world, shows by its rotation when it was measured. Fitted together
with the latency are the sensor's installation, scale and offset, the gyro's bias, scale and random
walk, and the accelerometer's lever arm. The sigma follows from the residuals, so it is the one that
the rates and the noise of this movement allow.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from magcal_ros.core.doctor.alignment import (
    FIELD,
    LAG,
    SOFT,
    START_NOISE,
    AlignmentFit,
    Linearisation,
    inefficiency,
    turned,
)
from magcal_ros.core.doctor.axes_hypotheses import AxesHypothesis
from magcal_ros.core.doctor.doctor_tuning import AXES, FINE, FORCE_PRIORS
from magcal_ros.core.doctor.segment import Segment, segment_of_log
from magcal_ros.core.geometry.arrays import FloatArray, running_mean
from magcal_ros.core.geometry.rotations import skews
from magcal_ros.core.knowledge import Belief
from magcal_ros.core.samples.window import SensorLog, white_noise


def force_latency(log: SensorLog, hypothesis: AxesHypothesis) -> Belief:
    """Return the accelerometer's latency by a log in rad/s; only a changing tilt shows it."""
    found, lag, axes = Belief.unknown(), 0.0, (np.eye(3)[None], hypothesis.gyro[None])
    gravity = replace(log, field_time=log.imu_time, field=log.force)
    for _ in range(AXES.looks):
        part = segment_of_log(gravity, lag, FINE.most, FINE.most)
        if part is None:
            break
        fit = AlignmentFit(part, *axes, FORCE_PRIORS, with_up=False)
        at = fit.descend(fit.linearised(fit.start()), START_NOISE, AXES.looks)
        found = _latency_by(fit, at, log, lag)
        if abs(found.value - lag) < AXES.settled:
            break
        lag = found.value
    return found


def _latency_by(fit: AlignmentFit, at: Linearisation, log: SensorLog, lag: float) -> Belief:
    """Return the latency by a fit to single samples of a log, if `lag` is already subtracted."""
    for _ in range(2):
        at = fit.descend(at, fit.noise(at, 0), AXES.looks)
    state, time = at.state, fit.segment.time
    residual, jacobian = at.residual[0, 0], at.jacobian[0, 0]
    attitude, _ = fit.propagate(state)
    walked = turned(attitude @ state[0, FIELD], _walk(attitude, time, log))[0]
    walked = (np.eye(3) + state[0, SOFT].reshape(3, 3)) @ walked
    arm = FINE.lever * _per_metre(fit.rate[0], fit.segment)
    design = np.concatenate([jacobian, walked, arm], axis=2)
    count = design.shape[2]
    prior = np.eye(count)
    prior[: len(fit.prior), : len(fit.prior)] = fit.prior
    start = np.concatenate([state[0], np.zeros(count - len(fit.prior))])
    left, nu = residual, fit.tuning.freedom
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
    variance_of_lag = float(np.linalg.inv(information)[LAG, LAG])
    off = math.hypot(math.sqrt(variance_of_lag), FINE.least)
    return Belief(lag + float(start[LAG] + step[LAG]), off)


def _rows_in(seconds: float, time: FloatArray) -> int:
    """Return the number of rows with stamps `time` (n,) in a span of `seconds`; at least one."""
    return max(1, int(seconds / max(float(np.median(np.diff(time))), 1e-4)))


def _noise_around(left: FloatArray, time: FloatArray) -> FloatArray:
    """Return the local variance per axis, shape (n,): movement adds vibration."""
    power = np.sum(left**2, axis=1)
    usual = float(np.median(power))
    calm = running_mean(np.minimum(power, 20.0 * usual), _rows_in(FINE.steady, time))
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
