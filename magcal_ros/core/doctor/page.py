"""The page of the doctor: every fault of the sensors, graded, with its remedy.

And the refusal of a turn where the sensors are behind it, in the words of the page.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from magcal_ros.core.assessment.grading import Grade
from magcal_ros.core.doctor.blame import AxesFound, parameter_line
from magcal_ros.core.doctor.course import AxesInUse, axes_in_use, course_findings
from magcal_ros.core.doctor.explanations import rate_factors
from magcal_ros.core.doctor.field_by_movement import WRONG_UNIT, with_field
from magcal_ros.core.doctor.health import (
    Finding,
    alive_finding,
    dead_axes,
    field_findings,
    noise_findings,
    stuck_axes,
    up_axis,
)
from magcal_ros.core.doctor.motion import compare
from magcal_ros.core.doctor.prepared import prepare
from magcal_ros.core.doctor.quirks import known_habits, orientation_findings
from magcal_ros.core.errors import Reason, Refusal
from magcal_ros.core.knowledge import Belief, Knowledge
from magcal_ros.core.samples.bursts import bursts_in_words
from magcal_ros.core.samples.units import MISLED_BY_AXES, explained
from magcal_ros.core.samples.window import SensorLog, Window, stretch_of_log

PAIRED = ("bursts", "stamps", "repeats")  # lines of which paired samples show nothing


@dataclass(frozen=True)
class Page:
    """What was found."""

    findings: tuple[Finding, ...]  # all lines
    mount_rpy_deg: tuple[int, int, int] | None = None
    """The mounting that corrects the magnetometer's axes; None where none does, or none has to."""
    used: AxesInUse | None = None  # what a drive's course can be compared with
    axes: AxesFound | None = None  # what the movement shows of the magnetometer's axes

    @property
    def misleads(self) -> bool:
        """Whether something is wrong that would make a heading wrong."""
        return any(finding.grade is Grade.REFUSED for finding in self.findings)

    @property
    def parameters(self) -> str:
        """The lines of a parameter file that correct what parameters can correct; may be empty."""
        return "" if self.mount_rpy_deg is None else parameter_line(self.mount_rpy_deg)

    def with_more(self, findings: Iterable[Finding]) -> Page:
        """Return the page with more lines."""
        return replace(self, findings=(*self.findings, *findings))

    def with_course(self, gap: Belief, imu_yaw: Belief) -> Page:
        """Return the page with what the course shows of the axes' yaw, which no turn can show."""
        assert self.used is not None
        lines, mount = course_findings(self.used, gap, imu_yaw)
        page = self.with_more(lines)
        return page if mount is None else replace(page, mount_rpy_deg=mount)


def examine(
    log: SensorLog, knowledge: Knowledge = Knowledge(), turned_left: bool | None = None
) -> Page:
    """Look at everything that a log shows of its sensors.

    `turned_left` is what the user says of the turn; None where that was not asked.
    """
    prepared = prepare(log)
    left = prepared.log
    if min(len(left.imu_time), len(left.field_time)) < 3:
        return Page((*prepared.findings, *known_habits(log)))
    found = compare(prepared, knowledge, turned_left)
    lines = [*prepared.findings, *noise_findings(left, found.factor), *found.findings]
    lines = with_field(lines, prepared, found, knowledge)
    mount, wrong, axes = None, None, found.axes
    is_field = any(finding.key == "field_axes" for finding in found.findings)
    if axes is not None and is_field and len(axes.candidates) == 1:
        mount, wrong = axes.mount_rpy_deg, axes.candidates[0]
    lines += known_habits(log, wrong)
    lines += orientation_findings(log, knowledge) if wrong is None else []
    used = None
    if found.way is not None and found.factor == 1.0 and not found.up_is_down:
        used = axes_in_use(found.way, knowledge)
    return Page(tuple(lines), mount, used, axes)


# A refusal and a report ask the same of the same turn, several times.
@lru_cache(maxsize=1)
def examine_window(window: Window, knowledge: Knowledge = Knowledge()) -> Page:
    """Look at what the samples of a turn show, which are paired and cleaned already."""
    page = examine(SensorLog.of_window(window), knowledge)
    kept = [f for f in page.findings if f.key not in PAIRED]
    return replace(page, findings=tuple(kept))


