"""A Kalman filter of yaw, gyro bias and local disturbance, and the gyro's random walk.

The disturbance changes with the place within seconds of driving, while an error of the propagated
yaw is constant: this separates the two.
"""

from __future__ import annotations

import math

import numpy as np

from magcal_ros.core.geometry.arrays import FloatArray
from magcal_ros.core.heading.compass import CERTAIN
from magcal_ros.core.heading.heading_tuning import FUSION
from magcal_ros.core.knowledge import UNKNOWN_YAW
from magcal_ros.core.up.filter import GYRO


def errors_of(lasting: tuple[float, ...]) -> FloatArray:
    """Return the errors of a compass as `YawFilter` takes them, from `Heading.lasting`."""
    return np.array((*lasting, 1.0))


PERFECT = errors_of(CERTAIN)  # a compass without errors


YAW, BIAS, DISTURBANCE = range(3)
BY_COMPASS, BY_YAW, BY_REST = np.array([[1.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
"""The sums of these states that a compass, another device, and a gyro at rest measure."""


class YawFilter:
    """A Kalman filter on the error of a propagated yaw, the gyro's bias about up, and disturbance.

    `bias` is in rad/s about up, and `disturbance` is the yaw error of the compass by the local
    disturbance. Their covariance is without the calibration's errors, which are considered
    separately (Schmidt-Kalman). `errors` are estimates of these, as far as the gyro at other
    headings or another device shows them.

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
        own = np.diag([yaw_variance + disturbance, bias_variance, disturbance])
        # The error of the yaw is that of the disturbance.
        own[YAW, DISTURBANCE] = own[DISTURBANCE, YAW] = -disturbance
        self._own: FloatArray = own
        self._forget_errors(compass)

    def _forget_errors(self, compass: FloatArray) -> None:
        self.errors = 0.0 * compass
        # Derivatives of the states by the errors, and the covariance of the errors.
        self._by_errors = np.zeros((len(self._own), len(compass)))
        self._by_errors[YAW] = -compass
        self._covariance = np.diag(np.append(np.ones(len(CERTAIN)), 0.0))

    def use_another_calibration(self) -> None:
        """Continue with a compass that has other errors; the old ones remain in the variance."""
        self.add_variance(self.own_error_variance)
        self._forget_errors(0.0 * self.errors)

    @property
    def yaw_variance(self) -> float:
        """Variance of the yaw without the calibration's errors, rad²."""
        return float(self._own[YAW, YAW])

    @property
    def bias_variance(self) -> float:
        """Variance of the bias, (rad/s)²."""
        return float(self._own[BIAS, BIAS])

    @property
    def own_error_variance(self) -> float:
        """Variance of the yaw by the calibration, rad²."""
        by_yaw = self._by_errors[YAW]
        return float(by_yaw @ self._covariance @ by_yaw)

    def add_variance(self, variance: float) -> None:
        """Increase the variance of the yaw, rad²."""
        self._own[YAW, YAW] += variance

    def propagate(self, seconds: float, walk_variance: float, bias_lost: float) -> None:
        """Propagate with process noises of the angle, rad², and of the bias, (rad/s)²."""
        own = self._own
        own[YAW] -= seconds * own[BIAS]
        own[:, YAW] -= seconds * own[:, BIAS]
        own[YAW, YAW] += walk_variance
        own[BIAS, BIAS] += bias_lost
        self._by_errors[YAW] -= seconds * self._by_errors[BIAS]

    def change_disturbance(self, share: float, variance: float) -> None:
        """Propagate the disturbance as a Gauss-Markov process.

        `share` is its correlation, 0 to 1, and `variance` its stationary variance, rad².
        """
        self.disturbance *= share
        self._own[DISTURBANCE] *= share
        self._own[:, DISTURBANCE] *= share
        self._own[DISTURBANCE, DISTURBANCE] += (1.0 - share * share) * variance
        self._by_errors[DISTURBANCE] *= share

    def widen(self, ratio: float) -> None:
        """Multiply the variance of the disturbance by a ratio."""
        root = math.sqrt(ratio)
        # As far as the yaw comes from the compass, its error grows likewise.
        scale = np.array([1.0 - float(self._by_errors[YAW, -1]) * (root - 1.0), 1.0, root])
        self._own *= np.outer(scale, scale)

    def spread(self, noise: float, compass: FloatArray) -> float:
        """Return the variance of compass minus yaw, rad², with a `noise` like in `observe`."""
        apart = compass + BY_COMPASS @ self._by_errors
        return self.known_spread(noise) + float(apart @ self._covariance @ apart)

    def known_spread(self, noise: float) -> float:
        """Return the same without the calibration's errors."""
        return float(BY_COMPASS @ self._own @ BY_COMPASS) + noise

    def observe(
        self, seen: FloatArray, value: float, noise: float, compass: FloatArray | float = 0.0
    ) -> float:
        """Update with a measured sum of the states; return the correction of the yaw, radians.

        `seen` is `BY_COMPASS`, `BY_YAW` or `BY_REST`. `value` is the measured yaw minus the
        propagated one, without the estimated errors of the calibration, or a rate, and `noise` its
        variance; radians or rad/s. `compass` are the errors of the compass, if it measured.
        """
        left = value - float(seen[BIAS]) * self.bias - float(seen[DISTURBANCE]) * self.disturbance
        apart, by = compass + seen @ self._by_errors, self._own @ seen
        spread = float(seen @ by) + noise
        gain = by / spread
        self._own -= np.outer(gain, by)
        self._by_errors -= np.outer(gain, apart)
        shown = self._covariance @ apart
        whole = spread + float(apart @ shown)
        of_errors = shown / whole
        # The disagreement of compasses changes: its error is considered, but not estimated.
        of_errors[-2] = 0.0
        both = np.outer(of_errors, shown - 0.5 * whole * of_errors)
        self._covariance = self._covariance - both - both.T
        found = of_errors * left
        self.errors = self.errors + found
        turned, bias, disturbance = (gain * left + self._by_errors @ found).tolist()
        self.bias += bias
        self.disturbance += disturbance
        return float(turned)

    def use_larger_covariance(self, covariance: FloatArray) -> None:
        """Use a larger covariance (2, 2) of the yaw and minus the bias."""
        self._own[:2, :2] = covariance * np.array([[1.0, -1.0], [-1.0, 1.0]])

    def follow(self, share: float, variance: float, compass: FloatArray) -> None:
        """Replace a fraction of the yaw by a compass with a smaller variance, rad²."""
        own, yaw_variance = self._own, self.yaw_variance
        own[YAW] -= share * (BY_COMPASS @ own)
        own[:, YAW] = own[YAW]
        own[YAW, YAW] = yaw_variance + share * (variance - yaw_variance)
        self._by_errors[YAW] -= share * (compass + BY_COMPASS @ self._by_errors)


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
    errors, seconds. The usual random walk of the angle is added to `walk_variance`, rad², which is
    that since the last heading or rest.
    """

    def __init__(self) -> None:
        spread = FUSION.spread
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
        self._walks: FloatArray = (GYRO.bias_walk * np.exp(GYRO.walk_spread * first)) ** 2
        self._shares: FloatArray = np.exp(spread * second - 0.5 * spread**2)
        self._turns: FloatArray = (FUSION.rest_turn * np.exp(spread * third)) ** 2
        self._lasts: FloatArray = FUSION.heading_error_time * np.exp(spread * fourth)
        kind = kinds.astype(int)
        self._drift_walks: FloatArray = (
            np.array([0.0, FUSION.heading_drift, GYRO.usual_bias_walk])[kind] ** 2
        )
        self._drift_rates: FloatArray = np.array([0.0, 0.0, FUSION.integrated_rate])[kind] ** 2
        part = self._lasts / FUSION.heading_tau
        self._left: FloatArray = 2.0 * part * (1.0 - part * (1.0 - np.exp(-1.0 / part)))
        self._log_odds: FloatArray = -0.5 * (first**2 + second**2 + third**2 + fourth**2)
        odds = np.array([1.0, *FUSION.drift_odds])
        self._log_odds += np.log(odds)[kind]
        self._update_weights()
        self.begin(0.0, 0.0)
        self.begin_means()

    def begin(self, bias: float, variance: float) -> None:
        """Restart the filters, and keep the weights of the sets.

        `bias` is the gyro's whole bias about up, rad/s, with its `variance`, (rad/s)².
        """
        self._stamp, self._heard = math.nan, -math.inf
        self.walk_variance = 0.0
        count = len(self._walks)
        self._state: FloatArray = np.tile([0.0, -bias, 0.0, 0.0, 0.0], (count, 1))
        start = np.diag([UNKNOWN_YAW, variance, 0.0, 0.0, 0.0])
        self._covariance: FloatArray = np.tile(start, (count, 1, 1))
        self._covariance[:, 4, 4] = self._drift_rates

    def begin_means(self) -> None:
        """Forget the collected headings and rests of which no mean was added yet."""
        self._gaps, self._mean_since = list[float](), -math.inf
        self._rests = list[tuple[float, float, float]]()

    def add_heading(self, stamp: float, yaw_gap: float, variance: float, since: float) -> bool:
        """Take a heading, `since` seconds after the last; return whether the drift was updated.

        `yaw_gap` is the heading minus the yaw of the gyro alone, radians, with its variance, rad².
        The update is by the mean over `FUSION.heading_tau` seconds.
        """
        if since >= FUSION.heading_tau:
            self._gaps, self._mean_since = [], -math.inf
        self._gaps.append(yaw_gap)
        if stamp - self._mean_since < FUSION.heading_tau:
            return False
        gaps, self._gaps, self._mean_since = self._gaps, [], stamp
        self._add_mean_heading(stamp, sum(gaps) / len(gaps), variance, len(gaps))
        return True

    def add_rest(
        self, stamp: float, rest: tuple[float, float] | None
    ) -> tuple[float, float] | None:
        """Take the gyro's rate about up at rest, rad/s, with its variance; None in motion.

        The update is by the mean over a rest, or over `FUSION.rest_time` seconds of it, which is
        returned with its variance.
        """
        rests = self._rests
        if rest is not None:
            rests.append((stamp, rest[0], 1.0 / rest[1]))
        if not rests or (rest and stamp - rests[0][0] < FUSION.rest_time):
            return None
        weight = sum(each for *_, each in rests)
        rate = sum(each * about for _, about, each in rests) / weight
        rests.clear()
        self.propagate(stamp)
        self._update(-rate, np.array([0.0, 1.0, 0.0, 0.0, 0.0]), 1.0 / weight + self._turns)
        return rate, 1.0 / weight

    def _add_mean_heading(self, stamp: float, yaw_gap: float, variance: float, count: int) -> None:
        self.propagate(stamp)
        if stamp - self._heard > 2.0 * FUSION.heading_tau:
            self._covariance[:, 3, 3] += FUSION.drift_jump**2 * (self._drift_walks > 0.0)
        steady, drifting, _ = self._log_odds.reshape(-1, DRIFT_KINDS).T
        # As many good devices start to drift as stop.
        starts = FUSION.drift_odds[0] * FUSION.heading_tau / FUSION.drift_time
        drifting[:] = np.logaddexp(drifting, steady + math.log(starts))
        kept = np.exp((self._heard - stamp) / self._lasts)
        self._heard = stamp
        self._state[:, 2] *= kept
        self._covariance[:, 2] *= kept[:, None]
        self._covariance[:, :, 2] *= kept[:, None]
        self._covariance[:, 2, 2] += (1.0 - kept**2) * self._left * variance
        self._update(yaw_gap, np.array([1.0, 0.0, 1.0, 1.0, 0.0]), variance / count)

    def propagate(self, stamp: float) -> None:
        """Propagate to a stamp."""
        seconds, self._stamp = stamp - self._stamp, stamp
        walk_variance, self.walk_variance = self.walk_variance, 0.0
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
