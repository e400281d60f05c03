"""Yaw, gyro bias and the field's disturbance, estimated together.

The disturbance changes with the place within seconds of driving, while an error of the propagated
yaw stays: this separates the two. Plain floats: this is on the path of every
message.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from magcal_ros.core.geometry.arrays import FloatArray


@dataclass(frozen=True)
class FusionTuning:
    """The Kalman filter on yaw, gyro bias and the field's disturbance."""

    angle_walk: float = 1e-3  # radians per root second that a gyro loses
    turn_error: float = 0.005  # share of a turn that the gyro's scale gets wrong, per root radian
    bias_sigma: float = 0.001  # rad/s about up that the up filter left, at the least
    bias_walk: float = 1.8e-5
    walk_spread: float = 1.0
    """Median of how much a gyro's bias walks, rad/s per root second, and standard deviation of its
    natural logarithm: cheap gyros drift in a minute by a thousandth to a hundredth of a degree per
    second."""
    loss_spread: float = 1.5
    """Standard deviation of the natural logarithm of the share of `angle_walk` and `turn_error`,
    squared, that a gyro has."""
    tilt_tau: float = 3.0
    """Seconds over which errors by tilt are correlated: more samples add no information."""
    noise_tau: float = 0.5  # the same for the field's noise and for small iron on the way
    small_iron: float = 0.3  # share of the disturbance's variance that changes within two metres
    moving_tau: float = 12.0
    """Seconds over which the disturbance of a moving robot is correlated: streets bend the field
    over 25 to 30 m, which is 0.7 after a second and gone after 12 s."""
    standing_tau: float = 300.0  # the same of a robot that stands
    learning_step: float = 0.1  # seconds after which the disturbance is learnt anew
    overruled_after: float = 3.0
    """Seconds of a good field that disagrees beyond all doubt, after which rather the propagated
    yaw is wrong."""
    beyond_doubt: float = 4.0
    """Squared gates of disagreement that count fully; what disagrees less needs longer."""
    heading_tau: float = 2.0
    """Seconds over which the error of a heading from another device is correlated."""
    heading_gate: float = 4.0  # sigmas by which such a heading may miss
    unknown: float = 0.5  # radians of uncertainty of a start in a field that is not expected
    start: float = 5.0  # seconds from the start in which that may be found out


FUSION = FusionTuning()


