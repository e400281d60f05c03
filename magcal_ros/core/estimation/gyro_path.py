"""Gyro-propagated attitudes relative to the first sample, and how errors drift into them."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from magcal_ros.core.estimation.model import Samples
from magcal_ros.core.geometry.arrays import FloatArray, IntArray
from magcal_ros.core.geometry.attitude import unit, wrap_angle
from magcal_ros.core.geometry.circle3d import fit_circle_robustly
from magcal_ros.core.samples.window import Window
from magcal_ros.core.up import relative_attitudes

SMOOTHED = 1.0
"""Seconds over which the turn rate is averaged before it is squared."""
CLEAR_SENSE = 0.5
"""Correlation of gyro and field from which the sense of the mounting is taken as shown."""


@dataclass(frozen=True)
class GyroErrors:
    """What is known beforehand of the gyro's and the accelerometer's lasting errors.

    Parameters
    ----------
    bias : float
        Sigma of the gyro's bias, rad/s per axis: about 0.2 degrees a second, of consumer MEMS.
    scale : float
        Sigma of its scale, per axis, relative.
    acceleration : float
        Sigma of the linear acceleration of the turn in body axes, over gravity: a car in a circle.
    follows : float
        By how much of its mean it grows with the relative square of the rate: one half where the
        speed is held, one where the radius is.
    doubtful_bias : float
        Sigma of the bias of a gyro that nobody knows anything good of, rad/s per axis.
    knot_spacing : float
        Seconds between the knots of the drift that neither bias nor scale explain.
    most_knots : int
        Bound on their number, which bounds the time of a fit; of a turn of a minute or less.
    longest_spacing, most_of_all : float, int
        Longer windows get more knots, so that they come no rarer than this, seconds, and never
        more of them than this: an attitude walks at random however long it is watched.
    """

    bias: float = 0.003
    scale: float = 0.02
    acceleration: float = 0.1
    follows: float = 0.75
    doubtful_bias: float = 0.05
    knot_spacing: float = 1.0
    most_knots: int = 12
    longest_spacing: float = 5.0
    most_of_all: int = 72

    def knots(self, seconds: float) -> int:
        """Return how many knots a window of so many seconds has."""
        most = max(self.most_knots, math.ceil(seconds / self.longest_spacing))
        return min(math.ceil(seconds / self.knot_spacing), most, self.most_of_all)


BIAS = slice(3, 6)
SCALE = slice(6, 9)
FIRST_KNOT = 9
ACCELERATION = 6
"""Where the errors stand in their vector: start (3), bias, scale, knots, linear acceleration."""
LARGEST_SWIFTNESS = 3.0
"""A jerk of the rate beyond so many means says nothing of the speed."""


@dataclass(frozen=True, eq=False)
class GyroPath:
    """Gyro-propagated attitudes, and the ways in which they may be wrong.

    The true attitude is `relative_i exp([e_i]x)` times the first attitude's error, with the error
    `e_i = basis_i c` in the axes of the first sample (doc/estimator.md, section 4).

    Parameters
    ----------
    relative : ndarray, shape (n, 3, 3)
        Rotations from the first sample's body axes to each sample's.
    basis : ndarray, shape (n, 3, b)
        Start (3), bias (3, rad/s), scale (3), then three a knot.
    knots : int
        Number of knots.
    spacing : float
        Seconds between knots.
    known : GyroErrors
        Their priors.
    swiftness : ndarray, shape (n,)
        Square of the turn rate over its mean, less one: a circle's acceleration follows it where
        the radius is held, and does not where the speed is.
    accelerated : bool
        Whether a linear acceleration of the turn is estimated too. Its six errors come last: what
        up vectors read too much in body axes on average, and by how much more than `known.follows`
        of it that grows with `swiftness`.
    is_doubted : bool
        Whether the gyro is taken for worse than gyros usually are.
    """

    relative: FloatArray
    basis: FloatArray
    knots: int
    spacing: float
    swiftness: FloatArray
    known: GyroErrors = GyroErrors()
    accelerated: bool = False
    is_doubted: bool = False

    @property
    def size(self) -> int:
        """Number of errors."""
        return int(self.basis.shape[2]) + ACCELERATION * int(self.accelerated)

    def acceleration(self, errors: FloatArray) -> FloatArray:
        """Return the mean linear acceleration among the errors, over gravity, shape (3,)."""
        return errors[-6:-3] if self.accelerated else np.zeros(3)

    def accelerations(self, errors: FloatArray) -> FloatArray:
        """Return the linear acceleration at each sample, over gravity, shape (n, 3)."""
        swift = self.swiftness[:, None]
        return (1.0 + self.known.follows * swift) * errors[-6:-3] + swift * errors[-3:]

    def with_doubtful_gyro(self) -> GyroPath:
        """Return the path of a gyro whose bias may be large."""
        known = replace(self.known, bias=self.known.doubtful_bias)
        return replace(self, known=known, is_doubted=True)

    def turned(self, turn: FloatArray) -> GyroPath:
        """Return the path of a gyro whose axes are turned into others, `turn` shape (3, 3).

        The errors of its start, bias and drift then speak in the new axes, its scale in its own.
        """
        basis = turn @ self.basis
        for first in (0, BIAS.start, *range(FIRST_KNOT, basis.shape[2], 3)):
            basis[:, :, first : first + 3] = basis[:, :, first : first + 3] @ turn.T
        return replace(self, relative=turn @ self.relative @ turn.T, basis=basis, is_doubted=True)

    def bias_in_sigmas(self, errors: FloatArray) -> float:
        """Return the gyro's bias in sigmas of its prior."""
        return float(np.linalg.norm(errors[BIAS])) / self.known.bias

    def prior_information(self, drift: float) -> FloatArray:
        """Return the prior information on the errors, shape (c, c).

        Parameters
        ----------
        drift : float
            Random walk between knots, radians per root second.
        """
        information = np.zeros((self.size, self.size))
        information[BIAS, BIAS] = np.eye(3) / self.known.bias**2
        information[SCALE, SCALE] = np.eye(3) / self.known.scale**2
        if self.knots > 0:
            difference = np.eye(self.knots) - np.eye(self.knots, k=-1)
            walk = difference.T @ difference / (drift**2 * self.spacing)
            information[self.drifts, self.drifts] = np.kron(walk, np.eye(3))
        if self.accelerated:
            information[-6:, -6:] = np.eye(6) / self.known.acceleration**2
        return information

    @property
    def drifts(self) -> slice:
        """Where the knots stand among the errors."""
        return slice(FIRST_KNOT, FIRST_KNOT + 3 * self.knots)

    def knot_steps(self, errors: FloatArray) -> FloatArray:
        """Return the drift from knot to knot, shape (knots, 3), radians."""
        return np.diff(errors[self.drifts].reshape(-1, 3), axis=0, prepend=np.zeros((1, 3)))


