"""The installation that takes the turn's axis in the body to the normal of the field's plane."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from magcal_ros.core.errors import Reason, Refusal
from magcal_ros.core.geometry.arrays import FloatArray
from magcal_ros.core.geometry.rotations import (
    roll_pitch_between,
    rotation_angle,
    rotation_from_rpy,
)
from magcal_ros.core.methods.design_tip.axis import TurnAxis
from magcal_ros.core.methods.design_tip.circle import FieldCircle
from magcal_ros.core.methods.design_tip.tip_frame import ROUNDING, TipSamples


@dataclass(frozen=True)
class InstallationTuning:
    """When the sense of the rotation and the pitch are believed."""

    clear_sense: float = 20.0
    """Standard errors by which gravity must show the sense of rotation. Wobble is correlated and
    counts for less than its number of samples; below this the smaller installation decides well."""
    least_gyro_agreement: float = 0.5
    """Slope of the field's phase against the gyro's angle from which the gyro's sense is
    believed."""
    smallest_lever: float = math.sin(math.radians(10.0))
    """Length of the axis across body y; below it the pitch turns about the axis and is not seen."""


TUNING = InstallationTuning()


@dataclass(frozen=True, eq=False)
class Candidate:
    """One installation that fits the two normals, in the tip's sense."""

    roll: float
    pitch: float
    """Of the passive rotation Rx(roll) Ry(pitch), radians."""
    circle: FieldCircle
    """The field's circle with the normal that this installation needs."""
    gravity_dot_field: float
    """Mean product of gravity and field across the axis, tesla."""

    @property
    def angle(self) -> float:
        """Radians of the whole installation."""
        return rotation_angle(rotation_from_rpy(self.roll, self.pitch))


def find_candidates(samples: TipSamples, axis: TurnAxis, circle: FieldCircle) -> list[Candidate]:
    """Return every installation that fits, the smallest first.

    The field turns about its normal in the sense in which gravity turns about the axis. Where
    neither gravity nor a gyro shows that sense, both normals are tried.

    Parameters
    ----------
    samples : TipSamples
        The turn.
    axis : TurnAxis
        Its axis in the body.
    circle : FieldCircle
        With a normal of either sign.

    Returns
    -------
    list of Candidate
        At least one.

    Raises
    ------
    Refusal
        If none fits, if the axis does not show the pitch, or if gravity and gyro contradict.
    """
    if math.hypot(float(axis.direction[0]), float(axis.direction[2])) < TUNING.smallest_lever:
        raise Refusal(
            Reason.AMBIGUOUS,
            "The robot turned about the IMU's y axis, which does not show the magnetometer's "
            "pitch. Give the mounting in the robot's frame, so that the turn is about its z axis.",
        )
    sense = _sense(samples, axis, circle)
    circles = [c for s, c in ((1, circle), (-1, circle.flipped())) if sense in (0, s)]
    found = [
        Candidate(roll, pitch, c, _gravity_dot_field(rotation_from_rpy(roll, pitch).T, axis, c))
        for c in circles
        for roll, pitch in roll_pitch_between(axis.direction, c.normal)
    ]
    if not found:
        raise Refusal(
            Reason.NO_SOLUTION,
            "No roll and pitch of the magnetometer explain the turn. Check that the accelerometer "
            "and the magnetometer are on the same body and that their axes are right-handed.",
        )
    return sorted(found, key=lambda candidate: candidate.angle)


def _gravity_dot_field(rotation: FloatArray, axis: TurnAxis, circle: FieldCircle) -> float:
    return float(np.sum(axis.across * (circle.offsets @ rotation), axis=1).mean())


def _sense(samples: TipSamples, axis: TurnAxis, circle: FieldCircle) -> int:
    by_gravity = _sense_by_gravity(axis, circle)
    by_gyro = _sense_by_gyro(samples, axis, circle)
    if by_gravity * by_gyro < 0:
        raise Refusal(
            Reason.AXES_DISAGREE,
            "Gyro and gravity turn in opposite senses. Check the axes and signs of the gyro.",
        )
    return by_gravity or by_gyro


def _sense_by_gravity(axis: TurnAxis, circle: FieldCircle) -> int:
    first, second = np.linalg.svd(axis.direction[None, :])[2][1:]
    second = second * float(np.cross(first, second) @ axis.direction)
    gravity = axis.across @ first + 1j * (axis.across @ second)
    field = circle.phasor / np.abs(circle.phasor).mean()
    same, opposite = abs((gravity * field.conj()).mean()), abs((gravity * field).mean())
    standard_error = max(axis.noise, ROUNDING) / math.sqrt(len(field))
    if abs(same - opposite) < TUNING.clear_sense * standard_error:
        return 0
    return 1 if same > opposite else -1


def _sense_by_gyro(samples: TipSamples, axis: TurnAxis, circle: FieldCircle) -> int:
    if samples.turned is None:
        return 0
    # A field fixed in the world turns backwards in the body. Sines, because a pause in the stream
    # may hide a step of half a turn, whose sense the field does not show.
    expected = np.sin(-(samples.turned @ axis.direction))
    seen = np.sin(np.angle(circle.phasor[1:] * circle.phasor[:-1].conj()))
    power = float(expected @ expected)
    slope = float(expected @ seen) / power if power > 0.0 else 0.0
    if abs(slope) < TUNING.least_gyro_agreement:
        return 0
    return 1 if slope > 0.0 else -1
