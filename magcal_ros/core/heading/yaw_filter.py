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
from magcal_ros.core.heading.compass import CERTAIN


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
    rest_turn: float = 1e-4  # rad/s, median of how fast a robot turns that seems to rest
    rest_spread: float = 1.5  # sigma of its natural logarithm: wheels stand, boats swing
    rest_lasts: float = 10.0  # seconds over which such a turn is the same
    loss_spread: float = 1.5  # sigma of the logarithm of a gyro's loss over `angle_walk`²
    tilt_tau: float = 3.0  # seconds over which errors by tilt are alike: more show no more
    noise_tau: float = 0.5  # the same for the field's noise and for small iron on the way
    small_iron: float = 0.3  # share of the disturbance's variance that changes within two metres
    moving_tau: float = 20.0
    """Seconds over which the disturbance of a moving robot is correlated: streets bend the field
    over 25 to 30 m, which are 4 s of a car and 37 s at walking pace. With too short a time the yaw
    would be reported as more certain than it is."""
    standing_tau: float = 300.0  # the same of a robot that stands
    learning_step: float = 0.1  # seconds after which the disturbance is learnt anew
    overruled_after: float = 3.0  # seconds of doubt in a good field that turn the yaw to it
    beyond_doubt: float = 4.0  # squared gates of disagreement that count fully
    heading_tau: float = 2.0  # seconds of headings from another device that are joined
    heading_lasts: float = 1.0
    lasts_spread: float = 1.5
    """Median of the seconds over which such a heading is wrong by the same, and standard deviation
    of their natural logarithm: noise is new with each message, reflections last for a minute."""
    heading_wander: float = 7e-4  # rad/s per root second: .3°/s within a minute
    """Change of the rate at which such headings drift, where reflections or a wrong ambiguity turn
    them. A bias of the gyro that walks looks the same."""
    wander_lasts: float = 100.0  # seconds over which the drift's rate and its error last
    wander_jump: float = 0.1  # radians of error when headings come back from beyond the gate
    wander_odds: tuple[float, float] = (0.1, 1e-3)
    """Prior odds that a device drifts, and that a sound one begins to within `heading_tau`."""
    integrated_rate: float = 2e-3  # rad/s, usual bias of a gyro that a device integrates
    integrated_odds: float = 0.01  # prior odds of such a device
    heading_gate: float = 4.0  # sigmas by which such a heading may miss
    unknown: float = 0.5  # radians of uncertainty of a start in a field that is not expected
    start: float = 5.0  # seconds from the start in which that may be found out

    def lost(self, rate: float) -> float:
        """Return the variance that the gyro's angle gains at a turn rate in rad/s, rad²/s.

        Its bias is not part of it.
        """
        return self.angle_walk**2 + self.turn_error**2 * abs(rate)


FUSION = FusionTuning()
BIAS_WALK = FUSION.bias_walk * math.exp(FUSION.walk_spread**2)
"""Root mean square of how much a gyro's bias walks, rad/s per root second."""
UNKNOWN_YAW = math.pi**2 / 3.0
"""Variance of a yaw of which nothing is known, rad²."""


PERFECT: FloatArray = np.array((*CERTAIN, 1.0))  # a compass without errors, as `YawFilter` takes it


