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
from magcal_ros.core.geometry.vec3 import dot
from magcal_ros.core.heading.heading_tuning import FUSION
from magcal_ros.core.knowledge import UNKNOWN_YAW
from magcal_ros.core.samples.samples_tuning import STREAMS
from magcal_ros.core.samples.streams import HeadingSample
from magcal_ros.core.session.session_tuning import KNOWN
from magcal_ros.core.up.filter import GYRO
from magcal_ros.core.up.follower import UpFollower


@dataclass(frozen=True)
class ExternalHeading:
    """A heading from another source, such as a dock or a pair of antennas."""

    yaw: float  # ENU yaw, radians: zero to the east, positive to the left
    sigma: float
    is_true: bool  # whether it refers to true north; otherwise to magnetic north


def mean_heading(received: Sequence[HeadingSample], is_true: bool) -> ExternalHeading | None:
    """Return the mean heading of a robot at rest; None without headings."""
    if not received:
        return None
    yaw = mean_angle(np.array([each.yaw for each in received]))
    # The errors of a receiver's messages are correlated: averaging does not reduce the sigma.
    return ExternalHeading(yaw, max(each.sigma for each in received), is_true)


VALID_FOR = 1.0
"""Seconds for which a heading on a topic is current."""


def wrong_clock(behind: float, imu: str, age: float = 0.0) -> str:
    """Say that the stamps of headings are `behind` those of an IMU that came at the same time.

    `behind` is in seconds, negative for stamps ahead, `age` the seconds since the IMU's newest
    message. Empty if one clock may have stamped both; without a stamp `behind` is infinite.
    """
    if not VALID_FOR + age < abs(behind) < math.inf:
        return ""
    return (
        f"their stamps are {abs(behind):.1f} s {'before' if behind > 0.0 else 'after'} those of "
        f"{imu}, so they are not used: check that they are times of measurement by the same clock"
    )


METHOD = "known_headings"
LARGEST_FIRST_SIGMA = math.radians(5.0)
"""Heading sigma below which a first calibration is put in force, radians."""


def is_by_headings(calibration: Calibration) -> bool:
    """Whether a calibration was made at known headings, not from a turn or a drive."""
    return calibration.evidence.method == METHOD


def replaces(found: Calibration, before: Calibration | None) -> bool:
    """Whether a calibration from headings replaces the one in force; one from a turn is kept."""
    if before is None:
        return calibration_sigma(found) < LARGEST_FIRST_SIGMA
    return is_by_headings(before) and calibration_sigma(found) < calibration_sigma(before)


class GyroTurn(NamedTuple):
    """The turn by the gyro since some start, radians to the left."""

    stamp: float = math.nan  # of the newest IMU message, seconds
    seconds: float = 0.0  # since the start
    angle: float = 0.0
    variance: float = 0.0  # by noise and scale of the gyro, without the bias
    by_bias: float = 0.0
    """Sigma by the part of the bias beyond `FUSION.bias_sigma`, large before the first rest."""

    def followed(self, stamp: float, up: UpFollower) -> GyroTurn:
        """Return the turn up to the stamp of an IMU message that `up` has received, seconds.

        It is unknown over a gap, and while the gyro does not propagate up.
        """
        seconds, axis = stamp - self.stamp, up.newest if up.is_propagated else None
        if math.isnan(seconds) and axis is not None:
            return self._replace(stamp=stamp)
        if axis is None or not 0.0 < seconds <= STREAMS.longest_gyro_step:
            return self._replace(stamp=stamp, variance=self.variance + UNKNOWN_YAW)
        turn = dot(up.mean_rate, axis)
        more = math.sqrt(max(0.0, up.gyro_bias.variance - FUSION.bias_sigma**2))
        return GyroTurn(
            stamp,
            self.seconds + seconds,
            self.angle + turn * seconds,
            self.variance + GYRO.walk_variance(turn * seconds, seconds),
            self.by_bias + more * seconds,
        )

    def since(self, before: GyroTurn) -> GyroTurn:
        """Return the turn after an earlier one with the same start."""
        apart = (now - then for now, then in zip(self[1:], before[1:], strict=True))
        return GyroTurn(self.stamp, *apart)

    @property
    def sigma(self) -> float:
        """Standard deviation; infinite after a gap or without messages.

        A constant bias with `FUSION.bias_sigma` is not included: it is an unknown of the fit.
        """
        if math.isnan(self.stamp) or self.variance >= UNKNOWN_YAW:
            return math.inf
        walked = GYRO.usual_bias_walk**2 * self.seconds**3 / 3.0
        return math.sqrt(self.variance + self.by_bias**2 + walked)


class HeadingAgainstGyro:
    """Compares the turns of a device's headings with those of the gyro.

    `fault` describes the difference in words; it is empty while they agree.
    """

    def __init__(self) -> None:
        self.fault = ""
        self._last = -math.inf, 0.0, 0.0
        self._wrong: list[tuple[float, float]] = []

    def add(self, stamp: float, yaw: float, angle: float) -> None:
        """Take a heading, and the turn by the gyro up to its stamp, radians to the left."""
        seconds, given, turned = stamp - self._last[0], yaw - self._last[1], angle - self._last[2]
        if not 0.0 < seconds < KNOWN.longest:
            self._last = stamp, yaw, angle
            return
        if abs(turned) < KNOWN.turn:
            return
        self._last, given = (stamp, yaw, angle), wrapped(given)
        if abs(wrapped(given - turned)) < KNOWN.apart:
            self._wrong, self.fault = [], ""
            return
        self._wrong = [*self._wrong, (given, turned)][-KNOWN.times :]
        if len(self._wrong) < KNOWN.times:
            return
        self.fault = (
            f"the heading turned by {given * DEGREES:.0f}°, but the gyro measured "
            f"{wrapped(turned) * DEGREES:.0f}° (to the left): check that the topic has the robot's "
            "heading, and that the stamps are times of measurement"
        )
        for factor, words in FAULTS_BY_FACTOR.items():
            if all(abs(wrapped(g - factor * t)) < KNOWN.apart for g, t in self._wrong):
                self.fault = words
                return


FAULTS_BY_FACTOR = {
    -1.0: (
        "the heading turns opposite to the gyro: the sign is wrong (a bearing counts clockwise, "
        "yaw counts to the left), or the antennas are mirrored"
    ),
    DEGREES: "the heading turns about 57 times as far as the gyro: degrees were published as "
    "radians",
    1.0 / DEGREES: (
        "the heading hardly turns when the gyro measures a turn: the device repeats an old "
        "heading, or radians are converted as if they were degrees"
    ),
}
"""The fault of a heading that turns by this factor of the gyro's turn."""
