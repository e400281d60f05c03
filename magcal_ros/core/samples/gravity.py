"""Gravity in the specific force of a sensor that is moved."""

from __future__ import annotations

import numpy as np

from magcal_ros.core.geometry.arrays import FloatArray, block_means, trapezoids
from magcal_ros.core.geometry.attitude import STANDARD_GRAVITY, usual_size
from magcal_ros.core.geometry.rotations import chained, exp_rotations

MEAN_OVER = 4.0  # seconds of one mean; a hand changes its velocity by little over this time


def gravity_in_body(time: FloatArray, force: FloatArray, rate: FloatArray | None) -> FloatArray:
    """Return gravity in specific forces (n, 3) of a moved sensor, m/s² as published, (n, 3).

    The sensor's own acceleration, by a lever arm or a hand, averages out over some seconds in axes
    that do not rotate. The means replace the forces if their usual length is nearer to gravity: a
    difference that motion explains is not the accelerometer's, and a faulty gyro does no harm.

    `time` (n,) increases, seconds. `rate` (n, 3) is in rad/s; without a gyro forces are returned.
    """
    if rate is None or len(time) < 2:
        return force
    attitude = chained(exp_rotations(-trapezoids(time, rate))[None])[0]
    count = max(1, round(float(time[-1] - time[0]) / MEAN_OVER))
    first = np.unique(np.searchsorted(time, np.linspace(time[0], time[-1], count + 1)[:-1]))
    means = block_means(np.einsum("nij,ni->nj", attitude, force), first)
    mean = np.repeat(means, np.diff(np.append(first, len(time))), axis=0)
    averaged = np.einsum("nij,nj->ni", attitude, mean)
    return min(force, averaged, key=lambda each: abs(usual_size(each) - STANDARD_GRAVITY))


def gravity_size(time: FloatArray, force: FloatArray, rate: FloatArray | None) -> float:
    """Return the usual length of `gravity_in_body`, m/s² as published."""
    return usual_size(gravity_in_body(time, force, rate))
