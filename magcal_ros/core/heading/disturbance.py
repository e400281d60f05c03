"""Whether the present field agrees with the calibration, or is disturbed."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum

from magcal_ros.core.calibration.calibration import Calibration
from magcal_ros.core.geometry.vec3 import Triple, dot, length
from magcal_ros.core.heading.compass import field_variance
from magcal_ros.core.heading.yaw_filter import UNKNOWN_YAW
from magcal_ros.core.knowledge import CLEAR, INCLINATION_SIGMA_DEG


@dataclass(frozen=True)
class DisturbanceTuning:
    """How a disturbed field is detected, and how far it may turn the yaw."""

    strength: float = 0.02  # relative sigma of a good field's strength from place to place
    noise_share: float = 2.0  # sigmas of the calibration's field noise that are added to both
    believed_below: float = 2.0  # sigmas below which an ignored field is used again
    memory: float = 0.3  # seconds over which strength and dip are averaged
    amplitude: float = 0.01
    """Prior size of the local disturbance per axis, over the field's strength: 0.5 µT, as on open
    land. The learnt size is at least half of it."""
    amplitude_memory: float = 100.0
    """Seconds over which the amplitude is learnt: a few hundred metres of road."""


DISTURBANCE = DisturbanceTuning()
DIP_SIGMA = math.radians(INCLINATION_SIGMA_DEG)


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


class DisturbanceDetector:
    """Compares the corrected field with what the calibration expects.

    After `patience` seconds a deviating field is accepted as the expected one.
    """

    def __init__(self, calibration: Calibration, patience: float) -> None:
        self.patience = patience
        self.use = FieldUse.GOOD  # use of the newest sample
        self.deviation = 0.0  # of the newest sample, sigmas
        self.last: Disturbance | None = None  # the newest
        # Estimated variance of the local disturbance per axis, over the squared strength.
        self.amplitude_variance = DISTURBANCE.amplitude**2
        # Quantities that do not depend on the heading: strength, tesla, and inclination, radians.
        self._calibrated = self._expected = calibration.strength, calibration.inclination
        self._noise = _own_variance(calibration) / max(calibration.strength, 1e-9) ** 2
        self._mean: tuple[float, float] | None = None
        self._stamp = -math.inf
        self._disturbed_since: float | None = None

    def add(
        self, stamp: float, field: Triple, up: Triple, tilt_variance: float, yaw: float
    ) -> bool:
        """Add a corrected field; return whether a new field was accepted.

        `field` (tesla) and `up`, a unit vector, are in body axes. `tilt_variance` is the variance
        of up, rad², and `yaw` is recorded with a disturbance.
        """
        size = length(field)
        dip = math.asin(max(-1.0, min(1.0, -dot(field, up) / size))) if size > 0.0 else 0.0
        seconds, self._stamp = stamp - self._stamp, stamp
        if self._mean is None or not 0.0 < seconds < 1.0:
            self._mean = (size, dip)
        share = 1.0 - math.exp(-min(max(seconds, 0.0), 1.0) / DISTURBANCE.memory)
        old_size, old_dip = self._mean
        self._mean = (old_size + share * (size - old_size), old_dip + share * (dip - old_dip))
        if self._distance(self._calibrated, tilt_variance) < 1.0:
            self._expected = self._calibrated
        self.deviation = self._distance(self._expected, tilt_variance)
        self.use = self._judge()
        if self.use is not FieldUse.IGNORED:
            self._disturbed_since = None
            return False
        return self._note(stamp, yaw)

    def learn(self, seconds: float, tilt_variance: float, across: float) -> float:
        """Learn the size of the local disturbance; return the growth of its variance, at least 1.

        `seconds` is the time since the last call. `tilt_variance` is the variance of up, rad²,
        which changes the dip. `across` is the squared deviation of the level field across north,
        over the squared strength.
        """
        old = self.amplitude_variance
        strength, dip = self._deviation(self._calibrated)
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
        return DISTURBANCE.strength**2 + self._noise + self.amplitude_variance

    def _judge(self) -> FieldUse:
        # Hysteresis, so that a field at the limit is not used intermittently.
        was_ignored = self.use is FieldUse.IGNORED
        edge = DISTURBANCE.believed_below if was_ignored else CLEAR
        if self.deviation >= edge:
            return FieldUse.IGNORED
        return FieldUse.GOOD if self.deviation <= 1.0 else FieldUse.WEIGHED_DOWN

    def _distance(self, expected: tuple[float, float], tilt_variance: float) -> float:
        """Return the distance of the mean from a field, in sigmas."""
        strength, dip = self._deviation(expected)
        common = self._noise + self.amplitude_variance
        of_strength = DISTURBANCE.strength**2 + common
        of_dip = DIP_SIGMA**2 + common + tilt_variance
        return math.sqrt(strength**2 / of_strength + dip**2 / of_dip)

    def _deviation(self, expected: tuple[float, float]) -> tuple[float, float]:
        """Return the deviation of the mean from a field: relative strength, and dip in radians."""
        assert self._mean is not None
        strength, dip = self._mean
        return strength / max(expected[0], 1e-9) - 1.0, dip - expected[1]

    def _note(self, stamp: float, yaw: float) -> bool:
        """Record the disturbance; return whether it has lasted long enough."""
        strength, dip = self._deviation(self._expected)
        last = self.last
        if self._disturbed_since is None or last is None:
            self._disturbed_since = stamp
            last = Disturbance(stamp, stamp, yaw, strength, dip)
        accepts = stamp - self._disturbed_since > self.patience
        self.last = Disturbance(
            last.since,
            stamp,
            last.yaw,
            max(strength, last.strength, key=abs),
            max(dip, last.dip, key=abs),
            accepts,
        )
        if accepts:
            assert self._mean is not None
            self._expected = self._mean
            self._disturbed_since = None
        return accepts


def _own_variance(calibration: Calibration) -> float:
    """Return the variance of the field by noise and calibration, per axis, tesla²."""
    noise = DISTURBANCE.noise_share * calibration.noise_field
    return noise**2 + field_variance(calibration)


class FieldDeviation:
    """The additional variance of the yaw, if the field contradicts the calibration.

    Strength and dip show two components of the field's error. The third component, across north,
    turns the yaw; without a gyro it is assumed to be as large. A wrong calibration shows the first
    two at some headings only, so that earlier deviations count as well.
    """

    def __init__(self, calibration: Calibration) -> None:
        strength, dip = calibration.strength, calibration.inclination
        self._level, self._rise = strength * math.cos(dip), -strength * math.sin(dip)
        places = DISTURBANCE.strength**2 + DIP_SIGMA**2 + 2.0 * DISTURBANCE.amplitude**2
        own = _own_variance(calibration)
        self._usual = strength**2 * places + 2.0 * own
        places = DIP_SIGMA**2 + DISTURBANCE.amplitude**2
        self._usual_across = strength**2 * places + own
        self._mean_excess = self._seconds = 0.0
        self._stamp = math.nan
        self.is_turned = False  # whether most of the error turns the yaw

    def add(
        self,
        stamp: float,
        field: Triple,
        up: Triple,
        tilt_variance: float,
        turned: tuple[float, float] = (0.0, math.inf),
    ) -> float:
        """Add a field; return the additional variance of its yaw by disturbances, rad².

        `field` is corrected, tesla, `up` a unit vector, both in body axes; `tilt_variance` is the
        variance of up, rad². `turned` is the yaw of the field minus that of the gyro, radians, and
        the variance of the gyro's yaw, rad², infinite without a gyro.
        """
        rise, square = dot(field, up), dot(field, field)
        level = math.sqrt(max(square - rise * rise, 0.0))
        off = (level - self._level) ** 2 + (rise - self._rise) ** 2
        usual = self._usual + tilt_variance * square
        across = 2.0 * level * self._level * (1.0 - math.cos(turned[0]))
        usual_across = self._usual_across + turned[1] * level * self._level
        self.is_turned = across - usual_across > off - usual
        if math.isfinite(usual_across):
            off, usual = off + across, usual + usual_across
        excess = max(0.0, off - usual)
        # After a jump of time the next sample counts as one second.
        seconds = stamp - self._stamp
        seconds = seconds if 0.0 < seconds < 1.0 else 1.0
        self._stamp = stamp
        self._seconds = min(self._seconds + seconds, DISTURBANCE.amplitude_memory)
        self._mean_excess += seconds / self._seconds * (excess - self._mean_excess)
        # The level field of a disturbance must not count as a strong level field of the Earth.
        level = max(min(level, self._level), 1e-9)
        return min(max(excess, self._mean_excess) / level**2, UNKNOWN_YAW)
