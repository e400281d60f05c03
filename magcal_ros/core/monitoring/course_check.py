"""What course says of the calibration in force: a compass that swings once around is bent."""

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
    "made where the field was bent: heading swings once around by",
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
    """When the harmonics of compass against course accuse a calibration.

    Parameters
    ----------
    once, twice : Bound
        Of the swing once around, which is hard iron, and twice around, which is soft iron.
    clear : float
        Sigmas that count.
    sectors : int
        Courses, of eight, that must have been driven.
    """

    once: Bound = SWING_ONCE
    twice: Bound = SWING_TWICE
    clear: float = 4.0
    sectors: int = 4


def check_by_course(
    course: CourseOffset | None, tuning: CourseCheckTuning | None = None
) -> tuple[Check, ...]:
    """Grade a calibration by course; empty before enough courses were driven.

    Parameters
    ----------
    course : CourseOffset or None
        Compass against course under the calibration in force, of a vehicle that goes where it
        looks.
    tuning : CourseCheckTuning, optional
        What is taken for granted.
    """
    tuning = tuning or CourseCheckTuning()
    if course is None or course.sectors < tuning.sectors:
        return ()
    checks = []
    for order, bound in ((1, tuning.once), (2, tuning.twice)):
        swing, sigmas = course.swing(order)
        counts = swing if sigmas > tuning.clear else 0.0
        note = f" (± {math.degrees(swing / max(sigmas, 1e-9)):.1f}°)"
        checks.append(bound.check(swing, excess=counts, note=note))
    return tuple(checks)


def accusation(checks: tuple[Check, ...]) -> str:
    """Return what is wrong with the calibration in words; empty if nothing is."""
    return "; ".join(check.words for check in checks if check.grade.rank >= Grade.WARN.rank)