AXES = ("axes", "gyro_axes", "field_axes", "force_axes", "rate_unit", "frozen")
"""Lines of the page that say why field, gyro and gravity disagree."""


def wrong_axes(window: Window, knowledge: Knowledge) -> Refusal | None:
    """Return the refusal of a turn whose axes are certainly wrong; None where they may be right."""
    refusal = _wrong_gyro(window, knowledge)
    if refusal is not None or window.angular_rate is None:
        return refusal
    certain = _by_the_page(window, knowledge, least=Grade.REFUSED)
    return None if certain is None else wrong_stamps(window) or certain


def wrong_reading(window: Window, knowledge: Knowledge) -> Refusal | None:
    """Return the refusal of readings that no fit can use, seen before the work; None of others.

    What is cut off at the end of a range looks like a smaller hard iron, and every prior of a fit
    is in tesla.
    """
    for found in field_findings(window.field) if len(window) >= 3 else ():
        if found.is_wrong and found.key == WRONG_UNIT:
            return _by_the_page(window, knowledge, (WRONG_UNIT,))
        if found.is_wrong and found.key == "saturation":
            words = f"the magnetometer saturates ({found.evidence}); {found.remedy}"
            return Refusal(Reason.NO_SOLUTION, words)
        if found.key == "frozen" and stuck_axes(window.field):
            words = f"{found.remedy}, or its range ends below the field"
            return Refusal(Reason.NO_SOLUTION, words)
    return _wrong_gyro(window, knowledge)


def _wrong_gyro(window: Window, knowledge: Knowledge) -> Refusal | None:
    """Return the refusal of a turn whose gyro is frozen, dead in z, or in another unit."""
    rate = window.angular_rate
    if rate is None or len(window) < 3:
        return None
    if rate.any() and not np.ptp(rate, axis=0).any():
        return _by_the_page(window, knowledge, ("frozen",))
    if up_axis(window.specific_force) in dead_axes(rate):
        return Refusal(
            Reason.AXES_DISAGREE,
            f"{alive_finding('gyro', rate, window.specific_force).remedy}; correct the driver, or "
            "let it mark the rates as absent (angular_velocity_covariance[0] = -1; in a table, "
            "leave the columns out) to be calibrated without a gyro",
        )
    stretch = stretch_of_log(SensorLog.of_window(window))
    if stretch is not None and set(rate_factors(stretch) or ()) - {1.0}:
        return _by_the_page(window, knowledge, ("rate_unit",))
    return None


def wrong_stamps(window: Window) -> Refusal | None:
    """Return the refusal of a turn with a gyro whose stamps come in bursts; None of others."""
    bursts = "" if window.angular_rate is None else bursts_in_words(window.time)
    if not bursts:
        return None
    return Refusal(Reason.AXES_DISAGREE, f"gyro and field do not match: {bursts}")


def blamed_on_axes(refusal: Refusal, window: Window, knowledge: Knowledge) -> Refusal:
    """Return a method's refusal, or that of the wrong axes behind it."""
    wrong = wrong_axes(window, knowledge) if refusal.reason in MISLED_BY_AXES else None
    return explained(refusal, window) if wrong is None else wrong


def blamed_on_sensors(refusal: Refusal, window: Window, knowledge: Knowledge) -> Refusal:
    """Return the refusal of a turn that was not seen, or what the page finds of the sensors."""
    return _wrong_gyro(window, knowledge) or _by_the_page(window, knowledge) or refusal


def _by_the_page(
    window: Window, knowledge: Knowledge, lines: tuple[str, ...] = AXES, least: Grade = Grade.WARN
) -> Refusal | None:
    findings = examine_window(window, knowledge).findings
    said = [f.remedy for f in findings if f.grade.rank >= least.rank and f.key in lines]
    return Refusal(Reason.AXES_DISAGREE, "; ".join(said)) if any(said) else None