def gyro_path(window: Window, first: IntArray, known: GyroErrors = GyroErrors()) -> GyroPath:
    """Integrate the gyro of a window.

    Parameters
    ----------
    window : Window
        With angular rate.
    first : ndarray of int
        Where each averaged stretch begins; attitudes are averaged over the stretches likewise.
    known : GyroErrors
    """
    if window.angular_rate is None:
        raise ValueError("the window has no angular rate")
    attitude = relative_attitudes(window.time, window.angular_rate)
    back = np.swapaxes(attitude, 1, 2)
    step = np.diff(window.time)
    by_bias = _cumulated(back, step)
    by_scale = _cumulated(back * window.angular_rate[:, None, :], step)
    elapsed = window.time - window.time[0]
    knots = known.knots(float(elapsed[-1]))
    spacing = float(elapsed[-1]) / knots
    hats = np.maximum(0.0, 1.0 - np.abs(elapsed[:, None] / spacing - np.arange(1, knots + 1)))
    # Averaged part by part: the whole basis of a million samples would not fit in memory.
    by_bias, by_scale, hats = (_averages(part, first) for part in (by_bias, by_scale, hats))
    count = len(first)
    by_knot = (hats[:, None, :, None] * np.eye(3)[None, :, None, :]).reshape(count, 3, -1)
    start = np.broadcast_to(np.eye(3), (count, 3, 3))
    basis = np.concatenate([start, by_bias, by_scale, by_knot], axis=2)
    swift = _averages(_swiftness(window.time, window.angular_rate), first)
    return GyroPath(_average_rotations(attitude, first), basis, knots, spacing, swift, known)


def _swiftness(time: FloatArray, rate: FloatArray) -> FloatArray:
    """Return the square of the turn rate over its mean, less one, smoothed over a second; (n,)."""
    mean = rate.mean(axis=0)
    about = rate @ unit(mean) if mean.any() else rate[:, 2]
    turned = np.concatenate([[0.0], np.cumsum(0.5 * (about[1:] + about[:-1]) * np.diff(time))])
    ahead = np.minimum(time + 0.5 * SMOOTHED, time[-1])
    behind = np.maximum(time - 0.5 * SMOOTHED, time[0])
    smooth = (np.interp(ahead, time, turned) - np.interp(behind, time, turned)) / np.maximum(
        ahead - behind, 1e-6
    )
    square = smooth**2
    relative = square / max(float(square.mean()), 1e-12) - 1.0
    return np.asarray(np.clip(relative, -1.0, LARGEST_SWIFTNESS))


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


def sense_of_mounting(samples: Samples, path: GyroPath) -> float:
    """Return -1 where gyro and field turn the same way round, else +1.

    In the body the field turns against the robot. Where it follows, the magnetometer sits upside
    down.
    """
    points = samples.field @ np.linalg.inv(samples.mounting).T
    circle = fit_circle_robustly(points)
    axis = unit(samples.up.mean(axis=0))
    normal = circle.normal * math.copysign(1.0, float(circle.normal @ axis))
    plane = np.linalg.svd(normal[None])[2][1:]
    plane[1] = np.cross(normal, plane[0])
    x, y = plane @ (points - circle.centre).T
    stride = max(1, len(points) // 60)
    field_turn = wrap_angle(np.diff(np.arctan2(y, x)[::stride]))
    relative = path.relative[::stride]
    between = relative[1:] @ np.swapaxes(relative[:-1], 1, 2)
    # between = exp(-[w]x dt), whose antisymmetric part holds -w dt
    turned = 0.5 * (between[:, [0, 1, 2], [1, 2, 0]] - between[:, [1, 2, 0], [0, 1, 2]])
    robot_turn = turned[:, [1, 2, 0]] @ axis
    together = float(field_turn @ robot_turn)
    size = float(np.linalg.norm(field_turn) * np.linalg.norm(robot_turn))
    return -1.0 if together > CLEAR_SENSE * size else 1.0
