"""A heading from outside (typed in, or on a topic), and its comparison with the gyro."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from magcal_ros.core.assessment.grading import DEGREES
from magcal_ros.core.calibration.calibration import Calibration
from magcal_ros.core.calibration.heading_sigma import calibration_sigma
from magcal_ros.core.geometry.attitude import mean_angle, wrapped
from magcal_ros.core.geometry.vec3 import Triple, dot
from magcal_ros.core.heading.yaw_filter import BIAS_WALK, FUSION, UNKNOWN_YAW
from magcal_ros.core.knowledge import ReferenceField
from magcal_ros.core.samples.streams import STREAMS, HeadingSample


@dataclass(frozen=True)
class KnownHeadingTuning:
    """How a robot stands at a known heading, and when a device's heading contradicts the gyro."""

    seconds: float = 3.0  # how long samples are averaged
    fewest: int = 10  # samples of the field that are needed
    patience: float = 15.0  # seconds, by another clock, after which those that came are too few
    rate: float = math.radians(1.5)  # rad/s beyond the bias from which a robot turns
    creep: float = 0.7e-6  # tesla by which the field's mean may move meanwhile, noise apart
    contradicted: float = 3.0  # sigmas by which a calibration in force may miss a known heading
    same: float = math.radians(5.0)  # radians within which a standing replaces another one
    most: int = 24  # standings that are kept
    turn: float = math.radians(40.0)  # radians that the gyro must turn for a comparison
    apart: float = math.radians(12.0)  # radians by which both may differ
    times: int = 3  # comparisons in a row that must fail
    longest: float = 60.0  # seconds over which the gyro is trusted


TUNING = KnownHeadingTuning()


@dataclass(frozen=True)
class LogTuning:
    """What is kept of a drive along which external headings arrive."""

    sectors: int = 12  # directions
    each: int = 8  # means that are kept of each
    block: float = 0.5  # seconds of a mean
    pause: float = 4.0  # and between those of one direction: streets bend the field over 30 m
    fewest: int = 4  # samples of a mean
    rate: float = 0.1  # rad/s of turning from which heading and field are not of one moment
    sigma: float = math.radians(0.7)  # radians of heading, for being apart in time
    common: float = math.radians(0.5)
    """Radians by which a device is mounted askew: two antennas a metre apart by a centimetre."""
    force: float = 0.15  # m/s² per axis by which up is wrong on the way
    speed: float = 5.0  # m/s of a robot that moves: nobody tells how far it goes
    first: int = 8  # new means after which it is worth while to fit


LOG = LogTuning()


@dataclass(frozen=True)
class ExternalHeading:
    """A heading from outside, such as a dock's or an antenna pair's."""

    yaw: float  # ENU yaw, radians: zero to the east, positive to the left
    sigma: float
    is_true: bool  # whether it is to true north; otherwise to magnetic north

    def to_magnetic(self, reference: ReferenceField) -> float | None:
        """Return what is added for magnetic north, radians; None where it is not known."""
        return reference.declination if self.is_true else 0.0


def mean_heading(heard: Sequence[HeadingSample], is_true: bool) -> ExternalHeading | None:
    """Return the mean heading of a robot at rest; None where none was heard."""
    if not heard:
        return None
    yaw = mean_angle(np.array([each.yaw for each in heard]))
    # The errors of a receiver's messages are correlated: the mean is no more certain.
    return ExternalHeading(yaw, max(each.sigma for each in heard), is_true)


METHOD = "known_headings"
ENOUGH = math.radians(5.0)
"""Heading sigma from which a calibration is no longer called rough."""


def is_by_headings(calibration: Calibration) -> bool:
    """Whether a calibration was made at known headings, not by a turn or a drive."""
    return calibration.evidence.method == METHOD


def replaces(found: Calibration, before: Calibration | None) -> bool:
    """Whether a calibration by headings replaces the one in force; one of a turn stays."""
    if before is None:
        return calibration_sigma(found) < ENOUGH
    return is_by_headings(before) and calibration_sigma(found) < calibration_sigma(before)


