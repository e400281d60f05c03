"""The vehicle's front, and which is misaligned: IMU, magnetometer, or the declination."""

from __future__ import annotations

import math
from dataclasses import dataclass

from magcal_ros.core.driving.course_offset import CourseOffset
from magcal_ros.core.driving.driving_tuning import FrontTuning
from magcal_ros.core.driving.mounting_yaw import MountingYaw


@dataclass(frozen=True)
class VehicleYaw:
    """The yaw of the IMU in the vehicle."""

    offset: float
    sigma: float
    """Radians: heading of the IMU less heading of the vehicle, counter-clockwise positive."""
    source: str
    """What showed it: accelerations, course, or both."""

    def __post_init__(self) -> None:
        if not (math.isfinite(self.offset) and 0.0 <= self.sigma < math.inf):
            raise ValueError("a vehicle's yaw and its sigma must be finite")

    @property
    def words(self) -> str:
        """The same for people."""
        degrees, sigma = math.degrees(self.offset), math.degrees(self.sigma)
        side = "left" if degrees >= 0.0 else "right"
        return (
            f"the IMU looks {abs(degrees):.1f}° ± {sigma:.1f}° to the {side} of the vehicle's "
            f"front, by {self.source}"
        )


@dataclass(frozen=True)
class Declination:
    """The declination in use and its sigma, radians; NaN where it is not known."""

    value: float = math.nan
    sigma: float = 0.0

    @property
    def is_known(self) -> bool:
        """Whether true north is known."""
        return math.isfinite(self.value)


@dataclass(frozen=True)
class Front:
    """What drives have told so far."""

    yaw: VehicleYaw | None = None
    """Of the IMU in the vehicle, where it can be told."""
    compass_gap: float = math.nan
    compass_sigma: float = math.nan
    """Radians: what the compass is off in the IMU's axes, against course; NaN where it cannot be
    told."""
    suspicion: str = ""
    """Which is misaligned beside the IMU, in words; empty if nothing is."""

    @property
    def words(self) -> str:
        """All of it in one line; empty while nothing is known."""
        told = "" if self.yaw is None else self.yaw.words
        return "; ".join(each for each in (told, self.suspicion) if each)


def where_is_the_front(
    mounting: MountingYaw | None,
    course: CourseOffset | None,
    declination: Declination,
    tuning: FrontTuning | None = None,
) -> Front:
    """Compare accelerations with course.

    Parameters
    ----------
    mounting : MountingYaw or None
        Yaw of the IMU from accelerations: the compass has no part in it.
    course : CourseOffset or None
        Yaw of the compass, to magnetic north, less course.
    declination : Declination
        The one in use.
    tuning : FrontTuning, optional
        What is taken for granted.
    """
    tuning = tuning or FrontTuning()
    if course is not None and course.sigma > tuning.lost:
        course = None
    north = declination.value if declination.is_known else 0.0
    if mounting is None:
        if course is None or not declination.is_known:
            return Front()
        offset = math.remainder(course.offset - north, math.tau)
        return Front(VehicleYaw(offset, math.hypot(course.sigma, declination.sigma), "course"))
    own = VehicleYaw(mounting.yaw, mounting.sigma, "accelerations")
    if course is None:
        return Front(own)
    gap = math.remainder(course.offset - north - mounting.yaw, math.tau)
    sigma = math.hypot(course.sigma, mounting.sigma)
    if not declination.is_known:
        return Front(own, gap, sigma, _missing_declination(gap, sigma, tuning))
    sigma = math.hypot(sigma, declination.sigma)
    if abs(gap) > max(tuning.clear * sigma, tuning.smallest):
        return Front(own, gap, sigma, _suspicion(gap, sigma, declination.value, tuning))
    return Front(_joined(mounting, course, declination), gap, sigma)


def _joined(mounting: MountingYaw, course: CourseOffset, declination: Declination) -> VehicleYaw:
    """Weigh both, which agree, by their variances."""
    own, other = mounting.sigma**2, course.sigma**2 + declination.sigma**2
    gap = math.remainder(course.offset - declination.value - mounting.yaw, math.tau)
    yaw = math.remainder(mounting.yaw + gap * own / (own + other), math.tau)
    return VehicleYaw(yaw, math.sqrt(own * other / (own + other)), "accelerations and course")


def _missing_declination(gap: float, sigma: float, tuning: FrontTuning) -> str:
    """Say what the declination seems to be, where it is not known."""
    if sigma > tuning.useful or abs(gap) < tuning.clear * sigma:
        return ""
    return (
        f"by course the declination is about {math.degrees(gap):+.0f}° "
        f"(± {math.degrees(sigma):.0f}°), if the magnetometer is not turned against the IMU: give "
        "reference.declination_deg, or the place"
    )


def _suspicion(gap: float, sigma: float, declination: float, tuning: FrontTuning) -> str:
    """Say why compass and course differ although the IMU's own yaw is taken off."""
    size = f"{math.degrees(gap):+.1f}° ± {math.degrees(sigma):.1f}°"
    is_large = abs(declination) > tuning.smallest
    if is_large and abs(math.remainder(gap + 2.0 * declination, math.tau)) < tuning.near * sigma:
        return (
            f"the compass is off the course by {size}, twice the declination in use: its sign is "
            f"wrong, give reference.declination_deg: {-math.degrees(declination):.1f} "
            "(east is positive)"
        )
    return (
        f"the compass is off the course by {size} although the IMU's own yaw is taken off: the "
        "magnetometer is turned against the IMU by so much (mount_rpy_deg), or the declination "
        "is wrong by it"
    )