class YawFilter:
    """A Kalman filter on the error of a propagated yaw, the gyro's bias about up, and disturbance.

    `bias` is in rad/s about up, with `bias_variance`, and `disturbance` the angle by which the
    field of the place turns the compass. `yaw_variance` (rad²) is without the calibration's errors,
    whose shares are in the yaw. `errors` are estimates of them as far as a compass shows them that
    the gyro turns to other headings, or another device's headings.

    A compass tells its errors as radians of yaw for each of unit variance, and after them a one:
    how far the yaw comes from the compass.
    """

    def __init__(self) -> None:
        self.begin(0.0, 0.0, 0.0)

    def begin(
        self,
        yaw_variance: float,
        bias_variance: float,
        disturbance: float,
        compass: FloatArray = PERFECT,
    ) -> None:
        """Start from a compass reading and its errors.

        The variances are those of the reading but for the disturbance, rad², of the bias, (rad/s)²,
        and of the disturbance, rad².
        """
        self.bias = self.disturbance = 0.0
        self.yaw_variance = yaw_variance + disturbance
        self.bias_variance, self._disturbance = bias_variance, disturbance
        # The yaw is wrong by what the disturbance is.
        self._yaw_disturbance = -disturbance
        self._yaw_bias = self._bias_disturbance = 0.0
        self._know_nothing_of_errors(compass)

    def _know_nothing_of_errors(self, shares: FloatArray) -> None:
        self._shares = shares
        self._bias_shares = self._disturbance_shares = self.errors = 0.0 * shares
        self._covariance = np.diag(np.append(np.ones(len(CERTAIN)), 0.0))

    def use_another_calibration(self) -> None:
        """Go on with a compass whose errors are others; what they were stays in the variance."""
        self.yaw_variance += self.own_error_variance
        self._know_nothing_of_errors(0.0 * self._shares)

    @property
    def own_error_variance(self) -> float:
        """What the calibration adds to the yaw's variance, rad²."""
        return float(self._shares @ self._covariance @ self._shares)

    def propagate(self, seconds: float, lost: float, bias_lost: float) -> None:
        """Go on: the gyro loses so many rad² and (rad/s)² meanwhile."""
        bias_part = self.bias_variance * seconds
        self.yaw_variance += (bias_part - 2.0 * self._yaw_bias) * seconds + lost
        self._yaw_bias -= bias_part
        self._yaw_disturbance -= seconds * self._bias_disturbance
        self._shares = self._shares + self._bias_shares * seconds
        self.bias_variance += bias_lost

    def move_on(self, share: float, variance: float) -> None:
        """Let the disturbance become another one.

        `share` of it is left, 0 to 1, and `variance` is that of a disturbance, rad².
        """
        self.disturbance *= share
        self._yaw_disturbance *= share
        self._bias_disturbance *= share
        self._disturbance_shares = self._disturbance_shares * share
        self._disturbance = share * share * self._disturbance + (1.0 - share * share) * variance

    def widen(self, ratio: float) -> None:
        """Disturbances turn out to have so many times the variance that was thought."""
        root = math.sqrt(ratio)
        # As far as the yaw comes from the compass, it is wrong by them.
        yaw = 1.0 + float(self._shares[-1]) * (root - 1.0)
        self.yaw_variance *= yaw * yaw
        self._yaw_disturbance *= yaw * root
        self._disturbance *= ratio
        self._yaw_bias *= yaw
        self._bias_disturbance *= root

    def spread(self, noise: float, compass: FloatArray) -> float:
        """Return the variance of compass less propagated yaw, rad²; parameters as of `observe`."""
        apart = self._apart(compass)
        return self.known_spread(noise) + float(apart @ self._covariance @ apart)

    def _apart(self, compass: FloatArray) -> FloatArray:
        """Return what of the calibration's errors is in compass less propagated yaw."""
        return compass - self._shares + self._disturbance_shares

    def known_spread(self, noise: float) -> float:
        """Return the same if the calibration's errors were known."""
        return self.yaw_variance + 2.0 * self._yaw_disturbance + self._disturbance + noise

    def observe(self, innovation: float, noise: float, compass: FloatArray) -> float:
        """Take compass less propagated yaw; returns by what to correct the yaw, radians.

        `innovation` is in radians, less what is known of the calibration's errors, `noise` its
        variance beside that of the four, rad², and `compass` those errors.
        """
        by_yaw = self.yaw_variance + self._yaw_disturbance
        by_bias = self._yaw_bias + self._bias_disturbance
        by_disturbance = self._yaw_disturbance + self._disturbance
        left, by = innovation - self.disturbance, (by_yaw, by_bias, by_disturbance)
        return self._correct(left, self.known_spread(noise), by, self._apart(compass))

    def observe_yaw(self, innovation: float, noise: float) -> float:
        """Take a yaw that no field disturbs less the propagated one; otherwise as `observe`."""
        gains = self.yaw_variance, self._yaw_bias, self._yaw_disturbance
        return self._correct(innovation, self.yaw_variance + noise, gains, -self._shares)

    def observe_bias(self, left: float, noise: float) -> float:
        """Take a rate about up of a robot that does not turn less the bias; else as `observe`."""
        gains = self._yaw_bias, self.bias_variance, self._bias_disturbance
        return self._correct(left, self.bias_variance + noise, gains, self._bias_shares)

    def _correct(
        self, left: float, spread: float, by: tuple[float, float, float], apart: FloatArray
    ) -> float:
        """Take an innovation; then what is left of it estimates the errors of shares `apart`."""
        by_yaw, by_bias, by_disturbance = by[0] / spread, by[1] / spread, by[2] / spread
        self.bias += by_bias * left
        self.disturbance += by_disturbance * left
        self.yaw_variance -= by[0] * by_yaw
        self.bias_variance -= by[1] * by_bias
        self._disturbance -= by[2] * by_disturbance
        self._yaw_bias -= by[0] * by_bias
        self._yaw_disturbance -= by[0] * by_disturbance
        self._bias_disturbance -= by[1] * by_disturbance
        self._shares = self._shares + by_yaw * apart
        self._bias_shares = self._bias_shares - by_bias * apart
        self._disturbance_shares = self._disturbance_shares - by_disturbance * apart
        shown = self._covariance @ apart
        whole = spread + float(apart @ shown)
        gain = shown / whole
        # By how much compasses disagree changes: the error by it is considered and not learnt.
        gain[-2] = 0.0
        both = np.outer(gain, shown - 0.5 * whole * gain)
        self._covariance = self._covariance - both - both.T
        found = gain * left
        self.errors = self.errors + found
        self.bias += float(self._bias_shares @ found)
        self.disturbance += float(self._disturbance_shares @ found)
        return by_yaw * left - float(self._shares @ found)

    def doubt(self, covariance: FloatArray) -> None:
        """Take the larger covariance (2, 2) of the yaw and minus the bias."""
        self.yaw_variance, self.bias_variance = float(covariance[0, 0]), float(covariance[1, 1])
        self._yaw_bias = -float(covariance[0, 1])

    def follow(self, share: float, variance: float, compass: FloatArray) -> None:
        """Give up a share of the yaw for a compass whose variance is smaller, rad²."""
        self.yaw_variance += share * (variance - self.yaw_variance)
        self._yaw_disturbance -= share * (self._disturbance + self._yaw_disturbance)
        self._yaw_bias *= 1.0 - share
        self._shares = self._shares + share * self._apart(compass)