class GyroTurn(NamedTuple):
    """How far the gyro has turned to the left since some moment, radians."""

    stamp: float = math.nan  # of the newest IMU message, seconds
    seconds: float = 0.0  # since that moment
    angle: float = 0.0
    variance: float = 0.0  # by what the gyro loses, apart from its bias
    by_bias: float = 0.0
    """Sigma by a bias beyond `FUSION.bias_sigma`, as it may be before a rest has shown it."""

    def after(self, stamp: float, up: Triple, rate: Triple, bias_variance: float) -> GyroTurn:
        """Return the turn up to an IMU message at a stamp, seconds.

        `up` is unit, `rate` the mean since the message before, rad/s less the known bias, body
        axes. The variance is of that bias about up, (rad/s)².
        """
        seconds = stamp - self.stamp
        if math.isnan(seconds):
            return self._replace(stamp=stamp)
        if not 0.0 < seconds <= STREAMS.longest_gyro_step:
            return self._replace(stamp=stamp, variance=self.variance + UNKNOWN_YAW)
        turn = dot(rate, up)
        more = math.sqrt(max(0.0, bias_variance - FUSION.bias_sigma**2))
        return GyroTurn(
            stamp,
            self.seconds + seconds,
            self.angle + turn * seconds,
            self.variance + FUSION.lost(turn) * seconds,
            self.by_bias + more * seconds,
        )

    def since(self, before: GyroTurn) -> GyroTurn:
        """Return the turn since an earlier moment."""
        apart = (now - then for now, then in zip(self[1:], before[1:], strict=True))
        return GyroTurn(self.stamp, *apart)

    @property
    def sigma(self) -> float:
        """Standard deviation but for a constant bias; infinite after a gap or without messages.

        That bias, with `FUSION.bias_sigma`, is an unknown of the fit.
        """
        if math.isnan(self.stamp) or self.variance >= UNKNOWN_YAW:
            return math.inf
        walked = BIAS_WALK**2 * self.seconds**3 / 3.0
        return math.sqrt(self.variance + self.by_bias**2 + walked)


class HeadingAgainstGyro:
    """Whether the headings of a device turn as the gyro does.

    `fault` says in words how they differ; it is empty while they agree.
    """

    def __init__(self) -> None:
        self.fault = ""
        self._last = -math.inf, 0.0, 0.0
        self._wrong: list[tuple[float, float]] = []

    def add(self, stamp: float, yaw: float, angle: float) -> None:
        """Take a heading, and how far the gyro has turned by then, radians to the left."""
        seconds, given, turned = stamp - self._last[0], yaw - self._last[1], angle - self._last[2]
        if not 0.0 < seconds < TUNING.longest:
            self._last = stamp, yaw, angle
            return
        if abs(turned) < TUNING.turn:
            return
        self._last, given = (stamp, yaw, angle), wrapped(given)
        if abs(wrapped(given - turned)) < TUNING.apart:
            self._wrong, self.fault = [], ""
            return
        self._wrong = [*self._wrong, (given, turned)][-TUNING.times :]
        if len(self._wrong) == TUNING.times:
            self.fault = self._in_words()

    def _in_words(self) -> str:
        for factor, words in TURNS_AS.items():
            if all(abs(wrapped(t - factor * g)) < TUNING.apart for t, g in self._wrong):
                return words
        given, turned = self._wrong[-1]
        return (
            f"it turned by {given * DEGREES:.0f}°, but the gyro measured "
            f"{wrapped(turned) * DEGREES:.0f}° (to the left): check that it is the robot's "
            "heading, and that its stamps are those of the measurement"
        )


TURNS_AS = {
    -1.0: (
        "it turns in the direction opposite to the gyro's: its sign is wrong (a bearing counts "
        "clockwise, yaw counts to the left), or the antennas are mirrored"
    ),
    DEGREES: "it turns about 57 times as far as the gyro: degrees were published as radians",
    1.0 / DEGREES: (
        "it hardly turns when the gyro shows a turn: the device repeats an old heading, or "
        "radians were taken for degrees"
    ),
}
"""What is wrong with a heading that turns so many times as far as the gyro."""
