"""The page: everything that is wrong with the sensors, graded, and what mends it."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from magcal_ros.core.assessment.axes import parameter_line
from magcal_ros.core.assessment.grading import Grade, worst
from magcal_ros.core.doctor.course import AxesInUse, CourseSeen, axes_in_use, course_findings
from magcal_ros.core.doctor.field_at_place import motors_finding, reference_findings
from magcal_ros.core.doctor.finding import Finding
from magcal_ros.core.doctor.health import noise_findings
from magcal_ros.core.doctor.motion import MotionFound, compare
from magcal_ros.core.doctor.prepared import CleanLog, prepare
from magcal_ros.core.doctor.quirks import known_habits, orientation_findings
from magcal_ros.core.doctor.upright import UserAnswers
from magcal_ros.core.knowledge import Knowledge
from magcal_ros.core.samples.window import SensorLog, Window

PAIRED = ("bursts", "stamps", "repeats")
"""Lines of which paired samples show nothing."""


@dataclass(frozen=True)
class Page:
    """What was found."""

    findings: tuple[Finding, ...]
    """All lines."""
    mount_rpy_deg: tuple[int, int, int] | None = None
    """The mounting that alone mends the magnetometer's axes; None where none does, or where none
    has to."""
    used: AxesInUse | None = None
    """What a drive's course can be compared with."""

    @property
    def misleads(self) -> bool:
        """Whether something is wrong that would make a heading wrong."""
        return any(finding.grade is Grade.REFUSED for finding in self.findings)

    @property
    def grade(self) -> Grade:
        """The worst of all lines; what was not shown is none."""
        return worst([f.grade for f in self.findings if f.grade is not Grade.GOOD])

    @property
    def parameters(self) -> str:
        """The lines of a parameter file that mend what parameters can mend; may be empty."""
        return "" if self.mount_rpy_deg is None else parameter_line(self.mount_rpy_deg)

    def with_more(self, findings: Iterable[Finding]) -> Page:
        """Return the page with more lines."""
        return replace(self, findings=(*self.findings, *findings))

    def with_course(self, seen: CourseSeen) -> Page:
        """Return the page with what the course says of the axes' yaw, which no turn can tell."""
        assert self.used is not None
        lines, mount = course_findings(self.used, seen)
        page = self.with_more(lines)
        return page if mount is None else replace(page, mount_rpy_deg=mount)


def examine(
    log: SensorLog, knowledge: Knowledge = Knowledge(), answers: UserAnswers = UserAnswers()
) -> Page:
    """Look at everything that a log shows of its sensors."""
    prepared = prepare(log)
    left = prepared.log
    if min(len(left.imu_time), len(left.field_time)) < 3:
        return Page((*prepared.findings, *known_habits(log)))
    found = compare(prepared, knowledge, answers)
    lines = [*prepared.findings, *noise_findings(left, found.factor), *found.findings]
    lines += _of_the_field(prepared, found, knowledge)
    mount = None
    axes = found.axes
    if axes is not None and not axes.right and len(axes.candidates) == 1:
        mount = axes.mount_rpy_deg
        lines += known_habits(log, axes.candidates[0])
    else:
        lines += known_habits(log)
        lines += orientation_findings(log, knowledge)
    used = None
    if found.explained and found.factor == 1.0 and not found.up_is_down:
        assert found.explanations is not None
        used = axes_in_use(found.explanations, found.chosen, knowledge)
    return Page(tuple(lines), mount, used)


def examine_window(window: Window, knowledge: Knowledge = Knowledge()) -> Page:
    """Look at what the samples of a turn show, which are paired and cleaned already."""
    nothing = np.full((len(window), 3), np.nan)
    rate = nothing if window.angular_rate is None else window.angular_rate
    log = SensorLog(window.time, window.specific_force, rate, window.time, window.field)
    page = examine(log, knowledge)
    kept = [f for f in page.findings if f.key not in PAIRED]
    return replace(page, findings=tuple(kept))


def _of_the_field(prepared: CleanLog, found: MotionFound, knowledge: Knowledge) -> list[Finding]:
    if not found.explained:
        return []
    assert found.explanations is not None
    log = prepared.log
    body = replace(
        log, rate=found.factor * log.rate, field=log.field @ knowledge.mounting.to_body.T
    )
    lines = reference_findings(found.explanations, found.chosen, knowledge, found.up_is_down)
    if not prepared.restamped and np.isfinite(log.rate).all():
        shown = any(f.key == "latency" and f.grade is not Grade.GOOD for f in found.findings)
        lines.append(motors_finding(body, found.explanations, found.chosen, shown))
    return lines
