"""Which way gravity points, and whether its sign, the IMU's axes or the mounting is at fault."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from magcal_ros.core.doctor.explanations import Explanations
from magcal_ros.core.doctor.finding import Finding, looked_at, wrong
from magcal_ros.core.geometry.arrays import FloatArray
from magcal_ros.core.geometry.rotations import DIRECTIONS
from magcal_ros.core.samples.window import SensorLog


@dataclass(frozen=True)
class UprightTuning:
    """When gravity is called upright or upside down."""

    least_upright: float = 0.5
    """Share of gravity on z from which z points up."""
    clear: float = 12.0
    """Chi-square between an explanation and another that decides."""
    least_turn: float = math.radians(30.0)
    """Turn whose sense is believed."""


TUNING = UprightTuning()


SIGN = (
    "gravity has the wrong sign: REP-145 wants +9.81 on z at rest, so negate linear_acceleration "
    "in the driver"
)
UPSIDE_DOWN = (
    "the IMU's z points down: REP-103 wants x forward, y left, z up, so turn all of the IMU's axes "
    "in the driver, by 180° about x if they are x forward, y right, z down (NED), or mount it "
    "upright"
)
TELLS_GRAVITY = "To tell which, turn left and see whether angular_velocity.z is positive"


@dataclass(frozen=True)
class UserAnswers:
    """What the user answered about the motion."""

    turned_left: bool | None = None
    """Whether the robot turned to the left; None where it was not asked."""

    @property
    def opposite(self) -> UserAnswers:
        """The same where up is down."""
        return UserAnswers(None if self.turned_left is None else not self.turned_left)


@dataclass(frozen=True)
class Upright:
    """What was found of gravity's direction."""

    findings: tuple[Finding, ...]
    """One line."""
    sign_wrong: bool | None = False
    """Whether gravity's sign is what errs; None where that or the IMU's axes do."""


def upright(
    log: SensorLog, given: Explanations | None, other: Explanations | None, answers: UserAnswers
) -> Upright:
    """Look at which way gravity points."""
    usual = np.median(log.force, axis=0)
    usual = usual / max(float(np.linalg.norm(usual)), 1e-9)
    name = "accelerometer: up"
    evidence = f"up is ({usual[0]:.2f}, {usual[1]:.2f}, {usual[2]:.2f})"
    if usual[2] > TUNING.least_upright:
        return Upright((looked_at("gravity_sign", name, evidence),))
    if usual[2] > -TUNING.least_upright:
        return Upright((wrong("imu_axes", name, evidence, sideways(usual)),))
    flipped = _is_flipped(given, other, answers)
    if flipped is None:
        either = f"either {SIGN}; or {UPSIDE_DOWN}. {TELLS_GRAVITY}"
        return Upright((wrong("gravity_sign", name, evidence, either),), None)
    if flipped:
        return Upright((wrong("gravity_sign", name, evidence, SIGN),), True)
    return Upright((wrong("imu_axes", name, evidence, UPSIDE_DOWN),))


def sideways(up: FloatArray) -> str:
    """Say which axis points up and what to do; `up` is a unit vector (3,)."""
    axis = int(np.argmax(np.abs(up)))
    way = DIRECTIONS[2][int(up[axis] < 0.0)]
    return (
        f"the IMU's {'xyz'[axis]} points {way} at rest where z should: turn the IMU's axes in the "
        "driver, or mount it upright"
    )


def _is_flipped(
    given: Explanations | None, other: Explanations | None, answers: UserAnswers
) -> bool | None:
    """Return whether gravity's sign errs rather than the IMU lies upside down."""
    if given is None or other is None:
        return None
    best = given.best
    if answers.turned_left is not None and abs(given.turned(best)) > TUNING.least_turn:
        # About an up that points down a turn to the left looks like one to the right.
        return (given.turned(best) > 0.0) is not answers.turned_left
    as_given, turned_round = given.field_right, other.field_right
    if abs(as_given - turned_round) < TUNING.clear:
        return None
    return turned_round < as_given