KINDS = 3
"""Of a device's headings: sound ones, those that wander, and those that integrate a gyro's bias."""
WANDERS = 1


class GyroLoss:
    """How fast a gyro loses its angle and its bias, from headings of another device and from rests.

    For each set of sizes on a grid a Kalman filter follows by how much the robot is ahead of the
    gyro, the bias, the part of the headings' error that lasts, and by how much and how fast they
    have drifted away. Their likelihoods and log-normal priors weigh the sets.

    `share` is the part of the usual loss of angle, rad², that this gyro has, one on average,
    `walked` are the (rad/s)² a second by which its bias walks, `rest_turn` those by which the robot
    still turns while it seems to rest, and `heading_lasts` the seconds over which headings are
    wrong by the same.
    """

    def __init__(self) -> None:
        spread = FUSION.loss_spread
        first, second, third, fourth, kinds = (
            each.ravel()
            for each in np.meshgrid(
                np.linspace(-3.0, 4.0, 11),
                np.linspace(-3.0, 3.0, 7),
                np.linspace(-2.0, 3.0, 6),
                np.linspace(-2.0, 3.0, 6),
                np.arange(KINDS, dtype=float),
            )
        )
        self._walks: FloatArray = (FUSION.bias_walk * np.exp(FUSION.walk_spread * first)) ** 2
        self._shares: FloatArray = np.exp(spread * second - 0.5 * spread**2)
        self._turns: FloatArray = (FUSION.rest_turn * np.exp(FUSION.rest_spread * third)) ** 2
        self._lasts: FloatArray = FUSION.heading_lasts * np.exp(FUSION.lasts_spread * fourth)
        kind = kinds.astype(int)
        self._wanders: FloatArray = np.array([0.0, FUSION.heading_wander, BIAS_WALK])[kind] ** 2
        self._drift_rates: FloatArray = np.array([0.0, 0.0, FUSION.integrated_rate])[kind] ** 2
        part = self._lasts / FUSION.heading_tau
        self._left: FloatArray = 2.0 * part * (1.0 - part * (1.0 - np.exp(-1.0 / part)))
        self._log_odds: FloatArray = -0.5 * (first**2 + second**2 + third**2 + fourth**2)
        odds = np.array([1.0, FUSION.wander_odds[0], FUSION.integrated_odds])
        self._log_odds += np.log(odds)[kind]
        self._weigh()
        self.begin(0.0, 0.0)

    def begin(self, bias: float, variance: float) -> None:
        """Follow gap and bias anew; the sizes are still known.

        The gyro's whole bias about up, rad/s, is known with a variance, (rad/s)².
        """
        self._stamp, self._heard = math.nan, -math.inf
        count = len(self._walks)
        self._state: FloatArray = np.tile([0.0, -bias, 0.0, 0.0, 0.0], (count, 1))
        start = np.diag([UNKNOWN_YAW, variance, 0.0, 0.0, 0.0])
        self._covariance: FloatArray = np.tile(start, (count, 1, 1))
        self._covariance[:, 4, 4] = self._drift_rates

    def add_heading(
        self, stamp: float, ahead: float, variance: float, count: int, lost: float
    ) -> None:
        """Take the mean of headings over `FUSION.heading_tau` seconds.

        It is `ahead` of the yaw of the gyro alone, radians. `variance` is that of the error of each
        of so many, rad²; `lost` are the rad² that a gyro usually loses since the last heading or
        rest, apart from its bias.
        """
        self.go_on(stamp, lost)
        if stamp - self._heard > 2.0 * FUSION.heading_tau:
            self._covariance[:, 3, 3] += FUSION.wander_jump**2 * (self._wanders > 0.0)
        steady, drifting, _ = self._log_odds.reshape(-1, KINDS).T
        drifting[:] = np.logaddexp(drifting, steady + math.log(FUSION.wander_odds[1]))
        kept = np.exp((self._heard - stamp) / self._lasts)
        self._heard = stamp
        self._state[:, 2] *= kept
        self._covariance[:, 2] *= kept[:, None]
        self._covariance[:, :, 2] *= kept[:, None]
        self._covariance[:, 2, 2] += (1.0 - kept**2) * self._left * variance
        self._take(ahead, np.array([1.0, 0.0, 1.0, 1.0, 0.0]), variance / count)

    def add_rest(self, stamp: float, rate: float, variance: float, lost: float) -> None:
        """Take the gyro's mean rate about up while the robot seems to rest; as `add_heading`."""
        self.go_on(stamp, lost)
        self._take(-rate, np.array([0.0, 1.0, 0.0, 0.0, 0.0]), variance + self._turns)

    def go_on(self, stamp: float, lost: float) -> None:
        """Go on to a stamp; `lost` as of `add_heading`."""
        seconds, self._stamp = stamp - self._stamp, stamp
        if not seconds > 0.0:
            return
        covariance = self._covariance
        for kind in range(KINDS):
            step = np.eye(5)
            step[0, 1] = step[3, 4] = seconds
            if kind == WANDERS:
                step[3:, 3:] *= math.exp(-seconds / FUSION.wander_lasts)
            self._state[kind::KINDS] = self._state[kind::KINDS] @ step.T
            covariance[kind::KINDS] = step @ covariance[kind::KINDS] @ step.T
        covariance[:, 0, 0] += lost * self._shares
        for angle, walks in ((0, self._walks), (3, self._wanders)):
            rate, walked = angle + 1, walks * seconds
            covariance[:, angle, angle] += walked * seconds**2 / 3.0
            covariance[:, angle, rate] += 0.5 * walked * seconds
            covariance[:, rate, angle] += 0.5 * walked * seconds
            covariance[:, rate, rate] += walked

    def ahead(self) -> tuple[FloatArray, FloatArray]:
        """Return gap (radians) and minus the bias (rad/s) by all sets, with their covariance."""
        mean = self._weights @ self._state[:, :2]
        off = self._state[:, :2] - mean
        spread = self._covariance[:, :2, :2] + off[:, :, None] * off[:, None]
        return mean, np.einsum("n,nij->ij", self._weights, spread)

    def _take(self, shown: float, sight: FloatArray, noise: FloatArray | float) -> None:
        by = self._covariance @ sight
        spread, left = by @ sight + noise, shown - self._state @ sight
        self._log_odds = self._log_odds - 0.5 * (np.log(spread) + left**2 / spread)
        gain = by / spread[:, None]
        self._state += gain * left[:, None]
        self._covariance -= gain[:, :, None] * by[:, None]
        self._weigh()

    def _weigh(self) -> None:
        weights = np.exp(self._log_odds - self._log_odds.max())
        self._weights: FloatArray = weights / weights.sum()
        self.share, self.walked, self.rest_turn, self.heading_lasts = (
            float(self._weights @ each)
            for each in (self._shares, self._walks, self._turns, self._lasts)
        )
