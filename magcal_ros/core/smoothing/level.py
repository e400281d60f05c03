"""Up all along a drive: the slow mean of the specific force in the axes that the gyro holds still.

Starts, stops and bends lean the accelerometer by ten degrees, but forth and back: over some tens of
seconds they cancel, and the gyro hardly drifts meanwhile.
"""

from __future__ import annotations

import numpy as np

from magcal_ros.core.geometry.arrays import FloatArray
from magcal_ros.core.geometry.attitude import unit
from magcal_ros.core.geometry.rotations import exp_rotations, skews
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
    keeps = np.exp(-np.maximum(np.diff(time), SMALLEST_STEP) / tuning.level_memory)
    bias = np.zeros(3)
    for _ in range(tuning.level_rounds):
        up = _averaged(time, force * weight[:, None], weight, rate - bias, keeps)
        bias = bias + _bias(time, up, rate - bias, tuning)
    return _averaged(time, force * weight[:, None], weight, rate - bias, keeps)


def _averaged(
    time: FloatArray, force: FloatArray, weight: FloatArray, rate: FloatArray, keeps: FloatArray
) -> FloatArray:
    attitude = relative_attitudes(time, rate)
    still = np.einsum("nji,nj->ni", attitude, force)
    rows = np.column_stack([still, weight])
    both = _trailing(rows, keeps) + _trailing(rows[::-1], keeps[::-1])[::-1] - rows
    return unit(np.einsum("nij,nj->ni", attitude, both[:, :3] / both[:, 3:]))


def _bias(time: FloatArray, up: FloatArray, rate: FloatArray, tuning: SmootherTuning) -> FloatArray:
    """Return the constant bias by which up drifts from where the gyro takes it, rad/s, (3,)."""
    seconds = np.diff(time)[:, None]
    steps = exp_rotations(-0.5 * (rate[1:] + rate[:-1]) * seconds)
    drift = up[1:] - np.einsum("nij,nj->ni", steps, up[:-1])
    across = -seconds[:, :, None] * skews(0.5 * (up[1:] + up[:-1]))
    known = (tuning.level_walk / tuning.level_bias) ** 2 * np.eye(3)
    normal = np.einsum("nki,nkj->ij", across, across / seconds[:, :, None]) + known
    return np.linalg.solve(normal, np.einsum("nki,nk->i", across, drift / seconds))


def _trailing(rows: FloatArray, keeps: FloatArray) -> FloatArray:
    """Return the sum of all rows up to each, faded by what the steps between keep."""
    # Loaded only by who looks at a drive, as in `chain`.
    from scipy.linalg import solve_banded

    band = np.ones((2, len(rows)))
    band[1] = np.append(-keeps, 0.0)
    return np.asarray(solve_banded((1, 0), band, rows, check_finite=False))
