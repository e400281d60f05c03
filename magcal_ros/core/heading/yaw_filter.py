"""A Kalman filter of yaw, gyro bias and local disturbance, and the gyro's random walk.

The disturbance changes with the place within seconds of driving, while an error of the propagated
yaw is constant: this separates the two. Plain floats: this is on the path of every message.
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

    angle_walk: float = 1e-3  # random walk of the gyro's angle, radians per root second
    turn_error: float = 0.005  # relative error of a turn by the gyro's scale, per root radian
    bias_sigma: float = 0.001  # least sigma of the remaining bias about up, rad/s
    bias_walk: float = 1.8e-5
    walk_spread: float = 1.0
    """Random walk of the gyro's bias, rad/s per root second: median, and standard deviation of the
    natural logarithm. Cheap gyros drift by .001 to .01 °/s in a minute."""
    rest_turn: float = 1e-4  # rad/s, median turn rate of a robot that seems to rest
    rest_spread: float = 1.5  # sigma of the natural logarithm: wheels stand, boats swing
    rest_time: float = 10.0  # correlation time of this turn rate, seconds
    angle_walk_spread: float = (
        1.5  # sigma of the logarithm of a gyro's random walk over `angle_walk`²
    )
    tilt_tau: float = 3.0  # correlation time of errors by tilt, seconds
    noise_tau: float = 0.5  # the same for the field's noise and for small iron near the path
    small_iron: float = 0.3  # fraction of the disturbance's variance that changes within two metres
    moving_tau: float = 20.0
    """Correlation time of the disturbance of a moving robot, seconds. The correlation length of
    streets is 25 to 30 m: 4 s in a car and 37 s at walking pace. Too short a time would make the
    variance of the yaw too small."""
    standing_tau: float = 300.0  # the same at rest
    learning_step: float = 0.1  # seconds between updates of the disturbance
    contradicted_after: float = 3.0  # seconds of disagreement after which a good field overrules
    beyond_doubt: float = 4.0  # squared gates of disagreement that count fully
    heading_tau: float = 2.0  # seconds of headings from another device that are joined
    heading_error_time: float = 1.0
    error_time_spread: float = 1.5
    """Correlation time of the error of such a heading, seconds: median, and standard deviation of
    the natural logarithm. Noise is white, reflections last for a minute."""
    heading_drift: float = 7e-4  # rad/s per root second: .3°/s within a minute
    """Random walk of the drift rate of such headings, by reflections or a wrong ambiguity. It looks
    like a random walk of the gyro's bias."""
    drift_time: float = 100.0  # correlation time of the drift's rate and angle, seconds
    drift_jump: float = 0.1  # radians of error when headings come back from beyond the gate
    drift_odds: tuple[float, float] = (0.1, 1e-3)
    """Prior odds that a device drifts, and that a good one starts to within `heading_tau`."""
    integrated_rate: float = 2e-3  # rad/s, usual bias of a gyro that a device integrates
    integrated_odds: float = 0.01  # prior odds of such a device
    heading_gate: float = 4.0  # largest normalised innovation of a heading
    unknown: float = 0.5  # sigma of the yaw after a start in a disturbed field, radians
    start: float = 5.0  # seconds from the start in which a disturbance may still be detected

    def walk_variance(self, rate: float) -> float:
        """Return the growth of the variance of the gyro's angle, without bias, rad²/s.

        `rate` is the turn rate, rad/s.
        """
        return self.angle_walk**2 + self.turn_error**2 * abs(rate)


FUSION = FusionTuning()
BIAS_WALK = FUSION.bias_walk * math.exp(FUSION.walk_spread**2)
"""Root mean square of the random walk of a gyro's bias, rad/s per root second."""
UNKNOWN_YAW = math.pi**2 / 3.0
"""Variance of an unknown yaw, rad²."""


PERFECT: FloatArray = np.array((*CERTAIN, 1.0))  # a compass without errors, for `YawFilter`


