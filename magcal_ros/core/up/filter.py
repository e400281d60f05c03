"""Up, gyro bias and linear acceleration, estimated together.

The accelerometer of a robot that speeds up, brakes or circles points away from up. The gyro
propagates up through this, but drifts. What tells them apart: up stays where it is in the world,
the acceleration in a steady circle stays where it is in the body, and none lasts for ever.
"""

from __future__ import annotations

import math

import numpy as np

from magcal_ros.core.geometry.arrays import FloatArray
from magcal_ros.core.geometry.rotations import exp_rotation, skew
from magcal_ros.core.geometry.vec3 import length
from magcal_ros.core.up.up_tuning import FilterTuning

IDENTITY: FloatArray = np.eye(3)


class UpFilter:
    """A Kalman filter on up (g), gyro bias (rad/s) and linear acceleration (g), body axes.

    The accelerometer reads up + linear acceleration. Both are vectors of any length, so that the
    model is linear and a scale error of the accelerometer is taken up by the length of up.

    Parameters
    ----------
    tuning : FilterTuning
        What is taken for granted.
    """

    def __init__(self, tuning: FilterTuning | None = None) -> None:
        self.tuning = tuning or FilterTuning()
        self.state: FloatArray = np.zeros(9)
        self.covariance: FloatArray = np.zeros((9, 9))
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

    def begin(self, force: FloatArray, variance: float, acceleration_sigma: float) -> None:
        """Start from one accelerometer reading (over gravity); what is known of the bias stays."""
        own = self.covariance[3:6, 3:6].copy()
        self.covariance[:] = 0.0
        self.covariance[:3, :3] = IDENTITY * (variance + acceleration_sigma**2)
        self.covariance[3:6, 3:6] = own
        self.covariance[6:, 6:] = IDENTITY * acceleration_sigma**2
        self.covariance[:3, 6:] = self.covariance[6:, :3] = -IDENTITY * acceleration_sigma**2
        self.state[:3], self.state[6:] = force, 0.0

    def forget_acceleration(self, sigma: float) -> None:
        """From now on the linear acceleration may be another one."""
        self.covariance[6:] = 0.0
        self.covariance[:, 6:] = 0.0
        self.covariance[6:, 6:] = IDENTITY * sigma**2
        self.state[6:] = 0.0

    def predict(self, up: FloatArray, turned: FloatArray, seconds: float, sigma: float) -> None:
        """Go on by a block of messages.

        Parameters
        ----------
        up : ndarray, shape (3,)
            Up after the block, propagated by the gyro less its bias.
        turned : ndarray, shape (3,)
            Radians that the body turned by, body axes.
        seconds : float
            How long the block took.
        sigma : float
            How large a linear acceleration may be, g.
        """
        angle = length(turned.tolist())
        keeps = math.exp(-seconds / self.tuning.acceleration_lasts)
        transition = np.zeros((9, 9))
        transition[:3, :3] = exp_rotation(-turned)
        transition[:3, 3:6] = -skew(up) * seconds
        transition[3:6, 3:6] = IDENTITY
        transition[6:, 6:] = IDENTITY * keeps
        self.state[:3] = up
        self.state[6:] *= keeps
        grown = np.empty(9)
        grown[:3] = self.tuning.angle_walk**2 * seconds + self.tuning.turn_error**2 * angle
        grown[3:6] = self.tuning.bias_walk**2 * seconds
        grown[6:] = sigma**2 * (1.0 - keeps**2)
        acceleration = length(self.state[6:].tolist())
        if acceleration > self.tuning.implausible * sigma:
            grown[:3] += acceleration**2 * seconds / self.tuning.regain
        self.covariance = transition @ self.covariance @ transition.T
        self.covariance.flat[::10] += grown

    def observe_force(self, innovation: FloatArray, variance: float) -> None:
        """Take the mean of accelerometer less propagated up over a block, and its variance."""
        p = self.covariance
        gain_rows = p[:, :3] + p[:, 6:]
        spread = gain_rows[:3] + gain_rows[6:] + IDENTITY * (variance + self.tuning.floor**2)
        self._correct(gain_rows, spread, innovation - self.state[6:])

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
        noise = IDENTITY * (variance + self.tuning.steady_rate**2)
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
