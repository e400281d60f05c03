"""How fast a robot turned at each sample of a window, as its gyro tells."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from magcal_ros.core.geometry.arrays import FloatArray, IntArray
from magcal_ros.core.geometry.attitude import unit
from magcal_ros.core.samples.window import Window
from magcal_ros.core.up import relative_attitudes


@dataclass(frozen=True)
class PaceTuning:
    """How a turn rate becomes a pace.

    Parameters
    ----------
    smooth, brisk : float
        Seconds over which the turn rate is averaged, for a pull and for motors.
    largest_swiftness : float
        A jerk of the rate beyond so many means says nothing of the speed.
    """

    smooth: float = 1.0
    brisk: float = 0.3
    largest_swiftness: float = 3.0


PACE = PaceTuning()


@dataclass(frozen=True, eq=False)
class Pace:
    """Turn rates, each averaged over the stretches of the fit's samples.

    Parameters
    ----------
    rate : ndarray, shape (n, 3)
        rad/s in body axes.
    axis : ndarray, shape (3,)
        The main axis of the turn in body axes, unit, upwards.
    about, swing : ndarray, shape (n,)
        Turn rate about it, rad/s, and how fast that changes, rad/s².
    swiftness : ndarray, shape (n,)
        Square of the turn rate over its mean, less one: a circle's acceleration follows it where
        the radius is held, and does not where the speed is.
    """

    rate: FloatArray
    axis: FloatArray
    about: FloatArray
    swing: FloatArray
    swiftness: FloatArray


def attitudes(window: Window) -> FloatArray:
    """Return rotations from the first sample's body axes to each sample's, shape (n, 3, 3)."""
    if window.turned is not None:
        return np.asarray(window.turned @ window.turned[0].T)
    assert window.angular_rate is not None
    return relative_attitudes(window.time, window.angular_rate)


def pace_of(window: Window, steps: FloatArray, first: IntArray) -> Pace:
    """Measure the pace of a window with a gyro.

    Parameters
    ----------
    window : Window
    steps : ndarray, shape (n - 1, 3)
        Rotation vectors from sample to sample, radians.
    first : ndarray of int
        Where each averaged stretch begins.
    """
    time, rate = window.time, window.angular_rate
    assert rate is not None
    axis = np.linalg.svd(rate, full_matrices=False)[2][0]
    axis = axis * (1.0 if axis @ window.specific_force.mean(axis=0) >= 0.0 else -1.0)
    brisk = _smooth(time, steps @ axis, PACE.brisk)
    mean = rate.mean(axis=0)
    square = _smooth(time, steps @ (unit(mean) if mean.any() else axis), PACE.smooth) ** 2
    swift = square / max(float(square.mean()), 1e-12) - 1.0
    return Pace(
        averages(rate, first),
        np.asarray(axis),
        averages(brisk, first),
        averages(np.gradient(brisk, time), first),
        averages(np.clip(swift, -1.0, PACE.largest_swiftness), first),
    )


def _smooth(time: FloatArray, steps: FloatArray, seconds: float) -> FloatArray:
    """Return the rate over so many seconds around each sample, from the turns between; (n,)."""
    turned = np.concatenate([[0.0], np.cumsum(steps)])
    ahead = np.minimum(time + 0.5 * seconds, time[-1])
    behind = np.maximum(time - 0.5 * seconds, time[0])
    between = np.interp(ahead, time, turned) - np.interp(behind, time, turned)
    return np.asarray(between / np.maximum(ahead - behind, 1e-6))


def averages(values: FloatArray, first: IntArray) -> FloatArray:
    """Average values (n, ...) over the stretches that begin at `first`."""
    count = np.diff(np.append(first, len(values)))
    mean = np.add.reduceat(values, first, axis=0).T / count
    return np.asarray(mean.T)
