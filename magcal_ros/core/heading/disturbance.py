"""How far the present field deviates from the calibrated one, and what that does to the yaw."""

from __future__ import annotations

import cmath
import math
from dataclasses import dataclass
from enum import Enum
from typing import NamedTuple

import numpy as np

from magcal_ros.core.calibration.calibration import Calibration
from magcal_ros.core.geometry.vec3 import Triple, dot, length
from magcal_ros.core.heading.compass import SMALLEST_LEVEL_SHARE, level_field_covariance
from magcal_ros.core.heading.heading_tuning import DISTURBANCE, FUSION
from magcal_ros.core.knowledge import CLEAR, INCLINATION_SIGMA_DEG, UNKNOWN_YAW

DIP_SIGMA = math.radians(INCLINATION_SIGMA_DEG)
MOST_ODDS = 30.0  # largest log odds of added iron against a wrong yaw


PATIENCE = 60.0
"""Default time after which a deviating field is accepted as the expected one, seconds."""


class FieldUse(str, Enum):
    """How the present field is used."""

    GOOD = "good"
    WEIGHED_DOWN = "weighed down"
    IGNORED = "ignored"


@dataclass(frozen=True)
class Disturbance:
    """A period in which the field was not the expected one."""

    since: float
    until: float
    """Stamps, seconds."""
    yaw: float  # yaw of the robot at the beginning, radians, ENU to magnetic north
    strength: float  # largest deviation of the strength, relative
    dip: float  # largest deviation of the inclination, radians
    is_accepted: bool = False
    """Whether it lasted so long that the new field was accepted as the expected one."""

    @property
    def in_words(self) -> str:
        """The disturbance in one line."""
        line = (
            f"strength {100.0 * self.strength:+.0f}%, inclination {math.degrees(self.dip):+.0f}° "
            f"for {self.until - self.since:.0f} s from {self.since:.1f} s, at yaw "
            f"{math.degrees(self.yaw):.0f}°"
        )
        return f"{line}; accepted because it lasted" if self.is_accepted else line


