"""Up, gyro bias and the robot's velocity, estimated together.

The accelerometer of a robot that speeds up, brakes or circles points away from up. The gyro
propagates up through this, but drifts. What tells them apart: up stays where it is in the world,
the velocity where it is in the body: in a steady circle it is accelerated by turn rate x velocity
for however long, and what is left is soon over.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from magcal_ros.core.geometry.arrays import FloatArray
from magcal_ros.core.geometry.rotations import exp_rotation, skew
from magcal_ros.core.geometry.vec3 import length
from magcal_ros.core.up.up_tuning import FilterTuning

IDENTITY: FloatArray = np.eye(3)


@dataclass(frozen=True)
class Motion:
    """How fast a robot may be, and how it may speed up and brake.

    Parameters
    ----------
    speed : float
        g s, sigma per axis.
    acceleration : float
        g, sigma per axis.
    """

    speed: float
    acceleration: float

    def step(self, seconds: float, lasting: tuple[float, float]) -> tuple[FloatArray, FloatArray]:
        """Return what is left of both after some seconds, and the variance that is new in them."""
        keeps = np.array([math.exp(-seconds / each) for each in lasting])
        return keeps, np.array([self.speed, self.acceleration]) ** 2 * (1.0 - keeps**2)


class UpFilter:
    """A Kalman filter on up (g), gyro bias (rad/s), velocity (g s) and acceleration (g), body axes.

    The accelerometer reads up + acceleration + turn rate x velocity. Up is a vector of any
    length, so that the model is linear and a scale error of the accelerometer is taken up by the
    length of up. Velocity and acceleration are Ornstein-Uhlenbeck processes of a `Motion`'s sizes.

    Parameters
    ----------
    tuning : FilterTuning
        What is taken for granted.
    """

    def __init__(self, tuning: FilterTuning | None = None) -> None:
        self.tuning = tuning or FilterTuning()
        self.state: FloatArray = np.zeros(12)
        self.covariance: FloatArray = np.zeros((12, 12))
        self.covariance[3:6, 3:6] = IDENTITY * self.tuning.bias_sigma**2

    @property
    def up(self) -> FloatArray:
        """Up over gravity, shape (3,)."""
        return self.state[:3]

    @property
    def bias(self) -> FloatArray:
        """The gyro's bias, rad/s, shape (3,)."""
        return self.state[3:6]

    @property
    def tilt_variance(self) -> float:
        """Variance of the direction of up, rad², the mean of its two directions."""
        up, own = self.state[:3], self.covariance[:3, :3]
        size = float(up @ up)
        if size <= 0.0:
            return self.tuning.unknown**2
        along = float(up @ own @ up) / size
        return max(0.0, (float(np.trace(own)) - along) / (2.0 * size))

    @property
    def bias_variance(self) -> float:
        """Variance of the bias about up, (rad/s)²."""
        x, y, z = self.state[:3].tolist()
        (a, b, c), (_, d, e), (_, _, f) = self.covariance[3:6, 3:6].tolist()
        square = x * x + y * y + z * z
        if square <= 0.0:
            return float(a + d + f)
        along = a * x * x + d * y * y + f * z * z + 2.0 * (b * x * y + c * x * z + e * y * z)
        return max(0.0, float(along / square))

    def begin(self, force: FloatArray, variance: float, rate: float, motion: Motion) -> None:
        """Start from one accelerometer reading (over gravity); what is known of the bias stays."""
        own = self.covariance[3:6, 3:6].copy()
        turning = _sideways(force, rate)
        self.covariance[:] = 0.0
        self.covariance[3:6, 3:6] = own
        self.covariance[6:9, 6:9] = IDENTITY * motion.speed**2
        self.covariance[9:, 9:] = IDENTITY * motion.acceleration**2
        moved = np.hstack([turning * motion.speed**2, IDENTITY * motion.acceleration**2])
        self.covariance[:3, 6:], self.covariance[6:, :3] = -moved, -moved.T
        self.covariance[:3, :3] = moved[:, :3] @ turning.T + moved[:, 3:] + IDENTITY * variance
        self.state[:3], self.state[6:] = force, 0.0

    def forget_acceleration(self, sigma: float) -> None:
        """From now on the linear acceleration may be another one."""
        self.covariance[9:] = 0.0
        self.covariance[:, 9:] = 0.0
        self.covariance[9:, 9:] = IDENTITY * sigma**2
        self.state[9:] = 0.0

    def predict(self, up: FloatArray, turned: FloatArray, seconds: float, motion: Motion) -> None:
        """Go on by a block of messages.

        Parameters
        ----------
        up : ndarray, shape (3,)
            Up after the block, propagated by the gyro less its bias.
        turned : ndarray, shape (3,)
            Radians that the body turned by, body axes.
        seconds : float
            How long the block took.
        motion : Motion
            How the robot may move.
        """
        angle = length(turned.tolist())
        lasting = (self.tuning.speed_lasts, self.tuning.acceleration_lasts)
        keeps, grows = motion.step(seconds, lasting)
        transition = np.zeros((12, 12))
        transition[:3, :3] = exp_rotation(-turned)
        transition[:3, 3:6] = -skew(up) * seconds
        transition[3:6, 3:6] = IDENTITY
        transition.flat[78::13] = np.repeat(keeps, 3)
        self.state[:3] = up
        self.state[6:] *= np.repeat(keeps, 3)
        self.covariance = transition @ self.covariance @ transition.T
        grown = self.tuning.angle_walk**2 * seconds + self.tuning.turn_error**2 * angle
        acceleration = length(self.state[9:].tolist())
        if acceleration > self.tuning.implausible * motion.acceleration:
            grown += acceleration**2 * seconds / self.tuning.regain
        added = [grown, self.tuning.bias_walk**2 * seconds, *grows]
        self.covariance.flat[::13] += np.repeat(added, 3)

    def observe_force(self, innovation: FloatArray, variance: float, rate: float) -> None:
        """Take the mean of accelerometer less propagated up over a block, and its variance.

        Parameters
        ----------
        innovation : ndarray, shape (3,)
            g.
        variance : float
            Of its noise, g².
        rate : float
            Of the turn about up meanwhile, rad/s. Rolling and pitching are shaking rather than
            turning, and an engine shakes sensor and seat in one time.
        """
        p, turning = self.covariance, _sideways(self.state[:3], rate)
        gain_rows = p[:, :3] + p[:, 6:9] @ turning.T + p[:, 9:]
        spread = gain_rows[:3] + turning @ gain_rows[6:9] + gain_rows[9:]
        spread += IDENTITY * (variance + self.tuning.floor**2)
        left = innovation - turning @ self.state[6:9] - self.state[9:]
        self._correct(gain_rows, spread, left)

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

        Parameters
        ----------
        rate : ndarray, shape (3,)
            rad/s.
        variance : float
            Of its noise, (rad/s)².
        axis : ndarray, shape (3,), or None
            Unit vector about which the robot may turn all the same, where there is one.
        """
        shown = IDENTITY if axis is None else IDENTITY - np.outer(axis, axis)
        gain_rows = self.covariance[:, 3:6] @ shown
        noise = IDENTITY * variance
        spread = shown @ gain_rows[3:6] + noise
        self._correct(gain_rows, spread, shown @ (rate - self.state[3:6]))

    def admit_bias(self, rate: FloatArray) -> None:
        """Allow for a bias that lies further off than what was known of it."""
        gap, own = rate - self.state[3:6], self.covariance[3:6, 3:6]
        if float(gap @ gap) > self.tuning.implausible**2 * float(np.trace(own)):
            own += IDENTITY * float(gap @ gap)

    def bound_bias(self) -> None:
        """Keep the bias within what a gyro can have."""
        size = length(self.state[3:6].tolist())
        if size > self.tuning.largest_bias:
            self.state[3:6] *= self.tuning.largest_bias / size

    def _correct(self, gain_rows: FloatArray, spread: FloatArray, innovation: FloatArray) -> None:
        gain = np.linalg.solve(spread, gain_rows.T).T
        self.state += gain @ innovation
        p = self.covariance - gain @ gain_rows.T
        self.covariance = 0.5 * (p + p.T)


def _sideways(up: FloatArray, rate: float) -> FloatArray:
    """Return what makes of a velocity its acceleration in a turn about up at a rate in rad/s."""
    size = length(up.tolist())
    return skew(up) * (rate / size) if size > 0.0 else np.zeros((3, 3))
