"""The gyro: attitudes relative to the first sample, and how its errors drift into them."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from magcal_ros.core.arrays import FloatArray, IntArray
from magcal_ros.core.attitude import unit, wrap_angle
from magcal_ros.core.methods.maximum_likelihood.circle import fit_circle
from magcal_ros.core.methods.maximum_likelihood.model import Samples
from magcal_ros.core.up import relative_attitudes
from magcal_ros.core.window import Window

BIAS_SIGMA = 0.003
"""rad/s, about 0.2 degrees a second."""
SCALE_SIGMA = 0.02
KNOT_SPACING = 1.0
"""Seconds between the knots of the drift that neither bias nor scale explain."""
MOST_KNOTS = 12
CLEAR_SENSE = 0.5
OFFSET_SIGMA = 0.1
"""Steady sideways pull on the accelerometer, over gravity: a car in a circle."""


@dataclass(frozen=True, eq=False)
class Carrier:
    """Attitudes carried by the gyro, and the ways in which they may be wrong.

    The true attitude is `relative_i exp([e_i]x)` times the first attitude's error, with the error
    `e_i = basis_i c` in the axes of the first sample.

    Parameters
    ----------
    relative : ndarray, shape (n, 3, 3)
        Rotations from the first sample's body axes to each sample's.
    basis : ndarray, shape (n, 3, c)
        Start (3), bias (3, rad/s), scale (3), then three a knot.
    knots : int
        Number of knots.
    spacing : float
        Seconds between knots.
    sideways : bool
        Whether a steady offset of the accelerometer is to be found too. Its three coefficients
        come last: what up vectors read too much, in body axes.
    """

    relative: FloatArray
    basis: FloatArray
    knots: int
    spacing: float
    sideways: bool = False

    @property
    def size(self) -> int:
        """Number of coefficients."""
        return int(self.basis.shape[2]) + 3 * int(self.sideways)

    def offset(self, coefficients: FloatArray) -> FloatArray:
        """Return the accelerometer's offset, shape (3,)."""
        return coefficients[-3:] if self.sideways else np.zeros(3)

    def bias_pull(self, coefficients: FloatArray) -> float:
        """Return the gyro's bias in sigmas of what is believed of it."""
        return float(np.linalg.norm(coefficients[3:6])) / BIAS_SIGMA

    def prior_information(self, drift: float) -> FloatArray:
        """Return the information on the coefficients, shape (c, c).

        Parameters
        ----------
        drift : float
            Random walk between knots, radians per root second.
        """
        information = np.zeros((self.size, self.size))
        information[3:6, 3:6] = np.eye(3) / BIAS_SIGMA**2
        information[6:9, 6:9] = np.eye(3) / SCALE_SIGMA**2
        if self.knots > 0:
            difference = np.eye(self.knots) - np.eye(self.knots, k=-1)
            walk = difference.T @ difference / (drift**2 * self.spacing)
            last = 9 + 3 * self.knots
            information[9:last, 9:last] = np.kron(walk, np.eye(3))
        if self.sideways:
            information[-3:, -3:] = np.eye(3) / OFFSET_SIGMA**2
        return information

    def knot_steps(self, coefficients: FloatArray) -> FloatArray:
        """Return the drift from knot to knot, shape (knots, 3), radians."""
        knots = coefficients[9 : 9 + 3 * self.knots].reshape(-1, 3)
        return np.diff(knots, axis=0, prepend=np.zeros((1, 3)))


def carry(window: Window, first: IntArray) -> Carrier:
    """Integrate the gyro of a window.

    Parameters
    ----------
    window : Window
        With angular rate.
    first : ndarray of int
        Where each averaged stretch begins; attitudes are averaged over the stretches likewise.
    """
    if window.angular_rate is None:
        raise ValueError("the window has no angular rate")
    attitude = relative_attitudes(window.time, window.angular_rate)
    back = np.swapaxes(attitude, 1, 2)
    step = np.diff(window.time)
    by_bias = _cumulated(back, step)
    by_scale = _cumulated(back * window.angular_rate[:, None, :], step)
    elapsed = window.time - window.time[0]
    knots = min(MOST_KNOTS, math.ceil(float(elapsed[-1]) / KNOT_SPACING))
    spacing = float(elapsed[-1]) / knots
    hats = np.maximum(0.0, 1.0 - np.abs(elapsed[:, None] / spacing - np.arange(1, knots + 1)))
    # Averaged part by part: the whole basis of a million samples would not fit in memory.
    by_bias, by_scale, hats = (_averages(part, first) for part in (by_bias, by_scale, hats))
    count = len(first)
    by_knot = (hats[:, None, :, None] * np.eye(3)[None, :, None, :]).reshape(count, 3, -1)
    start = np.broadcast_to(np.eye(3), (count, 3, 3))
    basis = np.concatenate([start, by_bias, by_scale, by_knot], axis=2)
    return Carrier(_average_rotations(attitude, first), basis, knots, spacing)


def _cumulated(values: FloatArray, step: FloatArray) -> FloatArray:
    mean = 0.5 * (values[1:] + values[:-1]) * step[:, None, None]
    return np.concatenate([np.zeros_like(values[:1]), np.cumsum(mean, axis=0)])


def _averages(values: FloatArray, first: IntArray) -> FloatArray:
    count = np.diff(np.append(first, len(values)))
    mean = np.add.reduceat(values, first, axis=0).T / count
    return np.asarray(mean.T)


def _average_rotations(rotations: FloatArray, first: IntArray) -> FloatArray:
    mean = _averages(rotations, first)
    # Two Newton steps to the nearest rotation: the mean of a short stretch is nearly one.
    for _ in range(2):
        mean = mean @ (1.5 * np.eye(3) - 0.5 * np.swapaxes(mean, 1, 2) @ mean)
    return mean


def sense_of_mounting(samples: Samples, carrier: Carrier) -> float:
    """Return -1 where gyro and field turn the same way round, else +1.

    In the body the field turns against the robot. Where it follows, the magnetometer sits upside
    down.
    """
    points = samples.field @ np.linalg.inv(samples.mounting).T
    circle = fit_circle(points)
    axis = unit(samples.up.mean(axis=0))
    normal = circle.normal * math.copysign(1.0, float(circle.normal @ axis))
    plane = np.linalg.svd(normal[None])[2][1:]
    plane[1] = np.cross(normal, plane[0])
    x, y = plane @ (points - circle.centre).T
    stride = max(1, len(points) // 60)
    field_turn = wrap_angle(np.diff(np.arctan2(y, x)[::stride]))
    relative = carrier.relative[::stride]
    between = relative[1:] @ np.swapaxes(relative[:-1], 1, 2)
    # between = exp(-[w]x dt), whose antisymmetric part holds -w dt
    turned = 0.5 * (between[:, [0, 1, 2], [1, 2, 0]] - between[:, [1, 2, 0], [0, 1, 2]])
    robot_turn = turned[:, [1, 2, 0]] @ axis
    together = float(field_turn @ robot_turn)
    size = float(np.linalg.norm(field_turn) * np.linalg.norm(robot_turn))
    return -1.0 if together > CLEAR_SENSE * size else 1.0
