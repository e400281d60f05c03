"""Up for every sample of a window: the same filter forwards and backwards in time."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from magcal_ros.core.geometry.arrays import FloatArray
from magcal_ros.core.geometry.attitude import unit
from magcal_ros.core.geometry.rotations import exp_rotations
from magcal_ros.core.geometry.vec3 import Triple, length
from magcal_ros.core.samples.streams import SWAY, ImuSample
from magcal_ros.core.samples.window import Window
from magcal_ros.core.up.follower import UpFollower
from magcal_ros.core.up.up_tuning import FilterTuning

TUNING = FilterTuning()


def unseen_angles(time: FloatArray, rate: FloatArray) -> FloatArray:
    """Return the variances of the angles between samples, radians², shape (n - 1, 3).

    A body may sway between samples that come slowly as much as from one to the next. If all they
    show is sway too fast for them, as random as white noise, the variance is right.

    Parameters
    ----------
    time : ndarray, shape (n,)
        Seconds.
    rate : ndarray, shape (n, 3)
        rad/s.
    """
    step = np.diff(time)[:, None]
    square = np.zeros_like(rate)
    square[1:-1] = np.diff(rate, 2, axis=0) ** 2
    share = np.minimum(step / SWAY, 1.0) ** 4
    return np.asarray(share * step**2 * (square[:-1] + square[1:]) / 24.0)


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


def propagated_up(window: Window) -> FloatArray:
    """Return up at each sample, unit vectors in body axes, shape (n, 3).

    What the past and the future of a sample say of its up is averaged by their variances. A bias
    that is far beyond what is expected of a gyro holds for both as the whole past has shown it.
    """
    rate = window.angular_rate
    if rate is None or len(window) < 3:
        return unit(window.specific_force)
    past = _followed(window, rate)
    if length(past.bias) > TUNING.implausible * TUNING.bias_sigma:
        # Before it was known, it has led up astray by more than the variance says.
        rate = rate - past.bias
        past = _followed(window, rate)
    future = _followed(window, rate, backwards=True)
    return unit(past.up / past.variance + (future.up / future.variance)[::-1])


class _Followed(NamedTuple):
    """Up (n, 3) and its variance (n, 1) as the past of each sample gives it; the bias at last."""

    up: FloatArray
    variance: FloatArray
    bias: Triple


def _followed(window: Window, rate: FloatArray, backwards: bool = False) -> _Followed:
    way = -1 if backwards else 1
    follower = UpFollower()
    ups, variances = [], []
    columns = (
        values[::way].tolist()
        for values in (way * window.time, window.field, window.specific_force, way * rate)
    )
    for stamp, m, f, w in zip(*columns, strict=True):
        follower.add_field(stamp, tuple(m))
        follower.add(ImuSample(stamp, tuple(f), tuple(w)))
        up = follower.at(stamp, 0.0)
        assert up is not None
        ups.append(up.direction)
        variances.append([up.variance])
    return _Followed(np.array(ups), np.array(variances), follower.gyro_bias.rate)
