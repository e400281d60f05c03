"""The calibration in force against course: a deviation once per turn shows hard iron."""

from __future__ import annotations

import math
from dataclasses import dataclass

from magcal_ros.core.assessment.grading import Bound, Check, Grade
from magcal_ros.core.calibration.figure import Figure
from magcal_ros.core.driving.course_offset import CourseOffset

SWING_ONCE = Bound(
    Figure.COURSE_SWING_ONCE,
    4.0,
    8.0,
    "made where the field was disturbed: heading swings once around by",
    "calibrate in the open, away from steel",
)
SWING_TWICE = Bound(
    Figure.COURSE_SWING_TWICE,
    4.0,
    8.0,
    "soft iron is missing: heading swings twice around by",
    "calibrate with turns on slopes, or give soft_iron_gains",
)


@dataclass(frozen=True)
class CourseCheckTuning:
    """When the harmonics of compass against course show that a calibration is wrong."""

    clear: float = 4.0
    """Sigmas that count."""
    sectors: int = 4
    """Courses, of eight, that must have been driven."""


TUNING = CourseCheckTuning()


def check_by_course(course: CourseOffset | None) -> tuple[Check, ...]:
    """Grade a calibration by course; empty before enough courses were driven."""
    if course is None or course.sectors < TUNING.sectors:
        return ()
    checks = []
    # Once around is hard iron, twice around soft iron.
    for order, bound in ((1, SWING_ONCE), (2, SWING_TWICE)):
        swing, sigmas = course.swing(order)
        counts = swing if sigmas > TUNING.clear else 0.0
        note = f" (± {math.degrees(swing / max(sigmas, 1e-9)):.1f}°)"
        checks.append(bound.check(swing, excess=counts, note=note))
    return tuple(checks)


def course_fault(checks: tuple[Check, ...]) -> str:
    """Return what is wrong with the calibration in words; empty if nothing is."""
    return "; ".join(check.words for check in checks if check.grade.rank >= Grade.WARN.rank)