class FieldDeviation:
    """Compares the corrected field with the calibrated one.

    Strength and inclination do not depend on the heading. They show two components of the field's
    error, in units of the field's strength; the third, across north, turns the yaw. One model gives
    the variance of each: by the place, noise and calibration, and by the tilt of up.

    After `patience` seconds a deviating field is accepted as the expected one.
    """

    def __init__(self, calibration: Calibration, patience: float = math.inf) -> None:
        self.patience = patience
        self.use = FieldUse.GOOD  # use of the newest sample
        self.deviation = 0.0  # of strength and inclination, averaged, sigmas
        self.last: Disturbance | None = None  # the newest
        self.is_accepted = False  # whether the newest sample made another field the expected one
        self.yaw_variance = 0.0  # of the newest sample by its own deviation, rad²
        self.is_turned = False  # whether most of the error turns the yaw
        # Estimated variance of the local disturbance per axis, over the squared strength.
        self.amplitude_variance = DISTURBANCE.amplitude**2
        self.strength = max(calibration.strength, 1e-9)  # of the calibrated field, tesla
        self.level_share = max(math.cos(calibration.inclination), SMALLEST_LEVEL_SHARE)  # of it
        self._calibrated = self._expected = self.strength, calibration.inclination
        own = float(np.trace(level_field_covariance(calibration))) / 3.0
        self._noise = (calibration.noise_field**2 + own) / self.strength**2
        self._mean = self._calibrated
        self._stamp = -math.inf
        self._mean_excess = self._seconds = 0.0

    def add(
        self,
        stamp: float,
        field: Triple,
        up: Triple,
        tilt_variance: float,
        yaw: float = math.nan,
        turned: tuple[float, float] = (0.0, math.inf),
    ) -> float:
        """Add a corrected field; return the additional variance of its yaw, rad².

        `field` (tesla) and `up`, a unit vector, are in body axes. `tilt_variance` is the variance
        of up, rad², and `yaw` is recorded with a disturbance. `turned` is the yaw of the field
        minus that of the gyro, radians, and the variance of the gyro's yaw, rad², infinite without
        a gyro.
        """
        size = length(field)
        dip = math.asin(max(-1.0, min(1.0, -dot(field, up) / size))) if size > 0.0 else 0.0
        seconds, self._stamp = stamp - self._stamp, stamp
        is_next = 0.0 < seconds < 1.0
        share = 1.0 - math.exp(-seconds / FUSION.noise_tau) if is_next else 1.0
        old_size, old_dip = self._mean
        self._mean = (old_size + share * (size - old_size), old_dip + share * (dip - old_dip))
        if self._distance(self._calibrated, tilt_variance) < 1.0:
            self._expected = self._calibrated
        self.deviation = self._distance(self._expected, tilt_variance)
        self._judge(stamp, yaw)
        # After a jump of time the next sample counts as one second.
        seconds = seconds if is_next else 1.0
        return self._yaw_variance(size, dip, tilt_variance, turned, seconds)

    def _variances(self, tilt_variance: float) -> Triple:
        """Return those of strength and inclination, and of the part across north, relative."""
        common = self._noise + self.amplitude_variance
        of_dip = DIP_SIGMA**2 + common
        return DISTURBANCE.strength**2 + common, of_dip + tilt_variance, of_dip

    def _distance(self, expected: tuple[float, float], tilt_variance: float) -> float:
        """Return the distance of the mean from a field, in sigmas."""
        strength, dip = _deviation(self._mean, expected)
        of_strength, of_dip, _ = self._variances(tilt_variance)
        return math.sqrt(strength**2 / of_strength + dip**2 / of_dip)

    def _yaw_variance(
        self,
        size: float,
        dip: float,
        tilt_variance: float,
        turned: tuple[float, float],
        seconds: float,
    ) -> float:
        """Return the variance of a yaw by the error of the field beyond its usual size.

        Without a gyro the part across north is assumed to be as large as the others. A wrong
        calibration shows these at some headings only, so that earlier deviations count as well.
        """
        strength, lower = _deviation((size, dip), self._expected)
        level, expected = (1.0 + strength) * math.cos(dip), math.cos(self._expected[1])
        off = strength**2 + 2.0 * (1.0 + strength) * (1.0 - math.cos(lower))
        of_strength, of_dip, of_across = self._variances(tilt_variance * (1.0 + strength) ** 2)
        usual = of_strength + of_dip
        across = 2.0 * level * expected * (1.0 - math.cos(turned[0]))
        usual_across = of_across + turned[1] * level * expected
        self.is_turned = across - usual_across > off - usual
        if math.isfinite(usual_across):
            off, usual = off + across, usual + usual_across
        excess = max(0.0, off - usual)
        self._seconds = min(self._seconds + seconds, DISTURBANCE.amplitude_memory)
        self._mean_excess += seconds / self._seconds * (excess - self._mean_excess)
        # The level field of a disturbance must not count as a strong level field of the Earth.
        level = max(min(level, expected), 1e-9)
        self.yaw_variance = min(excess / level**2, UNKNOWN_YAW)
        return min(max(excess, self._mean_excess) / level**2, UNKNOWN_YAW)

    def learn(self, seconds: float, tilt_variance: float, across: float) -> float:
        """Learn the size of the local disturbance; return the growth of its variance, at least 1.

        `seconds` is the time since the last call. `tilt_variance` is the variance of up, rad²,
        which changes the dip. `across` is the squared deviation of the level field across north,
        over the squared strength.
        """
        old = self.amplitude_variance
        strength, dip = _deviation(self._mean, self._calibrated)
        # Passing iron is not a property of places.
        most = CLEAR**2 * old
        square = min(strength**2, most) + min(max(dip**2 - tilt_variance, 0.0), most)
        square = (square + min(across, most)) / 3.0
        share = min(1.0, seconds / DISTURBANCE.amplitude_memory)
        new = max(old + share * (square - old), (0.5 * DISTURBANCE.amplitude) ** 2)
        self.amplitude_variance = new
        return max(1.0, new / old)

    @property
    def usual_variance(self) -> float:
        """Variance of a good field per axis, over its squared strength."""
        return self._variances(0.0)[0]

    def _judge(self, stamp: float, yaw: float) -> None:
        """Judge the field, record a disturbance, and accept one that has lasted long enough."""
        was_ignored = self.use is FieldUse.IGNORED
        goes_on = was_ignored and not self.is_accepted
        self.is_accepted = False
        # A sigma of hysteresis, so that a field at the limit is not used intermittently.
        if self.deviation < CLEAR - was_ignored:
            self.use = FieldUse.GOOD if self.deviation <= 1.0 else FieldUse.WEIGHED_DOWN
            return
        self.use = FieldUse.IGNORED
        strength, dip = _deviation(self._mean, self._expected)
        last = self.last
        if last is None or not goes_on:
            last = Disturbance(stamp, stamp, yaw, strength, dip)
        self.is_accepted = stamp - last.since > self.patience
        self.last = Disturbance(
            last.since,
            stamp,
            last.yaw,
            max(strength, last.strength, key=abs),
            max(dip, last.dip, key=abs),
            self.is_accepted,
        )
        if self.is_accepted:
            self._expected = self._mean


