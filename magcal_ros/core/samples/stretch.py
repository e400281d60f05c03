"""A movement as few averaged samples, the gyro propagated between them at its own rate."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from magcal_ros.core.geometry.arrays import FloatArray, interpolated
from magcal_ros.core.samples.streams import STREAMS
from magcal_ros.core.samples.window import SensorLog, Window


@dataclass(frozen=True)
class StretchTuning:
    """How a log is averaged."""

    longest: float = 60.0
    """Seconds of the part that is looked at; the field of a drive does not stay the same."""
    widest_block: float = math.radians(4.0)
    """Radians of turn that are averaged."""
    fewest: int = 120
    most: int = 240
    """Averages."""


TUNING = StretchTuning()


@dataclass(frozen=True, eq=False)
class Stretch:
    """Averaged samples with the turns between them."""

    field: FloatArray
    """Over `size`. Shape (n, 3)."""
    up: FloatArray
    """Specific force over its own usual size. Shape (n, 3)."""
    turn: FloatArray
    """The gyro's rate integrated from each sample to the next, radians. Shape (n - 1, 3)."""
    coning: FloatArray
    """What must be added for rotation vectors, because turns do not commute: second order. Shape (n
    - 1, 3)."""
    seconds: FloatArray
    """Shape (n - 1,)."""
    rate: FloatArray
    """The gyro's mean rate, rad/s. Shape (n, 3)."""
    size: float
    """Of the field's changing part, tesla."""
    time: FloatArray
    """Stamps of the IMU to which the samples belong, seconds. Shape (n,)."""


def field_size(field: FloatArray) -> float:
    """Return how large the changing part of a field (n, 3) is, in its unit; never zero."""
    span = np.ptp(np.quantile(field, (0.02, 0.98), axis=0), axis=0)
    return max(float(np.linalg.norm(span)) / 2.0, 1e-12)


def stretch_of(window: Window) -> Stretch | None:
    """Average the samples of a turn that has a gyro; None where there are too few."""
    assert window.angular_rate is not None
    log = SensorLog(
        window.time, window.specific_force, window.angular_rate, window.time, window.field
    )
    return stretch_of_log(log)


def stretch_of_log(
    log: SensorLog, lag: float = 0.0, tuning: StretchTuning = TUNING
) -> Stretch | None:
    """Average a log of increasing stamps that has a gyro; None where there is too little of it.

    Its numbers are finite; `lag` (seconds, by which the field is late) is taken off its stamps.
    """
    field_time = log.field_time - lag
    span = _liveliest(log, field_time, tuning.longest)
    if span is None:
        return None
    imu = (log.imu_time >= span[0]) & (log.imu_time <= span[1])
    time, rate = log.imu_time[imu], log.rate[imu]
    turned = _integral(time, rate)
    usual = float(np.linalg.norm(np.diff(turned, axis=0), axis=1).sum())
    count = int(np.clip(usual / tuning.widest_block, tuning.fewest, tuning.most))
    inside = (field_time >= span[0]) & (field_time <= span[1])
    stamps, field = field_time[inside], log.field[inside]
    block = np.minimum(((stamps - span[0]) / (span[1] - span[0]) * count).astype(int), count - 1)
    _, first, number = np.unique(block, return_index=True, return_counts=True)
    if len(first) < 20:
        return None
    means = [np.add.reduceat(v, first, axis=0) / number[:, None] for v in (stamps[:, None], field)]
    moment, field = means[0][:, 0], means[1]
    width = (span[1] - span[0]) / count
    force = _mean_around(time, _integral(time, log.force[imu]), moment, width)
    angle, bend = (
        interpolated(moment, time, path)
        for path in (turned, _integral(time, np.cross(turned, rate)))
    )
    step = np.diff(angle, axis=0)
    size = field_size(field)
    gravity = float(np.median(np.linalg.norm(force, axis=1)))
    return Stretch(
        field / size,
        force / max(gravity, 1e-12),
        step,
        0.5 * (np.diff(bend, axis=0) - np.cross(angle[:-1], step)),
        np.diff(moment),
        _mean_around(time, turned, moment, width),
        size,
        moment,
    )


def _liveliest(
    log: SensorLog, field_time: FloatArray, longest: float
) -> tuple[float, float] | None:
    """Return from when to when the robot turns most, where no gap of the gyro lies between."""
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
        done = _integral(time, size[:, None])[:, 0]
        begin = low + np.arange(0.0, max(high - longest - low, 0.0) + 0.5, 1.0)
        gained = np.interp(np.minimum(begin + longest, high), time, done)
        gained -= np.interp(begin, time, done)
        k = int(np.argmax(gained))
        if gained[k] > most:
            best = (float(begin[k]), float(min(begin[k] + longest, high)))
            most = float(gained[k])
    return best


def _integral(time: FloatArray, values: FloatArray) -> FloatArray:
    """Return the integral of values (n, d) up to each moment."""
    steps = 0.5 * (values[1:] + values[:-1]) * np.diff(time)[:, None]
    return np.concatenate([np.zeros((1, values.shape[1])), np.cumsum(steps, axis=0)])


def _mean_around(
    time: FloatArray, path: FloatArray, moment: FloatArray, width: float
) -> FloatArray:
    """Return means over `width` seconds around each moment, from an integral."""
    low = np.maximum(moment - 0.5 * width, time[0])
    high = np.minimum(moment + 0.5 * width, time[-1])
    gained = interpolated(high, time, path) - interpolated(low, time, path)
    return np.asarray(gained / (high - low)[:, None])
