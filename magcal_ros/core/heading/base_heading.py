"""The pose of the IMU in the vehicle, as found by driving, and the attitude of the base.

Drives show the vehicle's front, and what is wrong: the pose of the IMU, that of the magnetometer,
or the declination.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from magcal_ros.core.driving.chords import CourseOffset
from magcal_ros.core.driving.mounting_yaw import MountingYaw
from magcal_ros.core.geometry.arrays import FloatArray
from magcal_ros.core.geometry.rotations import rotation_from_rpy, rpy_from_rotation
from magcal_ros.core.heading.compass import SMALLEST_FORWARD, Heading
from magcal_ros.core.heading.heading_tuning import VEHICLE_YAW
from magcal_ros.core.knowledge import CLEAR


@dataclass(frozen=True)
class VehicleYaw:
    """The yaw of the IMU in the vehicle."""

    offset: float
    sigma: float
    """Heading of the IMU minus heading of the vehicle, radians, counter-clockwise positive."""
    source: str  # accelerations, course, or both

    def __post_init__(self) -> None:
        if not (math.isfinite(self.offset) and 0.0 <= self.sigma < math.inf):
            raise ValueError("a vehicle's yaw and its sigma must be finite")

    @property
    def words(self) -> str:
        """The yaw in words."""
        degrees, sigma = math.degrees(self.offset), math.degrees(self.sigma)
        side = "left" if degrees >= 0.0 else "right"
        return (
            f"the IMU's x points {abs(degrees):.1f}° ± {sigma:.1f}° to the {side} of the vehicle's "
            f"front, by {self.source}"
        )


@dataclass(frozen=True)
class DrivenYaw:
    """The results of driving so far."""

    yaw: VehicleYaw | None = None  # of the IMU in the vehicle, if known
    compass_gap: float = math.nan
    compass_sigma: float = math.nan
    """Error of the compass in the IMU's axes, against course, radians; NaN if unknown."""
    suspicion: str = ""  # the likely cause of a difference, in words; empty if there is none


def compare_with_course(
    mounting: MountingYaw | None,
    course: CourseOffset | None,
    declination: float | None,
    declination_sigma: float = 0.0,
) -> DrivenYaw:
    """Compare accelerations with course.

    `mounting` is the yaw of the IMU from accelerations, without the compass. `course` is the yaw of
    the compass, to magnetic north, minus course. The declination and its sigma are in radians, None
    if true north is not known.
    """
    if course is not None and course.sigma > VEHICLE_YAW.lost:
        course = None
    north = declination or 0.0
    if mounting is None:
        if course is None or declination is None:
            return DrivenYaw()
        offset = math.remainder(course.offset - north, math.tau)
        return DrivenYaw(VehicleYaw(offset, math.hypot(course.sigma, declination_sigma), "course"))
    own = VehicleYaw(mounting.yaw, mounting.sigma, "accelerations")
    if course is None:
        return DrivenYaw(own)
    gap = math.remainder(course.offset - north - mounting.yaw, math.tau)
    sigma = math.hypot(course.sigma, mounting.sigma)
    if declination is None:
        return DrivenYaw(own, gap, sigma, _missing_declination(gap, sigma))
    by_course = math.hypot(course.sigma, declination_sigma)
    sigma = math.hypot(by_course, mounting.sigma)
    if abs(gap) > max(CLEAR * sigma, VEHICLE_YAW.useful):
        return DrivenYaw(own, gap, sigma, _suspicion(gap, sigma, declination))
    # Both agree, and are weighted by their variances.
    yaw = math.remainder(mounting.yaw + gap * (mounting.sigma / sigma) ** 2, math.tau)
    both = VehicleYaw(yaw, mounting.sigma * by_course / sigma, "accelerations and course")
    return DrivenYaw(both, gap, sigma)


def _missing_declination(gap: float, sigma: float) -> str:
    """Return the likely declination in words, if it is not known."""
    if sigma > VEHICLE_YAW.useful or abs(gap) < CLEAR * sigma:
        return ""
    return (
        f"by course the declination is about {math.degrees(gap):+.0f}° "
        f"(± {math.degrees(sigma):.0f}°), if magnetometer and IMU are parallel: give "
        "reference.declination_deg, or the position"
    )