class YawFilter:
    """A Kalman filter on the error of a propagated yaw, the gyro's bias about up, and disturbance.

    `bias` is in rad/s about up, with `bias_variance`, and `disturbance` is the yaw error of the
    compass by the local disturbance. `yaw_variance` (rad²) is without the calibration's errors,
    which are considered separately (Schmidt-Kalman). `errors` are estimates of these, as far as the
    gyro at other headings or another device shows them.

    The errors of a compass are given as yaw errors (radians) by each error of unit variance,
    followed by one, the fraction of the yaw that comes from the compass.
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

        The variances are those of the reading without the disturbance, rad², of the bias, (rad/s)²,
        and of the disturbance, rad².
        """
        self.bias = self.disturbance = 0.0
        self.yaw_variance = yaw_variance + disturbance
        self.bias_variance, self._disturbance = bias_variance, disturbance
        # The error of the yaw is that of the disturbance.
        self._yaw_disturbance = -disturbance
        self._yaw_bias = self._bias_disturbance = 0.0
        self._forget_errors(compass)

    def _forget_errors(self, shares: FloatArray) -> None:
        self._shares = shares
        self._bias_shares = self._disturbance_shares = self.errors = 0.0 * shares
        self._covariance = np.diag(np.append(np.ones(len(CERTAIN)), 0.0))

    def use_another_calibration(self) -> None:
        """Continue with a compass that has other errors; the old ones remain in the variance."""
        self.yaw_variance += self.own_error_variance
        self._forget_errors(0.0 * self._shares)

    @property
    def own_error_variance(self) -> float:
        """Variance of the yaw by the calibration, rad²."""
        return float(self._shares @ self._covariance @ self._shares)

    def propagate(self, seconds: float, walk_variance: float, bias_lost: float) -> None:
        """Propagate with process noises of the angle, rad², and of the bias, (rad/s)²."""
        bias_part = self.bias_variance * seconds
        self.yaw_variance += (bias_part - 2.0 * self._yaw_bias) * seconds + walk_variance
        self._yaw_bias -= bias_part
        self._yaw_disturbance -= seconds * self._bias_disturbance
        self._shares = self._shares + self._bias_shares * seconds
        self.bias_variance += bias_lost

    def change_disturbance(self, share: float, variance: float) -> None:
        """Propagate the disturbance as a Gauss-Markov process.

        `share` is its correlation, 0 to 1, and `variance` its stationary variance, rad².
        """
        self.disturbance *= share
        self._yaw_disturbance *= share
        self._bias_disturbance *= share
        self._disturbance_shares = self._disturbance_shares * share
        self._disturbance = share * share * self._disturbance + (1.0 - share * share) * variance

    def widen(self, ratio: float) -> None:
        """Multiply the variance of the disturbance by a ratio."""
        root = math.sqrt(ratio)
        # As far as the yaw comes from the compass, its error grows likewise.
        yaw = 1.0 + float(self._shares[-1]) * (root - 1.0)
        self.yaw_variance *= yaw * yaw
        self._yaw_disturbance *= yaw * root
        self._disturbance *= ratio
        self._yaw_bias *= yaw
        self._bias_disturbance *= root

    def spread(self, noise: float, compass: FloatArray) -> float:
        """Return the variance of compass minus yaw, rad²; parameters as for `observe`."""
        apart = self._apart(compass)
        return self.known_spread(noise) + float(apart @ self._covariance @ apart)

    def _apart(self, compass: FloatArray) -> FloatArray:
        """Return the derivative of compass minus propagated yaw by the calibration's errors."""
        return compass - self._shares + self._disturbance_shares

    def known_spread(self, noise: float) -> float:
        """Return the same without the calibration's errors."""
        return self.yaw_variance + 2.0 * self._yaw_disturbance + self._disturbance + noise

    def observe(self, innovation: float, noise: float, compass: FloatArray) -> float:
        """Update with compass minus propagated yaw; return the correction of the yaw, radians.

        `innovation` is in radians, without the estimated errors of the calibration, `noise` its
        further variance, rad², and `compass` the errors of the compass.
        """
        by_yaw = self.yaw_variance + self._yaw_disturbance
        by_bias = self._yaw_bias + self._bias_disturbance
        by_disturbance = self._yaw_disturbance + self._disturbance
        left, by = innovation - self.disturbance, (by_yaw, by_bias, by_disturbance)
        return self._correct(left, self.known_spread(noise), by, self._apart(compass))

    def observe_yaw(self, innovation: float, noise: float) -> float:
        """Update with another device's yaw minus the propagated one; otherwise as `observe`."""
        gains = self.yaw_variance, self._yaw_bias, self._yaw_disturbance
        return self._correct(innovation, self.yaw_variance + noise, gains, -self._shares)

    def observe_bias(self, left: float, noise: float) -> float:
        """Update with the rate about up at rest minus the bias; otherwise as `observe`."""
        gains = self._yaw_bias, self.bias_variance, self._bias_disturbance
        return self._correct(left, self.bias_variance + noise, gains, self._bias_shares)

    def _correct(
        self, left: float, spread: float, by: tuple[float, float, float], apart: FloatArray
    ) -> float:
        """Update with an innovation, then estimate the errors with the derivatives `apart`."""
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
        # The disagreement of compasses changes: its error is considered, but not estimated.
        gain[-2] = 0.0
        both = np.outer(gain, shown - 0.5 * whole * gain)
        self._covariance = self._covariance - both - both.T
        found = gain * left
        self.errors = self.errors + found
        self.bias += float(self._bias_shares @ found)
        self.disturbance += float(self._disturbance_shares @ found)
        return by_yaw * left - float(self._shares @ found)

    def use_larger_covariance(self, covariance: FloatArray) -> None:
        """Use a larger covariance (2, 2) of the yaw and minus the bias."""
        self.yaw_variance, self.bias_variance = float(covariance[0, 0]), float(covariance[1, 1])
        self._yaw_bias = -float(covariance[0, 1])

    def follow(self, share: float, variance: float, compass: FloatArray) -> None:
        """Replace a fraction of the yaw by a compass with a smaller variance, rad²."""
        self.yaw_variance += share * (variance - self.yaw_variance)
        self._yaw_disturbance -= share * (self._disturbance + self._yaw_disturbance)
        self._yaw_bias *= 1.0 - share
        self._shares = self._shares + share * self._apart(compass)


