"""Up, gyro bias and pull, estimated together.

A robot that speeds up, brakes or circles is pulled, and its accelerometer points away from up. The
gyro carries up through this, but drifts. What tells them apart: up stays where it is in the world,
the pull of a steady circle stays where it is in the body, and no pull lasts for ever.
"""

from __future__ import annotations

import math

import numpy as np

from magcal_ros.core.arrays import FloatArray
from magcal_ros.core.attitude import STANDARD_GRAVITY
from magcal_ros.core.rotations import exp_rotation, skew

UNKNOWN = 1.0
"""Sigma of an up of which nothing is known, over gravity."""
BIAS_SIGMA = 0.004
"""rad/s. A gyro's bias before anything is known of it."""
BIAS_WALK = 1e-4
"""rad/s per root second."""
ANGLE_WALK = 3e-4
"""Radians per root second: what a gyro loses while it does not turn."""
TURN_ERROR = 0.003
"""Share of a turn that scale and axes of the gyro get wrong, per root radian."""
USUAL_PULL = 0.1
"""Acceleration over gravity that a robot under way must be thought capable of."""
USUAL_SPEED = 4.0
"""m/s. A turn at this speed pulls sideways by speed times turn rate."""
PULL_LASTS = 5.0
"""Seconds."""
STEADY_PULL = 2e-3
"""Acceleration over gravity of a robot that stands or rolls steadily."""
STEADY_RATE = 2e-3
"""rad/s that the mean of a block may still be off the bias while the robot is steady."""
FLOOR = 2e-3
"""Error of an averaged accelerometer reading over gravity that no averaging takes away."""
IMPLAUSIBLE = 3.0
"""Sigmas of pull beyond which rather up is wrong."""
REGAIN = 3.0
"""Seconds in which an up that was wrong is given up."""
REST_LENGTH, REST_LENGTH_SIGMA = 1.0, 0.02
"""What an accelerometer reads at rest, over gravity, before it was seen at rest."""

IDENTITY: FloatArray = np.eye(3)


class UpFilter:
    """A Kalman filter on up (over gravity), gyro bias (rad/s) and pull (over gravity), body axes.

    The accelerometer reads up + pull. Both are vectors of any length, so that the model is
    linear and a scale error of the accelerometer is taken up by the length of up.
    """

    def __init__(self) -> None:
        self.state: FloatArray = np.zeros(9)
        self.covariance: FloatArray = np.zeros((9, 9))
        self.covariance[3:6, 3:6] = IDENTITY * BIAS_SIGMA**2

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
            return UNKNOWN**2
        along = float(up @ own @ up) / size
        return max(0.0, (float(np.trace(own)) - along) / (2.0 * size))

    def begin(self, force: FloatArray, variance: float, pull_sigma: float) -> None:
        """Start from one accelerometer reading (over gravity); what is known of the bias stays."""
        own = self.covariance[3:6, 3:6].copy()
        self.covariance[:] = 0.0
        self.covariance[:3, :3] = IDENTITY * (variance + pull_sigma**2)
        self.covariance[3:6, 3:6] = own
        self.covariance[6:, 6:] = IDENTITY * pull_sigma**2
        self.covariance[:3, 6:] = self.covariance[6:, :3] = -IDENTITY * pull_sigma**2
        self.state[:3], self.state[6:] = force, 0.0

    def forget_pull(self, sigma: float) -> None:
        """From now on the pull may be another one."""
        self.covariance[6:] = 0.0
        self.covariance[:, 6:] = 0.0
        self.covariance[6:, 6:] = IDENTITY * sigma**2
        self.state[6:] = 0.0

    def predict(self, up: FloatArray, turned: FloatArray, seconds: float, sigma: float) -> None:
        """Go on by a block of messages.

        Parameters
        ----------
        up : ndarray, shape (3,)
            Up after the block, carried by the gyro less its bias.
        turned : ndarray, shape (3,)
            Radians that the body turned by, body axes.
        seconds : float
            How long the block took.
        sigma : float
            How large a pull may be, over gravity.
        """
        angle = float(np.linalg.norm(turned))
        keeps = math.exp(-seconds / PULL_LASTS)
        carry = np.zeros((9, 9))
        carry[:3, :3] = exp_rotation(-turned)
        carry[:3, 3:6] = -skew(up) * seconds
        carry[3:6, 3:6] = IDENTITY
        carry[6:, 6:] = IDENTITY * keeps
        self.state[:3] = up
        self.state[6:] *= keeps
        grown = np.empty(9)
        grown[:3] = ANGLE_WALK**2 * seconds + TURN_ERROR**2 * angle
        grown[3:6] = BIAS_WALK**2 * seconds
        grown[6:] = sigma**2 * (1.0 - keeps**2)
        pull = float(np.linalg.norm(self.state[6:]))
        if pull > IMPLAUSIBLE * sigma:
            grown[:3] += pull**2 * seconds / REGAIN
        self.covariance = carry @ self.covariance @ carry.T
        self.covariance.flat[::10] += grown

    def observe_force(self, innovation: FloatArray, variance: float) -> None:
        """Take the mean of accelerometer less carried up over a block, and its variance."""
        p = self.covariance
        gain_rows = p[:, :3] + p[:, 6:]
        spread = gain_rows[:3] + gain_rows[6:] + IDENTITY * (variance + FLOOR**2)
        self._correct(gain_rows, spread, innovation - self.state[6:])

    def observe_length(self, size: float, variance: float) -> None:
        """Take what the accelerometer reads at rest, over gravity."""
        up = self.state[:3]
        length = float(np.linalg.norm(up))
        if length > 0.0:
            gain_rows = self.covariance[:, :3] @ (up / length)
            spread = float(gain_rows[:3] @ up) / length + variance
            self.state += gain_rows * ((size - length) / spread)
            self.covariance -= np.outer(gain_rows, gain_rows / spread)

    def observe_bias(self, rate: FloatArray) -> None:
        """Take the mean rate of a block (rad/s) of a robot that does not turn."""
        p = self.covariance
        spread = p[3:6, 3:6] + IDENTITY * STEADY_RATE**2
        self._correct(p[:, 3:6].copy(), spread, rate - self.state[3:6])

    def _correct(self, gain_rows: FloatArray, spread: FloatArray, innovation: FloatArray) -> None:
        gain = np.linalg.solve(spread, gain_rows.T).T
        self.state += gain @ innovation
        p = self.covariance - gain @ gain_rows.T
        self.covariance = 0.5 * (p + p.T)


def pull_sigma(rate: float) -> float:
    """Return how large a pull over gravity may be at a turn rate in rad/s."""
    return math.hypot(USUAL_PULL, USUAL_SPEED * rate / STANDARD_GRAVITY)
