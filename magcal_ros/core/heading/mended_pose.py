"""The pose of the IMU in the vehicle, mended by what driving shows."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from magcal_ros.core.driving.front import VehicleYaw
from magcal_ros.core.geometry.arrays import FloatArray
from magcal_ros.core.geometry.rotations import rotation_from_rpy, rpy_from_rotation


@dataclass(frozen=True)
class MendingTuning:
    """When a yaw found by driving mends the described one.

    Attributes
    ----------
    useful : float
        Sigma below which a yaw found by driving is applied.
    far_off : float
        Radians between a described and a found yaw: the description is wrong, which a person must
        see.
    clear : float
        Sigmas by which a yaw contradicts one given by hand.
    smallest : float
        Radians. Contradictions below this are not worth a word.
    """

    useful: float = math.radians(2.0)
    far_off: float = math.radians(15.0)
    clear: float = 3.0
    smallest: float = math.radians(3.0)


TUNING = MendingTuning()


@dataclass(frozen=True, eq=False)
class MendedPose:
    """A pose of the IMU in the base, shape (3, 3); None where nothing is known to mend.

    `contradiction` says in words that driving shows another yaw; empty if it does not.
    """

    pose: FloatArray | None
    contradiction: str = ""


def mend(
    described: FloatArray | None, by_hand: float | None, found: VehicleYaw | None
) -> MendedPose:
    """Return the pose that attitudes of the base are made with.

    Parameters
    ----------
    described : ndarray, shape (3, 3), or None
        By the robot's description, IMU axes to base axes.
    by_hand : float or None
        Yaw that was given, radians: it wins.
    found : VehicleYaw or None
        Yaw that driving shows.
    """
    if described is None:
        return MendedPose(None)
    yaw = rpy_from_rotation(described)[2]
    if by_hand is not None:
        return MendedPose(_turned(described, by_hand - yaw), _doubt(found, by_hand))
    if found is None or found.sigma > TUNING.useful:
        return MendedPose(described)
    gap = math.remainder(found.offset - yaw, math.tau)
    if abs(gap) > TUNING.far_off:
        return MendedPose(
            described,
            f"{found.words}, and the robot's description has it at {math.degrees(yaw):.0f}°: mend "
            "its joint, or give vehicle_yaw_deg; it is used as described",
        )
    return MendedPose(_turned(described, gap))


def _turned(pose: FloatArray, angle: float) -> FloatArray:
    return np.asarray(rotation_from_rpy(0.0, 0.0, angle) @ pose)


def _doubt(found: VehicleYaw | None, by_hand: float) -> str:
    if found is None:
        return ""
    gap = abs(math.remainder(found.offset - by_hand, math.tau))
    if gap < max(TUNING.clear * found.sigma, TUNING.smallest):
        return ""
    return f"{found.words}, and vehicle_yaw_deg says {math.degrees(by_hand):.1f}°, which is used"
