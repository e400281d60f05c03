"""Up, gyro bias and the robot's velocity, estimated together.

The accelerometer of a robot that speeds up, brakes or circles points away from up. The gyro
propagates up through this, but drifts. What separates them: up stays where it is in the world,
the velocity where it is in the body: in a steady circle it is accelerated by turn rate x velocity
for however long, and what is left is soon over.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from magcal_ros.core.geometry.arrays import FloatArray
from magcal_ros.core.geometry.rotations import exp_rotation
from magcal_ros.core.geometry.vec3 import Triple, length
from magcal_ros.core.up.up_tuning import CLEAR, FILTER

IDENTITY: FloatArray = np.eye(3)


class MotionPrior(NamedTuple):
    """How fast a robot may be (g s), and how it may speed up and brake (g): sigmas per axis."""

    speed: float
    acceleration: float


class UpFilter:
    """A Kalman filter on up (g), gyro bias (rad/s), velocity (g s) and acceleration (g), body axes.

    The accelerometer reads up + acceleration + turn rate x velocity. Up is a vector of any
    length, so that the model is linear and a scale error of the accelerometer is taken up by the
    length of up. Velocity and acceleration are Ornstein-Uhlenbeck processes of the sizes of a
    `MotionPrior`.
    """

    def __init__(self) -> None:
        self.state: FloatArray = np.zeros(12)
        self.covariance: FloatArray = np.zeros((12, 12))
        self.covariance[3:6, 3:6] = IDENTITY * FILTER.bias_sigma**2
        self._transition = np.eye(12)
        self._reads: FloatArray = np.hstack([IDENTITY, np.zeros((3, 6)), IDENTITY])

    @property
    def up(self) -> FloatArray:
        """Up over gravity, shape (3,)."""
        return self.state[:3]

    @property
    def tilt_variance(self) -> float:
        """Variance of the direction of up, rad², the mean of its two directions."""
        _, across, square = self._by_up(0)
        return max(0.0, across) / (2.0 * square) if square > 0.0 else 1.0

    @property
    def bias_variance(self) -> float:
        """Variance of the bias about up, (rad/s)²."""
        along, across, square = self._by_up(3)
        return max(0.0, along) if square > 0.0 else across

    def _by_up(self, first: int) -> Triple:
        """Return the variance of three unknowns along up and across it, and the square of up."""
        x, y, z = self.state[:3].tolist()
        own = self.covariance[first : first + 3, first : first + 3]
        (a, b, c), (_, d, e), (_, _, f) = own.tolist()
        square = x * x + y * y + z * z
        along = a * x * x + d * y * y + f * z * z + 2.0 * (b * x * y + c * x * z + e * y * z)
        along = along / square if square > 0.0 else 0.0
        return (along, a + d + f - along, square)

    def begin(self, force: FloatArray, variance: float, rate: float, motion: MotionPrior) -> None:
        """Start from one accelerometer reading (over gravity); what is known of the bias stays."""
        own = self.covariance[3:6, 3:6].copy()
        turning = _sideways(force.tolist(), rate)
        self.covariance[:] = 0.0
        self.covariance[3:6, 3:6] = own
        self.covariance[6:9, 6:9] = IDENTITY * motion.speed**2
        self.covariance[9:, 9:] = IDENTITY * motion.acceleration**2
        moved = np.hstack([turning * motion.speed**2, IDENTITY * motion.acceleration**2])
        self.covariance[:3, 6:], self.covariance[6:, :3] = -moved, -moved.T
        self.covariance[:3, :3] = moved[:, :3] @ turning.T + moved[:, 3:] + IDENTITY * variance
        self.state[:3], self.state[6:] = force, 0.0

    def forget_motion(self, motion: MotionPrior, is_faster: bool = False) -> None:
        """Allow for another linear acceleration from now on; for another speed if `is_faster`."""
        first = 6 if is_faster else 9
        self.covariance[first:] = self.covariance[:, first:] = 0.0
        self.state[first:] = 0.0
        sigmas = (motion.speed,) * 3 + (motion.acceleration,) * 3
        self.covariance[range(first, 12), range(first, 12)] = np.square(sigmas[first - 6 :])

    def predict(self, up: Triple, turned: Triple, seconds: float, motion: MotionPrior) -> None:
        """Go on by a block of messages.

        `up` is up after the block, propagated by the gyro less its bias, `turned` the radians that
        the body turned by in body axes, and `motion` how the robot may move.
        """
        step = self._transition
        fast = math.exp(-seconds / FILTER.speed_lasts)
        kept = math.exp(-seconds / FILTER.acceleration_lasts)
        step[:3, :3] = exp_rotation(np.array(turned))
        step[:3, :3] = step[:3, :3].T
        x, y, z = (seconds * each for each in up)
        step[:3, 3:6] = ((0.0, z, -y), (-z, 0.0, x), (y, -x, 0.0))
        step.reshape(-1)[78::13] = (fast, fast, fast, kept, kept, kept)
        self.state[:3] = up
        self.state[6:9] *= fast
        self.state[9:] *= kept
        grown = FILTER.angle_walk**2 * seconds + FILTER.turn_error**2 * length(turned)
        acceleration = length(self.state[9:].tolist())
        if acceleration > CLEAR * math.sqrt(3.0) * motion.acceleration:
            grown += acceleration**2 * seconds / FILTER.regain
        p = step @ self.covariance @ step.T
        walked = FILTER.bias_walk**2 * seconds
        sped = motion.speed**2 * (1.0 - fast**2)
        shoved = motion.acceleration**2 * (1.0 - kept**2)
        p.reshape(-1)[::13] += [each for each in (grown, walked, sped, shoved) for _ in range(3)]
        self.covariance = p

    def observe_force(self, innovation: FloatArray, variance: float, rate: float) -> None:
        """Take the mean of accelerometer less propagated up over a block, and its variance.

        `innovation` (3,) and the `variance` of its noise are in g and g². `rate` is that of the
        turn about up meanwhile, rad/s. Rolling and pitching are shaking rather than turning, and an
        engine shakes sensor and seat in one time.
        """
        reads = self._reads
        reads[:, 6:9] = _sideways(self.state[:3].tolist(), rate)
        left = innovation - reads[:, 6:] @ self.state[6:]
        self._correct(reads, variance + FILTER.floor**2, left)

    def observe_length(self, size: float, variance: float) -> None:
        """Take what the accelerometer reads at rest, over gravity."""
        up = self.state[:3]
        own = length(up.tolist())
        if own > 0.0:
            gain_rows = self.covariance[:, :3] @ (up / own)
            spread = float(gain_rows[:3] @ up) / own + variance
            self.state += gain_rows * ((size - own) / spread)
            self.covariance -= gain_rows[:, None] * (gain_rows / spread)

    def observe_bias(self, rate: FloatArray, variance: float, axis: FloatArray | None) -> None:
        """Take the mean rate of a block of a robot that does not turn.

        `rate` (3,) is in rad/s, `variance` of its noise in (rad/s)². `axis` is the unit vector
        about which the robot may turn all the same, where there is one.
        """
        shown = IDENTITY if axis is None else IDENTITY - np.outer(axis, axis)
        reads = np.zeros((3, 12))
        reads[:, 3:6] = shown
        self._correct(reads, variance, shown @ (rate - self.state[3:6]))

    def admit_bias(self, rate: FloatArray) -> None:
        """Allow for a bias that lies further off than what was known of it."""
        gap, own = rate - self.state[3:6], self.covariance[3:6, 3:6]
        if float(gap @ gap) > CLEAR**2 * float(np.trace(own)):
            own += IDENTITY * float(gap @ gap)

    def _correct(self, reads: FloatArray, variance: float, innovation: FloatArray) -> None:
        """Take three readings that differ from what was expected, and how they read the state."""
        rows = reads @ self.covariance
        (a, b, c), (_, d, e), (_, _, f) = (reads @ rows.T).tolist()
        a, d, f = a + variance, d + variance, f + variance
        p, q, r = d * f - e * e, c * e - b * f, b * e - c * d
        s, t, u = a * f - c * c, b * c - a * e, a * d - b * b
        inverse = np.array([[p, q, r], [q, s, t], [r, t, u]]) / (a * p + b * q + c * r)
        gain = rows.T @ inverse
        self.state += gain @ innovation
        p = self.covariance - gain @ rows
        self.covariance = 0.5 * (p + p.T)


def _sideways(up: Triple, rate: float) -> FloatArray:
    """Return what makes of a velocity its acceleration in a turn about up at a rate in rad/s."""
    size = length(up)
    x, y, z = (rate / size * each for each in up) if size > 0.0 else (0.0, 0.0, 0.0)
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
