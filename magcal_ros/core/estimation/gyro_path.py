"""Gyro-propagated attitudes relative to the first sample, and how errors drift into them."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from magcal_ros.core.estimation.effects import Effect, Effects, pull
from magcal_ros.core.estimation.model import Samples
from magcal_ros.core.estimation.pace import Pace, attitudes, averages, pace_of
from magcal_ros.core.geometry.arrays import FloatArray, IntArray
from magcal_ros.core.geometry.attitude import unit, wrap_angle
from magcal_ros.core.geometry.circle3d import fit_circle_robustly
from magcal_ros.core.geometry.rotations import axial_vectors, rotation_vectors
from magcal_ros.core.samples.rest import RestBeside
from magcal_ros.core.samples.window import Window

CLEAR_SENSE = 0.5
"""Correlation of gyro and field from which the sense of the mounting is taken as shown."""


@dataclass(frozen=True)
class GyroErrors:
    """What is known beforehand of the gyro's and the accelerometer's lasting errors.

    Parameters
    ----------
    bias : float
        Sigma of the gyro's bias, rad/s per axis: about 0.2 degrees a second, of consumer MEMS.
    rested_bias : float
        The same where a rest before or after the turn showed it and it was taken off: what a bias
        changes by from rest to motion.
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
    rested_bias: float = 0.0005
    scale: float = 0.02
    acceleration: float = 0.1
    follows: float = 0.75
    doubtful_bias: float = 0.05
    knot_spacing: float = 1.0
    most_knots: int = 12
    longest_spacing: float = 5.0
    most_of_all: int = 72

    def after_rest(self, sigma: float) -> GyroErrors:
        """Return what is known where a rest has shown the bias, by so many rad/s per axis."""
        return replace(self, bias=min(self.bias, math.hypot(self.rested_bias, sigma)))

    def knots(self, seconds: float) -> int:
        """Return how many knots a window of so many seconds has."""
        most = max(self.most_knots, math.ceil(seconds / self.longest_spacing))
        return min(math.ceil(seconds / self.knot_spacing), most, self.most_of_all)


BIAS = slice(3, 6)
SCALE = slice(6, 9)
FIRST_KNOT = 9
"""Where the errors stand in their vector: start (3), bias, scale, knots, effects."""


@dataclass(frozen=True, eq=False)
class RestOnPath:
    """A rest right before or after a turn, and where the gyro saw the robot stand.

    Parameters
    ----------
    relative : ndarray, shape (3, 3)
        Rotation from the first sample's body axes to those at rest.
    is_before : bool
    seen : RestBeside
    """

    relative: FloatArray
    is_before: bool
    seen: RestBeside


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
    pace : Pace
        How fast the robot turned.
    effects : Effects
        What else the samples are wrong by. Their numbers come last among the errors.
    rests : tuple of RestOnPath
        Where the robot stood beside the turn, which shows the gyro's bias.
    is_doubted : bool
        Whether the gyro is taken for worse than gyros usually are.
    """

    relative: FloatArray
    basis: FloatArray
    knots: int
    spacing: float
    pace: Pace
    effects: Effects
    known: GyroErrors = GyroErrors()
    rests: tuple[RestOnPath, ...] = ()
    is_doubted: bool = False

    @property
    def size(self) -> int:
        """Number of errors."""
        return int(self.basis.shape[2]) + len(self.effects)

    def found(self, errors: FloatArray, kind: Effect) -> FloatArray:
        """Return an effect's numbers among the errors; none where it is not estimated."""
        return np.asarray(errors[int(self.basis.shape[2]) :][self.effects.where(kind)])

    def added(self, errors: FloatArray) -> FloatArray:
        """Return what the effects add to up and field, shape (n, 6)."""
        return np.asarray(self.effects.columns @ errors[int(self.basis.shape[2]) :])

    def with_effects(self, effects: Effects) -> GyroPath:
        """Return the path with further effects."""
        return replace(self, effects=self.effects.plus(effects))

    def with_acceleration(self) -> GyroPath:
        """Return the path of a robot that may be pulled while it turns."""
        return self.with_effects(pull(self.pace, self.known.acceleration, self.known.follows))

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
        place = np.arange(int(self.basis.shape[2]), self.size)
        information[place, place] = self.effects.sigma**-2.0
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
    attitude = attitudes(window)
    back = np.swapaxes(attitude, 1, 2)
    step = np.diff(window.time)[:, None, None]
    turns = rotation_vectors(attitude[:-1] @ back[1:])
    by_bias = _cumulated(back, step)
    by_scale = _cumulated(back, turns[:, None, :])
    elapsed = window.time - window.time[0]
    knots = known.knots(float(elapsed[-1]))
    spacing = float(elapsed[-1]) / knots
    hats = np.maximum(0.0, 1.0 - np.abs(elapsed[:, None] / spacing - np.arange(1, knots + 1)))
    # Averaged part by part: the whole basis of a million samples would not fit in memory.
    by_bias, by_scale, hats = (averages(part, first) for part in (by_bias, by_scale, hats))
    count = len(first)
    by_knot = (hats[:, None, :, None] * np.eye(3)[None, :, None, :]).reshape(count, 3, -1)
    start = np.broadcast_to(np.eye(3), (count, 3, 3))
    basis = np.concatenate([start, by_bias, by_scale, by_knot], axis=2)
    pace, none = pace_of(window, turns, first), Effects.none(count)
    rests = tuple(_on_path(rest, window.time, attitude) for rest in window.rests)
    mean, known = _average_rotations(attitude, first), known.after_rest(window.bias_sigma)
    return GyroPath(mean, basis, knots, spacing, pace, none, known, rests)


def _on_path(rest: RestBeside, time: FloatArray, attitude: FloatArray) -> RestOnPath:
    row = int(np.argmin(np.abs(time - rest.beside)))
    return RestOnPath(rest.turned @ attitude[row], 2 * row < len(time), rest)


def _cumulated(values: FloatArray, step: FloatArray) -> FloatArray:
    mean = 0.5 * (values[1:] + values[:-1]) * step
    return np.concatenate([np.zeros_like(values[:1]), np.cumsum(mean, axis=0)])


def _average_rotations(rotations: FloatArray, first: IntArray) -> FloatArray:
    mean = averages(rotations, first)
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
    stride = max(1, len(points) // 60)
    field_turn = wrap_angle(np.diff(circle.phase(points)[::stride]))
    field_turn *= math.copysign(1.0, float(circle.normal @ axis))
    relative = path.relative[::stride]
    robot_turn = axial_vectors(relative[:-1] @ np.swapaxes(relative[1:], 1, 2)) @ axis
    together = float(field_turn @ robot_turn)
    size = float(np.linalg.norm(field_turn) * np.linalg.norm(robot_turn))
    return -1.0 if together > CLEAR_SENSE * size else 1.0