class YawFilter:
    """A Kalman filter on the error of a propagated yaw, the gyro's bias about up, and disturbance.

    `bias` is in rad/s about up, with `bias_variance`, and `disturbance` the angle by which the
    field of the place turns the compass. `yaw_variance` (rad²) is without the calibration's error,
    of which the `share` is in the yaw. `error` and `error_variance` are those of the calibration's
    own heading, as far as headings of another device show it, in its sigmas.
    """

    def __init__(self) -> None:
        self.begin(0.0, 0.0, 0.0)

    def begin(self, yaw_variance: float, bias_variance: float, disturbance: float) -> None:
        """Start from a compass reading.

        The variances are those of the reading but for the disturbance, rad², of the bias, (rad/s)²,
        and of the disturbance, rad².
        """
        self.bias = self.disturbance = 0.0
        self.yaw_variance = yaw_variance + disturbance
        self.bias_variance, self._disturbance = bias_variance, disturbance
        # The yaw is wrong by what the disturbance is.
        self._yaw_disturbance = -disturbance
        self._yaw_bias = self._bias_disturbance = 0.0
        self._know_nothing_of_error(1.0)

    def _know_nothing_of_error(self, share: float) -> None:
        self.share, self._bias_share, self._disturbance_share = share, 0.0, 0.0
        self.error, self.error_variance = 0.0, 1.0

    def use_another_calibration(self, lasting: float) -> None:
        """Go on where the calibration's sigma was `lasting`, radians; what it was stays in it."""
        self.yaw_variance += self.own_error_variance(lasting)
        self._know_nothing_of_error(0.0)

    def own_error_variance(self, lasting: float) -> float:
        """Return what the calibration adds to the yaw's variance at its sigma, radians."""
        return (self.share * lasting) ** 2 * self.error_variance

    def propagate(self, seconds: float, lost: float, bias_lost: float) -> None:
        """Go on: the gyro loses so many rad² and (rad/s)² meanwhile."""
        bias_part = self.bias_variance * seconds
        self.yaw_variance += (bias_part - 2.0 * self._yaw_bias) * seconds + lost
        self._yaw_bias -= bias_part
        self._yaw_disturbance -= seconds * self._bias_disturbance
        self.share += self._bias_share * seconds
        self.bias_variance += bias_lost

    def move_on(self, share: float, variance: float) -> None:
        """Let the disturbance become another one.

        `share` of it is left, 0 to 1, and `variance` is that of a disturbance, rad².
        """
        self.disturbance *= share
        self._yaw_disturbance *= share
        self._bias_disturbance *= share
        self._disturbance_share *= share
        self._disturbance = share * share * self._disturbance + (1.0 - share * share) * variance

    def widen(self, ratio: float) -> None:
        """Disturbances turn out to have so many times the variance that was thought."""
        root = math.sqrt(ratio)
        # As far as the yaw comes from the compass, it is wrong by them.
        yaw = 1.0 + self.share * (root - 1.0)
        self.yaw_variance *= yaw * yaw
        self._yaw_disturbance *= yaw * root
        self._disturbance *= ratio
        self._yaw_bias *= yaw
        self._bias_disturbance *= root

    def know_bias(self, variance: float) -> None:
        """Begin anew with a bias of which another filter has subtracted what it knows."""
        self.bias = self._yaw_bias = self._bias_disturbance = self._bias_share = 0.0
        self.bias_variance = variance

    def spread(self, noise: float, lasting: float = 0.0) -> float:
        """Return the variance of compass less propagated yaw, rad²; parameters as of `observe`."""
        apart = (1.0 - self.share + self._disturbance_share) * lasting
        own = self.yaw_variance + 2.0 * self._yaw_disturbance + self._disturbance
        return own + noise + apart * apart * self.error_variance

    def observe(self, innovation: float, noise: float, lasting: float) -> float:
        """Take compass less propagated yaw; returns by what to correct the yaw, radians.

        `innovation` is in radians, less what is known of the calibration's error, `noise` its
        variance beside that of the four, rad², and `lasting` the sigma of the calibration's error,
        radians.
        """
        by_yaw = self.yaw_variance + self._yaw_disturbance
        by_bias = self._yaw_bias + self._bias_disturbance
        by_disturbance = self._yaw_disturbance + self._disturbance
        spread, apart = self.spread(noise), 1.0 - self.share + self._disturbance_share
        left = innovation - self.disturbance
        return self._correct(left, spread, (by_yaw, by_bias, by_disturbance), apart, lasting)

    def observe_yaw(self, innovation: float, noise: float, lasting: float) -> float:
        """Take a yaw that no field disturbs less the propagated one; otherwise as `observe`."""
        gains = self.yaw_variance, self._yaw_bias, self._yaw_disturbance
        return self._correct(innovation, self.yaw_variance + noise, gains, -self.share, lasting)

    def _correct(
        self,
        left: float,
        spread: float,
        by: tuple[float, float, float],
        apart: float,
        lasting: float,
    ) -> float:
        """Take an innovation and its variance, by the covariances of yaw, bias and disturbance.

        All three are estimated as if the calibration's error were known; `apart` is the share of
        it in the innovation. From what is left then the error is estimated.
        """
        by_yaw, by_bias, by_disturbance = by[0] / spread, by[1] / spread, by[2] / spread
        self.bias += by_bias * left
        self.disturbance += by_disturbance * left
        self.yaw_variance -= by[0] * by_yaw
        self.bias_variance -= by[1] * by_bias
        self._disturbance -= by[2] * by_disturbance
        self._yaw_bias -= by[0] * by_bias
        self._yaw_disturbance -= by[0] * by_disturbance
        self._bias_disturbance -= by[1] * by_disturbance
        turned = by_yaw * left
        if apart:
            self.share += by_yaw * apart
            self._bias_share -= by_bias * apart
            self._disturbance_share -= by_disturbance * apart
            shown = apart * lasting
            gain = shown * self.error_variance / (spread + shown * shown * self.error_variance)
            self.error_variance *= 1.0 - gain * shown
            self.error += gain * left
            error = gain * left * lasting
            turned -= self.share * error
            self.bias += self._bias_share * error
            self.disturbance += self._disturbance_share * error
        return turned

    def follow(self, share: float, variance: float) -> None:
        """Give up a share of the yaw for a compass whose variance is smaller, rad²."""
        self.yaw_variance += share * (variance - self.yaw_variance)
        self._yaw_disturbance -= share * (self._disturbance + self._yaw_disturbance)
        self._yaw_bias *= 1.0 - share
        self.share += share * (1.0 - self.share + self._disturbance_share)


