"""Up for every sample of a window: what gyro and accelerometer know together.

An accelerometer on a robot that speeds, brakes or circles does not point up. The gyro carries up
from sample to sample but drifts. Carried to the axes of one moment, the accelerometer's readings
can be averaged over a while, forwards and backwards in time alike, so that a steady gyro bias
cancels; the average, carried back, is up.
"""

from __future__ import annotations

import numpy as np

from magcal_ros.core.arrays import FloatArray
from magcal_ros.core.attitude import unit
from magcal_ros.core.rotations import exp_rotations
from magcal_ros.core.window import Window

BY_HAND = 2.5
"""Seconds over which the accelerometer corrects the gyro."""
TURNS = 4.0
"""On a steady turn the average reaches over this many radians, so that a sideways pull cancels."""


def relative_attitudes(time: FloatArray, rate: FloatArray) -> FloatArray:
    """Return rotations from the first sample's body axes to each sample's, shape (n, 3, 3).

    Steps `exp(-[w]x dt)` with the mean rate between both ends, multiplied up by a parallel scan.
    The trapezoidal rule with its end correction (Euler-Maclaurin): a wobble of 2 Hz at 30 samples
    a second would lose a hundredth by the plain rule.

    Parameters
    ----------
    time : ndarray, shape (n,)
        Seconds.
    rate : ndarray, shape (n, 3)
        rad/s in body axes.
    """
    step = np.diff(time)[:, None]
    turned = 0.5 * step * (rate[1:] + rate[:-1])
    if len(time) > 2:
        turned -= step**2 / 12.0 * np.diff(np.gradient(rate, time, axis=0), axis=0)
    product = np.concatenate([np.eye(3)[None], exp_rotations(-turned)])
    reach = 1
    while reach < len(product):
        product[reach:] = product[reach:] @ product[:-reach]
        reach *= 2
    return np.asarray(product)


def correction_time(window: Window) -> float:
    """Return seconds over which the accelerometer should correct the gyro on this turn."""
    if window.angular_rate is None:
        return BY_HAND
    usual = float(np.median(np.linalg.norm(window.angular_rate, axis=1)))
    return max(BY_HAND, TURNS / max(usual, 1e-3))


def carried_up(window: Window, seconds: float | None = None) -> FloatArray:
    """Return up at each sample, unit vectors in body axes, shape (n, 3).

    Parameters
    ----------
    window : Window
        Without a gyro its accelerometer alone gives up.
    seconds : float, optional
        How far the average reaches; `correction_time` unless given.
    """
    raw = unit(window.specific_force)
    if window.angular_rate is None or len(window) < 3:
        return raw
    reach = correction_time(window) if seconds is None else seconds
    attitude = relative_attitudes(window.time, window.angular_rate)
    fixed = np.einsum("nji,nj->ni", attitude, raw)
    smooth = _both_ways(window.time, fixed, reach)
    return unit(np.einsum("nij,nj->ni", attitude, smooth))


def _both_ways(time: FloatArray, values: FloatArray, reach: float) -> FloatArray:
    """Average with weights exp(-|dt|/reach), by running sums that decay on their way."""
    decay = np.exp(-np.diff(time) / reach)
    columns = np.column_stack([values, np.ones(len(time))])
    total = _decaying(columns, decay) + _decaying(columns[::-1], decay[::-1])[::-1] - columns
    return np.asarray(total[:, :-1] / total[:, -1:])


def _decaying(values: FloatArray, decay: FloatArray) -> FloatArray:
    """Return s with s[0] = v[0] and s[k] = v[k] + decay[k-1] s[k-1], by a parallel scan."""
    total = values.copy()
    factor = np.concatenate([[0.0], decay])[:, None]
    reach = 1
    while reach < len(total):
        total[reach:] = total[reach:] + factor[reach:] * total[:-reach]
        factor[reach:] = factor[reach:] * factor[:-reach]
        factor[:reach] = 0.0
        reach *= 2
    return np.asarray(total)