def _suspicion(gap: float, sigma: float, declination: float) -> str:
    """Return in words why compass and course differ although the IMU's yaw is subtracted."""
    size = f"{math.degrees(gap):+.1f}° ± {math.degrees(sigma):.1f}°"
    is_large = abs(declination) > VEHICLE_YAW.useful
    if is_large and abs(math.remainder(gap + 2.0 * declination, math.tau)) < CLEAR * sigma:
        return (
            f"compass and course differ by {size}, twice the declination in use: its sign is "
            f"wrong, give reference.declination_deg: {-math.degrees(declination):.1f} "
            "(east is positive)"
        )
    return (
        f"compass and course differ by {size} although the IMU's yaw is corrected: the "
        "magnetometer is turned against the IMU, or the declination is wrong, by this angle "
        "(mount_rpy_deg or reference.declination_deg)"
    )


class BaseHeading:
    """Turns headings of the IMU into headings of its base.

    `imu_in_base` (3, 3) is the pose of the IMU, IMU axes to base axes.
    """

    def __init__(self, imu_in_base: FloatArray) -> None:
        self.pose = imu_in_base
        self._is_imu = bool(np.allclose(imu_in_base, np.eye(3), atol=1e-12))

    def heading(self, imu_heading: Heading) -> Heading:
        """Return the base's heading.

        Both attitudes share one small error in world axes. Its components about east and north have
        another effect in the base's axes; that about up is the same for both.
        """
        if self._is_imu:
            return imu_heading
        roll, pitch, yaw, tilt, _, by_east, by_north, *_ = imu_heading
        imu = rotation_from_rpy(roll, pitch, yaw)
        base = imu @ self.pose.T
        rest = imu_heading.yaw_variance - tilt * (by_east * by_east + by_north * by_north)
        if by_east or by_north:
            (e, n, u), (fe, fn, fu) = imu[:, 0].tolist(), base[:, 0].tolist()
            was, level = (max(1.0 - rise * rise, SMALLEST_FORWARD) for rise in (u, fu))
            by_east += e * u / was - fe * fu / level
            by_north += n * u / was - fn * fu / level
        roll, pitch, yaw = rpy_from_rotation(base)
        return imu_heading._replace(
            roll=roll,
            pitch=pitch,
            yaw=yaw,
            yaw_variance=rest + tilt * (by_east * by_east + by_north * by_north),
            by_east=by_east,
            by_north=by_north,
        )


def corrected_pose(
    described: FloatArray | None, by_hand: float | None, found: VehicleYaw | None
) -> tuple[FloatArray | None, str]:
    """Return the pose of the IMU in the base, and a contradiction in words.

    `described` (3, 3) is the pose in the robot's description, IMU axes to base axes. A yaw given
    `by_hand`, radians, has priority over the one that was `found` by driving.
    """
    if described is None:
        return None, ""
    yaw = rpy_from_rotation(described)[2]
    if by_hand is not None:
        return _turned(described, by_hand - yaw), _doubt(found, by_hand)
    if found is None or found.sigma > VEHICLE_YAW.useful:
        return described, ""
    gap = math.remainder(found.offset - yaw, math.tau)
    if abs(gap) > VEHICLE_YAW.far_off:
        return described, (
            f"{found.words}, but in the robot's description the angle is {math.degrees(yaw):.0f}°: "
            "correct its joint, or give vehicle_yaw_deg; it is used as described"
        )
    return _turned(described, gap), ""


def _turned(pose: FloatArray, angle: float) -> FloatArray:
    return np.asarray(rotation_from_rpy(0.0, 0.0, angle) @ pose)


def _doubt(found: VehicleYaw | None, by_hand: float) -> str:
    if found is None:
        return ""
    gap = abs(math.remainder(found.offset - by_hand, math.tau))
    if gap < max(CLEAR * found.sigma, VEHICLE_YAW.useful):
        return ""
    return (
        f"{found.words}, but vehicle_yaw_deg is {math.degrees(by_hand):.1f}°, which is used: check "
        "this parameter"
    )
