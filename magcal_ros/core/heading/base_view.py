"""The attitude of the base that an IMU sits on, from the attitude of the IMU and its pose."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from magcal_ros.core.driving.front import VehicleYaw
from magcal_ros.core.geometry.arrays import FloatArray
from magcal_ros.core.geometry.rotations import rotation_from_rpy, rpy_from_rotation
from magcal_ros.core.geometry.vec3 import Triple, dot
from magcal_ros.core.heading.compass import SMALLEST_FORWARD, Heading


class BaseView:
    """Turns headings of the IMU into headings of its base.

    Parameters
    ----------
    imu_in_base : ndarray, shape (3, 3)
        Pose of the IMU, IMU axes to base axes.
    """

    def __init__(self, imu_in_base: FloatArray) -> None:
        self.pose = imu_in_base
        self._is_imu = bool(np.allclose(imu_in_base, np.eye(3), atol=1e-12))
        self._forward, self._left, self._up = (
            (float(row[0]), float(row[1]), float(row[2])) for row in imu_in_base
        )

    def heading(self, seen: Heading) -> Heading:
        """Return the base's heading.

        Both attitudes share one small error in the world's axes: `Compass.heading` says how it
        shows in roll, pitch and yaw. Its parts about east and north follow from the covariances,
        and show otherwise where the base's x points; the part about up is the same for both.
        """
        if self._is_imu:
            return seen
        east, north, up = _rows(seen)
        forward, left, top = self._forward, self._left, self._up
        fe, fn, fu = dot(east, forward), dot(north, forward), dot(up, forward)
        yaw = math.atan2(fn, fe)
        roll = math.atan2(dot(up, left), dot(up, top))
        pitch = -math.asin(min(1.0, max(-1.0, fu)))
        level = max(fe * fe + fn * fn, SMALLEST_FORWARD)
        tilt = seen.tilt_variance
        by_east, by_north = _by_tilt(seen)
        rest = seen.yaw_variance - tilt * (by_east * by_east + by_north * by_north)
        was = max(east[0] * east[0] + north[0] * north[0], SMALLEST_FORWARD)
        if seen.roll_yaw or seen.pitch_yaw:
            by_east += east[0] * up[0] / was - fe * fu / level
            by_north += north[0] * up[0] / was - fn * fu / level
        cosine, sine = math.cos(yaw), math.sin(yaw)
        return Heading(
            roll,
            pitch,
            yaw,
            tilt,
            rest + tilt * (by_east * by_east + by_north * by_north),
            tilt * (by_east * cosine + by_north * sine) / math.sqrt(level),
            tilt * (by_north * cosine - by_east * sine),
            seen.noise_variance,
            seen.lasting_variance,
        )


def _rows(seen: Heading) -> tuple[Triple, Triple, Triple]:
    """Return east, north and up in IMU axes, the rows of Rz(yaw) Ry(pitch) Rx(roll)."""
    cr, sr = math.cos(seen.roll), math.sin(seen.roll)
    cp, sp = math.cos(seen.pitch), math.sin(seen.pitch)
    cy, sy = math.cos(seen.yaw), math.sin(seen.yaw)
    return (
        (cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr),
        (sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr),
        (-sp, cp * sr, cp * cr),
    )


def _by_tilt(seen: Heading) -> tuple[float, float]:
    """Return how much of an error about east and about north shows in the yaw."""
    if seen.tilt_variance <= 0.0:
        return 0.0, 0.0
    by_roll = seen.roll_yaw * math.cos(seen.pitch) / seen.tilt_variance
    by_pitch = seen.pitch_yaw / seen.tilt_variance
    cosine, sine = math.cos(seen.yaw), math.sin(seen.yaw)
    return by_roll * cosine - by_pitch * sine, by_roll * sine + by_pitch * cosine


@dataclass(frozen=True)
class DescribedPoseTuning:
    """When a yaw found by driving corrects the described one."""

    useful: float = math.radians(2.0)
    """Sigma below which a yaw found by driving is applied."""
    far_off: float = math.radians(15.0)
    """Radians between a described and a found yaw: the description is wrong, which a person must
    see."""
    clear: float = 3.0
    """Sigmas by which a yaw contradicts one given by hand."""
    smallest: float = math.radians(3.0)
    """Radians. Contradictions below this are not worth a word."""


TUNING = DescribedPoseTuning()


@dataclass(frozen=True, eq=False)
class CorrectedPose:
    """A pose of the IMU in the base, shape (3, 3); None where none is described.

    `contradiction` says in words that driving shows another yaw; empty if it does not.
    """

    pose: FloatArray | None
    contradiction: str = ""


def corrected_pose(
    described: FloatArray | None, by_hand: float | None, found: VehicleYaw | None
) -> CorrectedPose:
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
        return CorrectedPose(None)
    yaw = rpy_from_rotation(described)[2]
    if by_hand is not None:
        return CorrectedPose(_turned(described, by_hand - yaw), _doubt(found, by_hand))
    if found is None or found.sigma > TUNING.useful:
        return CorrectedPose(described)
    gap = math.remainder(found.offset - yaw, math.tau)
    if abs(gap) > TUNING.far_off:
        return CorrectedPose(
            described,
            f"{found.words}, and the robot's description has it at {math.degrees(yaw):.0f}°: "
            "correct its joint, or give vehicle_yaw_deg; it is used as described",
        )
    return CorrectedPose(_turned(described, gap))


def _turned(pose: FloatArray, angle: float) -> FloatArray:
    return np.asarray(rotation_from_rpy(0.0, 0.0, angle) @ pose)


def _doubt(found: VehicleYaw | None, by_hand: float) -> str:
    if found is None:
        return ""
    gap = abs(math.remainder(found.offset - by_hand, math.tau))
    if gap < max(TUNING.clear * found.sigma, TUNING.smallest):
        return ""
    return f"{found.words}, and vehicle_yaw_deg says {math.degrees(by_hand):.1f}°, which is used"
