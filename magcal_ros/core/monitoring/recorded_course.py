"""What course tells of a calibration on a recorded drive."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

from magcal_ros.core.assessment.grading import Check
from magcal_ros.core.calibration.calibration import Calibration
from magcal_ros.core.driving.companion import Companion
from magcal_ros.core.driving.course_offset import CourseOffset
from magcal_ros.core.driving.mounting_yaw import MountingYaw
from magcal_ros.core.heading.compass import Compass
from magcal_ros.core.heading.moment import Moment
from magcal_ros.core.monitoring.course_check import check_by_course
from magcal_ros.core.samples.streams import STREAMS, FieldSample, ImuSample, Streams
from magcal_ros.core.samples.travel_samples import TravelSample


@dataclass(frozen=True, eq=False)
class RecordedCourse:
    """Compass against course over a recording.

    Parameters
    ----------
    offset : CourseOffset
    checks : tuple of Check
        Of the calibration; empty where too few courses were driven, or nothing says that the
        vehicle goes where it looks.
    mounting : MountingYaw or None
        How the IMU sits in the vehicle, where its acceleration shows it.
    """

    offset: CourseOffset
    checks: tuple[Check, ...]
    mounting: MountingYaw | None = None

    @property
    def words(self) -> str:
        """What was found, in one sentence."""
        found = self.offset
        return (
            f"compass less course {math.degrees(found.offset):+.1f}° ±"
            f"{math.degrees(found.sigma):.1f}° over {found.metres:.0f} m of straight driving,"
            f" {found.sectors} of 8 courses"
        )

    def facts(self) -> dict[str, Any]:
        """Return the same for a program."""
        found = self.offset
        return {
            "offset_deg": round(math.degrees(found.offset), 2),
            "sigma_deg": round(math.degrees(found.sigma), 2),
            "metres": round(found.metres),
            "courses": found.sectors,
            "findings": [
                {"figure": check.key, "state": check.grade.value, "words": check.words}
                for check in self.checks
            ],
        }


def recorded_course(
    calibration: Calibration,
    readings: Iterable[ImuSample | FieldSample | None],
    travel: Iterable[TravelSample],
) -> RecordedCourse | None:
    """Compare a calibration's compass with course; None where nothing was driven straight.

    Parameters
    ----------
    calibration : Calibration
    readings : iterable
        What the sensors said, in its order.
    travel : iterable
        What receiver and wheels said, by stamp.
    """
    companion, compass = Companion(travel, Streams(STREAMS.max_gap)), Compass(calibration)
    travelling = companion.travelling
    for sample in companion.along(readings):
        if isinstance(sample, FieldSample):
            up = companion.up.at(sample.stamp, STREAMS.max_gap)
            heading = Moment.of(compass, sample, up, None).heading
            if heading is not None:
                travelling.add_yaw(heading.yaw)
    course = travelling.fit_course()
    if course is None:
        return None
    mounting = travelling.known_mounting
    return RecordedCourse(course, () if mounting is None else check_by_course(course), mounting)
