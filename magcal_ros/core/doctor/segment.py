"""The part of a log in which the robot turns most, averaged for the fits of the doctor."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from magcal_ros.core.geometry.arrays import (
    FloatArray,
    block_means,
    integral,
    interpolated,
)
from magcal_ros.core.geometry.attitude import usual_size
from magcal_ros.core.samples.samples_tuning import STREAMS
from magcal_ros.core.samples.window import SensorLog

LONGEST = 60.0  # seconds of a log that are used; the field of a longer drive is not constant
WIDEST_BLOCK = math.radians(4.0)  # radians of turn that are averaged


@dataclass(frozen=True, eq=False)
class Segment:
    """Averaged samples with the turns between them."""

    field: FloatArray  # over `size`, shape (n, 3)
    up: FloatArray  # specific force over its usual size. Shape (n, 3).
    turn: FloatArray
    """The gyro's rate integrated from each sample to the next, radians. Shape (n - 1, 3)."""
    coning: FloatArray
    """Second order of the rotation vectors (coning). Shape (n - 1, 3)."""
    seconds: FloatArray  # shape (n - 1,)
    rate: FloatArray  # the gyro's mean rate, rad/s. Shape (n, 3).
    size: float  # of the field's changing part, tesla
    time: FloatArray  # stamps of the IMU to which the samples belong, seconds. Shape (n,).


def segment_of_log(
    log: SensorLog, lag: float = 0.0, fewest: int = 120, most: int = 240
) -> Segment | None:
    """Average a log with a gyro, finite values and increasing stamps; None if it is too short.

    `lag`, the latency of the field in seconds, is subtracted from the field's stamps. The result
    has `fewest` to `most` averages.
    """
    field_time = log.field_time - lag
    span = liveliest(log, field_time)
    if span is None:
        return None
    imu = (log.imu_time >= span[0]) & (log.imu_time <= span[1])
    time, rate = log.imu_time[imu], log.rate[imu]
    turned = integral(time, rate)
    usual = float(np.linalg.norm(np.diff(turned, axis=0), axis=1).sum())
    count = int(np.clip(usual / WIDEST_BLOCK, fewest, most))
    inside = (field_time >= span[0]) & (field_time <= span[1])
    stamps, field = field_time[inside], log.field[inside]
    block = np.minimum(((stamps - span[0]) / (span[1] - span[0]) * count).astype(int), count - 1)
    _, first = np.unique(block, return_index=True)
    if len(first) < 20:
        return None
    moment, field = block_means(stamps, first), block_means(field, first)
    width = (span[1] - span[0]) / count
    force = _mean_around(time, integral(time, log.force[imu]), moment, width)
    angle, bend = (
        interpolated(moment, time, path)
        for path in (turned, integral(time, np.cross(turned, rate)))
    )
    step = np.diff(angle, axis=0)
    # The size of the field's changing part.
    swing = np.ptp(np.quantile(field, (0.02, 0.98), axis=0), axis=0)
    size = max(float(np.linalg.norm(swing)) / 2.0, 1e-12)
    return Segment(
        field / size,
        force / max(usual_size(force), 1e-12),
        step,
        0.5 * (np.diff(bend, axis=0) - np.cross(angle[:-1], step)),
        np.diff(moment),
        _mean_around(time, turned, moment, width),
        size,
        moment,
    )


def liveliest(log: SensorLog, field_time: FloatArray) -> tuple[float, float] | None:
    """Return begin and end of the time in which the robot turns most, without gaps of the gyro."""
    if min(len(log.imu_time), len(field_time)) < 20:
        return None
    breaks = np.flatnonzero(np.diff(log.imu_time) > STREAMS.longest_gyro_step) + 1
    best, most = None, 0.0
    for rows in np.split(np.arange(len(log.imu_time)), breaks):
        time = log.imu_time[rows]
        low, high = max(time[0], field_time[0]), min(time[-1], field_time[-1])
        if len(rows) < 20 or high - low < 1.0:
            continue
        size = np.linalg.norm(log.rate[rows], axis=1)
        done = integral(time, size)
        begin = low + np.arange(0.0, max(high - LONGEST - low, 0.0) + 0.5, 1.0)
        gained = np.interp(np.minimum(begin + LONGEST, high), time, done)
        gained -= np.interp(begin, time, done)
        k = int(np.argmax(gained))
        if gained[k] > most:
            best = (float(begin[k]), float(min(begin[k] + LONGEST, high)))
            most = float(gained[k])
    return best


def _mean_around(
    time: FloatArray, path: FloatArray, moment: FloatArray, width: float
) -> FloatArray:
    """Return means over `width` seconds around each moment, from an integral."""
    low = np.maximum(moment - 0.5 * width, time[0])
    high = np.minimum(moment + 0.5 * width, time[-1])
    gained = interpolated(high, time, path) - interpolated(low, time, path)
    return np.asarray(gained / (high - low)[:, None])