DRIFT_KINDS = 3
"""Kinds of devices: without drift, with a random drift, and with an integrated gyro bias."""
RANDOM_DRIFT = 1


class GyroDrift:
    """The random walks of a gyro's angle and bias, from headings of another device and from rests.

    There is a Kalman filter for each set of sizes on a grid. Its states are the yaw minus that of
    the gyro, the gyro's negative bias, the correlated error of the headings, and angle and rate of
    their drift. The sets are weighted by likelihood and log-normal priors.

    `share` is the variance of this gyro's random walk of angle over the usual one. `walked` is the
    random walk of its bias, (rad/s)² per second, and `rest_turn` the squared turn rate of a robot
    that seems to rest, (rad/s)². `heading_error_time` is the correlation time of the headings'
    errors, seconds.
    """

    def __init__(self) -> None:
        spread = FUSION.angle_walk_spread
        first, second, third, fourth, kinds = (
            each.ravel()
            for each in np.meshgrid(
                np.linspace(-3.0, 4.0, 11),
                np.linspace(-3.0, 3.0, 7),
                np.linspace(-2.0, 3.0, 6),
                np.linspace(-2.0, 3.0, 6),
                np.arange(DRIFT_KINDS, dtype=float),
            )
        )
        self._walks: FloatArray = (FUSION.bias_walk * np.exp(FUSION.walk_spread * first)) ** 2
        self._shares: FloatArray = np.exp(spread * second - 0.5 * spread**2)
        self._turns: FloatArray = (FUSION.rest_turn * np.exp(FUSION.rest_spread * third)) ** 2
        self._lasts: FloatArray = FUSION.heading_error_time * np.exp(
            FUSION.error_time_spread * fourth
        )
        kind = kinds.astype(int)
        self._drift_walks: FloatArray = np.array([0.0, FUSION.heading_drift, BIAS_WALK])[kind] ** 2
        self._drift_rates: FloatArray = np.array([0.0, 0.0, FUSION.integrated_rate])[kind] ** 2
        part = self._lasts / FUSION.heading_tau
        self._left: FloatArray = 2.0 * part * (1.0 - part * (1.0 - np.exp(-1.0 / part)))
        self._log_odds: FloatArray = -0.5 * (first**2 + second**2 + third**2 + fourth**2)
        odds = np.array([1.0, FUSION.drift_odds[0], FUSION.integrated_odds])
        self._log_odds += np.log(odds)[kind]
        self._update_weights()
        self.begin(0.0, 0.0)

    def begin(self, bias: float, variance: float) -> None:
        """Restart the filters, and keep the weights of the sets.

        `bias` is the gyro's whole bias about up, rad/s, with its `variance`, (rad/s)².
        """
        self._stamp, self._heard = math.nan, -math.inf
        count = len(self._walks)
        self._state: FloatArray = np.tile([0.0, -bias, 0.0, 0.0, 0.0], (count, 1))
        start = np.diag([UNKNOWN_YAW, variance, 0.0, 0.0, 0.0])
        self._covariance: FloatArray = np.tile(start, (count, 1, 1))
        self._covariance[:, 4, 4] = self._drift_rates

    def add_heading(
        self, stamp: float, yaw_gap: float, variance: float, count: int, walk_variance: float
    ) -> None:
        """Add the mean of headings over `FUSION.heading_tau` seconds.

        `yaw_gap` is the mean minus the yaw of the gyro alone, radians. `variance` is the variance
        of each of `count` headings, rad². `walk_variance` is the usual random walk of the gyro's
        angle since the last heading or rest, rad².
        """
        self.propagate(stamp, walk_variance)
        if stamp - self._heard > 2.0 * FUSION.heading_tau:
            self._covariance[:, 3, 3] += FUSION.drift_jump**2 * (self._drift_walks > 0.0)
        steady, drifting, _ = self._log_odds.reshape(-1, DRIFT_KINDS).T
        drifting[:] = np.logaddexp(drifting, steady + math.log(FUSION.drift_odds[1]))
        kept = np.exp((self._heard - stamp) / self._lasts)
        self._heard = stamp
        self._state[:, 2] *= kept
        self._covariance[:, 2] *= kept[:, None]
        self._covariance[:, :, 2] *= kept[:, None]
        self._covariance[:, 2, 2] += (1.0 - kept**2) * self._left * variance
        self._update(yaw_gap, np.array([1.0, 0.0, 1.0, 1.0, 0.0]), variance / count)

    def add_rest(self, stamp: float, rate: float, variance: float, walk_variance: float) -> None:
        """Add the gyro's mean rate about up while the robot seems to rest; as `add_heading`."""
        self.propagate(stamp, walk_variance)
        self._update(-rate, np.array([0.0, 1.0, 0.0, 0.0, 0.0]), variance + self._turns)

    def propagate(self, stamp: float, walk_variance: float) -> None:
        """Propagate to a stamp; `walk_variance` as for `add_heading`."""
        seconds, self._stamp = stamp - self._stamp, stamp
        if not seconds > 0.0:
            return
        covariance = self._covariance
        for kind in range(DRIFT_KINDS):
            step = np.eye(5)
            step[0, 1] = step[3, 4] = seconds
            if kind == RANDOM_DRIFT:
                step[3:, 3:] *= math.exp(-seconds / FUSION.drift_time)
            self._state[kind::DRIFT_KINDS] = self._state[kind::DRIFT_KINDS] @ step.T
            covariance[kind::DRIFT_KINDS] = step @ covariance[kind::DRIFT_KINDS] @ step.T
        covariance[:, 0, 0] += walk_variance * self._shares
        for angle, walks in ((0, self._walks), (3, self._drift_walks)):
            rate, walked = angle + 1, walks * seconds
            covariance[:, angle, angle] += walked * seconds**2 / 3.0
            covariance[:, angle, rate] += 0.5 * walked * seconds
            covariance[:, rate, angle] += 0.5 * walked * seconds
            covariance[:, rate, rate] += walked

    def yaw_gap(self) -> tuple[FloatArray, FloatArray]:
        """Return yaw minus that of the gyro and minus the bias, by all sets, with covariance."""
        mean = self._weights @ self._state[:, :2]
        off = self._state[:, :2] - mean
        spread = self._covariance[:, :2, :2] + off[:, :, None] * off[:, None]
        return mean, np.einsum("n,nij->ij", self._weights, spread)

    def _update(self, shown: float, sight: FloatArray, noise: FloatArray | float) -> None:
        by = self._covariance @ sight
        spread, left = by @ sight + noise, shown - self._state @ sight
        self._log_odds = self._log_odds - 0.5 * (np.log(spread) + left**2 / spread)
        gain = by / spread[:, None]
        self._state += gain * left[:, None]
        self._covariance -= gain[:, :, None] * by[:, None]
        self._update_weights()

    def _update_weights(self) -> None:
        weights = np.exp(self._log_odds - self._log_odds.max())
        self._weights: FloatArray = weights / weights.sum()
        self.share, self.walked, self.rest_turn, self.heading_error_time = (
            float(self._weights @ each)
            for each in (self._shares, self._walks, self._turns, self._lasts)
        )
