"""Yaw, gyro bias and the field's disturbance, estimated together.

What tells the disturbance from an error of the yaw: it changes with the place within seconds of
driving, and an error of the propagated yaw stays. Plain floats: this is on the path of every
message.
"""

from __future__ import annotations

import math


class YawFilter:
    """A Kalman filter on the error of a propagated yaw, the gyro's bias about up, and disturbance.

    Attributes
    ----------
    bias : float
        rad/s about up.
    disturbance : float
        Radians by which the field of the place turns the compass.
    yaw_variance : float
        rad².
    """

    def __init__(self) -> None:
        self.begin(0.0, 0.0, 0.0)

    def begin(self, yaw_variance: float, bias_variance: float, disturbance: float) -> None:
        """Start from a compass reading.

        Parameters
        ----------
        yaw_variance : float
            Of the reading, but for the disturbance, rad².
        bias_variance : float
            (rad/s)².
        disturbance : float
            Variance of the disturbance, rad².
        """
        self.bias = self.disturbance = 0.0
        self.yaw_variance = yaw_variance + disturbance
        self._bias, self._disturbance = bias_variance, disturbance
        # The yaw is wrong by what the disturbance is.
        self._yaw_disturbance = -disturbance
        self._yaw_bias = self._bias_disturbance = 0.0

    def propagate(self, seconds: float, lost: float, bias_lost: float) -> None:
        """Go on: the gyro loses so many rad² and (rad/s)² meanwhile."""
        bias_part = self._bias * seconds
        self.yaw_variance += (bias_part - 2.0 * self._yaw_bias) * seconds + lost
        self._yaw_bias -= bias_part
        self._yaw_disturbance -= seconds * self._bias_disturbance
        self._bias += bias_lost

    def move_on(self, share: float, variance: float) -> None:
        """Let the disturbance become another one.

        Parameters
        ----------
        share : float
            What is left of it, 0 to 1.
        variance : float
            That a disturbance has, rad².
        """
        self.disturbance *= share
        self._yaw_disturbance *= share
        self._bias_disturbance *= share
        self._disturbance = share * share * self._disturbance + (1.0 - share * share) * variance

    def widen(self, ratio: float) -> None:
        """Disturbances turn out to have so many times the variance that was thought."""
        self.yaw_variance *= ratio
        self._yaw_disturbance *= ratio
        self._disturbance *= ratio
        root = math.sqrt(ratio)
        self._yaw_bias *= root
        self._bias_disturbance *= root

    def doubt_yaw(self, variance: float) -> None:
        """Add to the variance of the yaw, rad²."""
        self.yaw_variance += variance

    def know_bias(self, variance: float) -> None:
        """Somebody else knows the bias better, and has taken it off the rate."""
        self.bias = self._yaw_bias = self._bias_disturbance = 0.0
        self._bias = variance

    @property
    def bias_variance(self) -> float:
        """Variance of the bias, (rad/s)²."""
        return self._bias

    def spread(self, noise: float) -> float:
        """Return the variance of compass less propagated yaw, with so much noise, rad²."""
        return self.yaw_variance + 2.0 * self._yaw_disturbance + self._disturbance + noise

    def observe(self, innovation: float, noise: float) -> float:
        """Take compass less propagated yaw; returns by what to correct the yaw, radians.

        Parameters
        ----------
        innovation : float
            Radians.
        noise : float
            Its variance beside that of the three, rad².
        """
        spread = self.spread(noise)
        left = (innovation - self.disturbance) / spread
        by_yaw = self.yaw_variance + self._yaw_disturbance
        by_bias = self._yaw_bias + self._bias_disturbance
        by_disturbance = self._yaw_disturbance + self._disturbance
        return self._correct(left, spread, by_yaw, by_bias, by_disturbance)

    def observe_yaw(self, innovation: float, noise: float) -> float:
        """Take a yaw that no field disturbs less the propagated one; otherwise as `observe`."""
        spread = self.yaw_variance + noise
        left = innovation / spread
        gains = self.yaw_variance, self._yaw_bias, self._yaw_disturbance
        return self._correct(left, spread, *gains)

    def _correct(
        self, left: float, spread: float, by_yaw: float, by_bias: float, by_disturbance: float
    ) -> float:
        """Take an innovation over its variance, by the covariances of the three with it."""
        self.bias += by_bias * left
        self.disturbance += by_disturbance * left
        self.yaw_variance -= by_yaw * by_yaw / spread
        self._bias -= by_bias * by_bias / spread
        self._disturbance -= by_disturbance * by_disturbance / spread
        self._yaw_bias -= by_yaw * by_bias / spread
        self._yaw_disturbance -= by_yaw * by_disturbance / spread
        self._bias_disturbance -= by_bias * by_disturbance / spread
        return by_yaw * left

    def follow(self, share: float, variance: float) -> None:
        """Give up a share of the yaw for a compass whose variance is smaller, rad²."""
        self.yaw_variance += share * (variance - self.yaw_variance)
        self._yaw_disturbance -= share * (self._disturbance + self._yaw_disturbance)
        self._yaw_bias *= 1.0 - share