class GyroLoss:
    """How fast a gyro loses its angle and its bias, from headings that another device measures.

    For each pair of sizes on a grid a Kalman filter follows by how much headings are ahead of the
    gyro, and the bias. Their likelihoods and log-normal priors weigh the pairs.

    `share` is the part of the usual loss of angle, rad², that this gyro has, one on average, and
    `walked` are the (rad/s)² a second by which its bias walks.
    """

    def __init__(self) -> None:
        walk, spread = FUSION.bias_walk, FUSION.loss_spread
        first, second = np.meshgrid(np.linspace(-3.0, 4.0, 11), np.linspace(-3.0, 3.0, 7))
        self._walks: FloatArray = (walk * np.exp(FUSION.walk_spread * first.ravel())) ** 2
        self._shares: FloatArray = np.exp(spread * second.ravel() - 0.5 * spread**2)
        self._log_odds: FloatArray = -0.5 * (first**2 + second**2).ravel()
        self._bias_variance = FUSION.bias_sigma**2
        self.share, self.walked = 1.0, walk**2 * math.exp(2.0 * FUSION.walk_spread**2)
        self.begin()

    def begin(self) -> None:
        """Follow gap and bias anew; the sizes are still known."""
        self._stamp = math.nan
        self._ahead = self._bias = self._both = self._own = self._by_bias = 0.0 * self._walks

    def add(self, stamp: float, ahead: float, variance: float, lost: float) -> None:
        """Take a heading.

        The heading is `ahead` of the yaw of the gyro alone, radians. `variance` is that of its
        error, which is independent of that of the heading before, rad²; `lost` are the rad² that a
        gyro usually loses since that one, apart from its bias.
        """
        seconds, self._stamp = stamp - self._stamp, stamp
        if not seconds > 0.0:
            self.begin()
            self._stamp = stamp
            self._ahead = self._ahead + ahead
            self._own = self._own + variance
            self._by_bias = self._by_bias + self._bias_variance
            return
        walked = self._walks * seconds
        spread = variance + lost * self._shares + self._own + walked * seconds**2 / 3.0
        spread += seconds * (2.0 * self._both + seconds * self._by_bias)
        both = self._both + seconds * self._by_bias + 0.5 * walked * seconds
        left = ahead - self._ahead - seconds * self._bias
        self._log_odds = self._log_odds - 0.5 * (np.log(spread) + left**2 / spread)
        self._ahead = ahead - variance / spread * left
        self._bias = self._bias + both / spread * left
        self._own = variance * (1.0 - variance / spread)
        self._both = both * variance / spread
        self._by_bias = self._by_bias + walked - both**2 / spread
        weights = np.exp(self._log_odds - self._log_odds.max())
        weights = weights / weights.sum()
        self.share, self.walked = float(weights @ self._shares), float(weights @ self._walks)
