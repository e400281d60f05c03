"""Up all along a drive: the slow mean of the specific force in the axes that the gyro holds still.

Starts, stops and bends lean the accelerometer by ten degrees, but forth and back: over some tens of
seconds they cancel, and the gyro hardly drifts meanwhile. Where nothing pulls, the mean is short.
"""

from __future__ import annotations

import math

import numpy as np

from magcal_ros.core.geometry.arrays import FloatArray
from magcal_ros.core.geometry.attitude import unit
from magcal_ros.core.smoothing.level_bias import Leans, gyro_bias
from magcal_ros.core.smoothing.tuning import TUNING, SmootherTuning
from magcal_ros.core.up import relative_attitudes

SMALLEST_STEP = 1e-3


def level_up(
    time: FloatArray,
    force: FloatArray,
    rate: FloatArray,
    tuning: SmootherTuning = TUNING,
) -> FloatArray:
    """Return up at each row, unit vectors in body axes, shape (m, 3).

    Parameters
    ----------
    time : ndarray, shape (m,)
        Seconds, increasing, with no gap over which the gyro was not heard.
    force : ndarray, shape (m, 3)
        m/s², body axes; the vehicle's own acceleration taken off where it is known.
    rate : ndarray, shape (m, 3)
        rad/s, body axes.
    tuning : SmootherTuning
    """
    if len(time) < 3:
        return unit(force)
    size = np.linalg.norm(force, axis=1)
    usual = float(np.median(size))
    weight = 1.0 / (1.0 + ((size - usual) / (tuning.pulled * usual)) ** 2)
    steps = np.maximum(np.diff(time), SMALLEST_STEP)
    heavy, over_gravity = force * weight[:, None], force / usual

    def averaged(bias: FloatArray, memory: float) -> FloatArray:
        return _averaged(time, heavy, weight, rate - bias, np.exp(-steps / memory))

    bias = gyro_bias(time, over_gravity, rate, weight, Leans.staying(tuning), tuning)
    if float(np.linalg.norm(bias)) < tuning.largest_bias:
        up = averaged(bias, tuning.pull_memory)
        if pull(force, up, tuning) < tuning.unpulled:
            return averaged(bias, tuning.level_memory_unpulled)
    bias = gyro_bias(time, over_gravity, rate, weight, Leans.travelling(tuning), tuning)
    return averaged(bias, tuning.level_memory)


def pull(force: FloatArray, up: FloatArray, tuning: SmootherTuning = TUNING) -> float:
    """Return the RMS of the force across up, means over a second each, m/s².

    Parameters
    ----------
    force, up : ndarray, shape (m, 3)
        Rows of a log in body axes.
    tuning : SmootherTuning

    Returns
    -------
    float
        Infinite for less than some seconds.
    """
    width = round(1.0 / tuning.row)
    count = len(force) // width
    if count < tuning.fewest_seconds:
        return math.inf
    across = force - np.sum(force * up, axis=1)[:, None] * up
    means = across[: count * width].reshape(count, width, 3).mean(axis=1)
    return math.sqrt(float(np.mean(np.sum(means**2, axis=1))))


def _averaged(
    time: FloatArray, force: FloatArray, weight: FloatArray, rate: FloatArray, keeps: FloatArray
) -> FloatArray:
    attitude = relative_attitudes(time, rate)
    still = np.einsum("nji,nj->ni", attitude, force)
    rows = np.column_stack([still, weight])
    both = _trailing(rows, keeps) + _trailing(rows[::-1], keeps[::-1])[::-1] - rows
    return unit(np.einsum("nij,nj->ni", attitude, both[:, :3] / both[:, 3:]))


def _trailing(rows: FloatArray, keeps: FloatArray) -> FloatArray:
    """Return the sum of all rows up to each, faded by what the steps between keep."""
    # Loaded only by who looks at a drive, as in `chain`.
    from scipy.linalg import solve_banded

    band = np.ones((2, len(rows)))
    band[1] = np.append(-keeps, 0.0)
    return np.asarray(solve_banded((1, 0), band, rows, check_finite=False))