def _deviation(field: tuple[float, float], expected: tuple[float, float]) -> tuple[float, float]:
    """Return the relative deviation of the strength, and that of the inclination in radians."""
    return field[0] / expected[0] - 1.0, field[1] - expected[1]


class LevelField(NamedTuple):
    """The level field at a moment against that of the Earth by the overruled yaw."""

    measured: complex  # tesla; its phase is the yaw by the field minus that by the gyro alone
    yaw: float  # by the gyro alone since the yaw was overruled, radians
    level: float  # level field of the Earth, tesla
    variance: float  # of the field by places and the gyro, per axis, tesla²


class FieldJump:
    """Two hypotheses of a yaw that the field has overruled: a wrong yaw, or added iron.

    The field has turned by `angle` radians against the gyro at `stamp`. While the robot does not
    turn, the two cannot be separated. The field of iron on the robot turns with the robot and the
    Earth's field does not: the next turn decides.
    """

    def __init__(self, stamp: float, angle: float, seen: LevelField, log_odds: float = 0.0) -> None:
        self.stamp, self.angle = stamp, angle
        self._log_odds = log_odds  # of iron against a yaw that was wrong
        self._iron = (seen.measured - seen.level) * cmath.rect(1.0, seen.yaw)  # on the robot

    @property
    def variance(self) -> float:
        """Variance of the yaw that follows the field, rad²: with iron its error is `angle`."""
        return self.angle**2 / (1.0 + math.exp(-self._log_odds))

    def add(self, seen: LevelField, share: float) -> None:
        """Add a measurement that counts as a fraction of an independent measurement."""
        off_iron = abs(seen.measured - seen.level - self._iron * cmath.rect(1.0, -seen.yaw))
        off_earth = abs(seen.measured - cmath.rect(seen.level, self.angle))
        # A Cauchy distribution in the level plane: passing iron must not decide.
        ratio = (seen.variance + off_earth**2) / (seen.variance + off_iron**2)
        odds = self._log_odds + share * 1.5 * math.log(ratio)
        self._log_odds = max(-MOST_ODDS, min(MOST_ODDS, odds))

    def after(self, angle: float, variance: float) -> float:
        """Return the log odds of iron after the field has turned again, by `angle` radians.

        `variance` is the variance of the angle, rad². If the iron is removed, the field turns back
        by the same angle; other iron turns it by any angle.
        """
        off = math.remainder(self.angle + angle, math.tau)
        density = math.exp(-0.5 * off**2 / variance) / math.sqrt(math.tau * variance)
        came = 1.0 / (1.0 + math.exp(-self._log_odds))
        return -math.log1p(math.tau * density * came / max(1.0 - came, math.exp(-MOST_ODDS)))

    @property
    def in_words(self) -> str:
        """The two hypotheses in one sentence."""
        return (
            f"at {self.stamp:.1f} s the field turned by {abs(math.degrees(self.angle)):.0f}° "
            "against the gyro: either iron was added or removed, or the yaw was wrong; the next "
            "turn of the robot shows which"
        )
