"""The page of the doctor: every fault of the sensors, graded, with its remedy.

And the refusal of a turn where the sensors are behind it, in the words of the page.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from magcal_ros.core.assessment.grading import Grade, axial_field_variance, is_likelier
from magcal_ros.core.doctor.blame import LIFT, NOSE, AxesFound, parameter_line
from magcal_ros.core.doctor.course import AxesInUse, axes_in_use, course_findings
from magcal_ros.core.doctor.explanations import Way, rate_factors
from magcal_ros.core.doctor.field_unit import (
    WRONG_UNIT,
    by_strength,
    has_wrong_unit,
    is_vague,
    strength_of,
)
from magcal_ros.core.doctor.health import (
    Finding,
    alive_finding,
    dead_axes,
    field_findings,
    looked_at,
    noise_findings,
    not_shown,
    stuck_axes,
    up_axis,
)
from magcal_ros.core.doctor.latency import drove_while_turning, motors_field
from magcal_ros.core.doctor.motion import (
    FULL_TURN,
    MOVE_THE_SENSOR,
    TURN_BETWEEN_RESTS,
    MotionFound,
    compare,
)
from magcal_ros.core.doctor.prepared import CleanLog, prepare
from magcal_ros.core.doctor.quirks import FIELD_POINTS_UP, known_habits, orientation_findings
from magcal_ros.core.errors import Reason, Refusal
from magcal_ros.core.geometry.attitude import unit
from magcal_ros.core.knowledge import CLEAR, Belief, Knowledge
from magcal_ros.core.samples.alignment import BIAS, FIELD, IRON, LAG, UP
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
    if found.way is not None:
        lines = by_strength(lines, found.way, knowledge)
    lines += _of_the_field(prepared, found, knowledge, in_tesla=not has_wrong_unit(lines))
    if any(line.key == "motors" and line.is_wrong for line in lines):
        # A field of the motors hides what another turn would show.
        said = [f.evidence.replace(FULL_TURN, HIDDEN).replace(LIFT, BY_HAND) for f in lines]
        lines = [replace(f, evidence=each) for f, each in zip(lines, said, strict=True)]
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


def _of_the_field(
    prepared: CleanLog, found: MotionFound, knowledge: Knowledge, *, in_tesla: bool
) -> list[Finding]:
    if found.way is None or found.body is None:
        return []
    if not in_tesla:
        return [
            not_shown("reference", AGAINST_REFERENCE, UNIT_FIRST),
            not_shown("motors", MOTORS, UNIT_FIRST),
        ]
    lines = [reference_finding(found.way, knowledge, found.up_is_down)]
    if not prepared.restamped and np.isfinite(found.body.rate).all():
        shown = any(f.key == "latency" and f.grade is not Grade.GOOD for f in found.findings)
        lines.append(motors_finding(found.body, found.way, shown))
    return lines


@dataclass(frozen=True)
class PlaceTuning:
    """When the field is called another than the reference's, and the motors' one is."""

    strength: float = 0.2  # relative difference
    inclination: float = math.radians(8.0)  # radians
    motors: float = 1.5e-6  # tesla that the motors add
    clear: float = 5.0  # sigmas of that
    turned_too_far: float = math.radians(25.0)
    """Radians of heading of that field from which moving the sensor is the better cure: half the
    level field, where a tenth of it in the motors' current is three degrees."""


TUNING = PlaceTuning()
UNIT_FIRST = "correct the field's unit first, then check again"
MOTORS, AGAINST_REFERENCE = "field: motors", "field: strength, inclination"
BETWEEN_RESTS = "stand still, turn, and stand still again"
ON_THE_SPOT = (
    "the robot drove while it turned, and the field differs from place to place; stand still, "
    "turn on the spot, and stand still again"
)
MOTORS_OFF = "by hand with the motors off (their field hides it)"
HIDDEN, BY_HAND = f"turn once {MOTORS_OFF}", f"{NOSE} {MOTORS_OFF}"
"""What shows the rest where the motors change the field, in place of `FULL_TURN` and `LIFT`."""
OR_LATE = (
    ". Late stamps of the field look the same: to tell them apart, start and stop several times "
    "while you turn"
)


def reference_finding(way: Way, knowledge: Knowledge, up_is_down: bool | None) -> Finding:
    """Compare strength and inclination with the reference, by one way."""
    size, vector = way.part.size, way.state[FIELD]
    up = way.state[UP] * (-1.0 if up_is_down else 1.0)
    whole = strength_of(way)
    strength, off = whole.value, whole.sigma
    if is_vague(whole):
        upwards = None if up_is_down is not False else _points_up(way, knowledge)
        return upwards or not_shown("reference", AGAINST_REFERENCE, LIFT)
    along = float(vector @ up / np.linalg.norm(vector) / np.linalg.norm(up))
    dip = -math.asin(max(-1.0, min(1.0, along)))
    iron = float(np.linalg.norm(way.state[IRON])) * size
    evidence = (
        f"{strength * 1e6:.1f} ± {off * 1e6:.1f} µT without the hard iron of {iron * 1e6:.0f} µT, "
        f"inclination {math.degrees(dip):.0f}°"
    )
    believed = knowledge.reference
    wrong = []
    if not believed.strength.is_unknown:
        spread = math.hypot(off, believed.strength.sigma)
        apart = abs(strength - believed.strength.value)
        if apart > max(TUNING.strength * believed.strength.value, CLEAR * spread):
            wrong.append(f"{believed.strength.value * 1e6:.1f} µT")
    if not believed.inclination.is_unknown and up_is_down is not None:
        spread = math.hypot(off / strength, believed.inclination.sigma)
        limit = max(TUNING.inclination, CLEAR * spread)
        if abs(dip - believed.inclination.value) > limit:
            if abs(dip + believed.inclination.value) <= limit:
                return looked_at("inclination_sign", AGAINST_REFERENCE, evidence, FIELD_POINTS_UP)
            wrong.append(f"an inclination of {math.degrees(believed.inclination.value):.0f}°")
    remedy = (
        f"the reference field has {' and '.join(wrong)}: turn farther away from iron and walls. If "
        "the difference is the same everywhere, the magnetometer's scale or unit is wrong"
    )
    return looked_at("reference", AGAINST_REFERENCE, evidence, remedy * bool(wrong))


def _points_up(way: Way, knowledge: Knowledge) -> Finding | None:
    """Return that the field points up after a level turn, where that takes much less hard iron."""
    believed = knowledge.reference
    if not (way.is_plain and believed.is_complete):
        return None
    up = unit(way.state[UP])
    field, iron = (way.part.size * way.state[part] for part in (FIELD, IRON))
    field_off, iron_off = (way.part.size * way.sigma[part] for part in (FIELD, IRON))
    along = -believed.strength.value * math.sin(believed.inclination.value)
    # The movement may contradict the other sign.
    if abs(float(up @ field) + along) > CLEAR * float(np.linalg.norm(field_off * up)):
        return None
    axial = float(up @ iron)
    both = float(up @ field) + axial
    own, other = abs(both - along), abs(both + along)
    across = float(iron @ iron) - axial**2 + float(iron_off**2 @ (1.0 - up**2))
    across = max(across, axial_field_variance(knowledge))
    if not is_likelier(other, own, across):
        return None
    evidence = (
        f"vertical hard iron of {own * 1e6:.0f} µT, or of {other * 1e6:.0f} µT if the field points "
        "the other way"
    )
    remedy = f"either the robot has that much iron, or {FIELD_POINTS_UP}"
    return looked_at("inclination_sign", AGAINST_REFERENCE, evidence, remedy)


def motors_finding(log: SensorLog, way: Way, lag_is_shown: bool) -> Finding:
    """Look for a field that is there while the robot turns alone; a late one looks like it."""
    state = way.state
    found = motors_field(log, way, float(state[LAG]) if lag_is_shown else 0.0)
    if found is None:
        return not_shown("motors", MOTORS, BETWEEN_RESTS)
    if drove_while_turning(log, way.gyro, state[BIAS]):
        return not_shown("motors", MOTORS, ON_THE_SPOT)
    field, covariance = found
    off = math.sqrt(float(np.linalg.eigvalsh(covariance)[-1]))
    strength = float(np.linalg.norm(field))
    is_seen = float(field @ np.linalg.solve(covariance, field)) > TUNING.clear**2
    is_seen &= strength > TUNING.motors
    if off > TUNING.motors and not is_seen:
        return not_shown("motors", MOTORS, f"within {off * 1e6:.1f} µT; {BETWEEN_RESTS}")
    level = way.part.size * float(np.linalg.norm(np.cross(state[FIELD], unit(state[UP]))))
    turned = math.atan2(strength, level)
    words = ", ".join(f"{value * 1e6:+.1f}" for value in field)
    evidence = (
        f"({words}) ± {off * 1e6:.1f} µT while the robot turns: up to {math.degrees(turned):.0f}° "
        "of heading"
    )
    if strength <= TUNING.motors:
        evidence = f"{strength * 1e6:.1f} ± {off * 1e6:.1f} µT while the robot turns"
    remedy = MOVE_THE_SENSOR if turned > TUNING.turned_too_far else TURN_BETWEEN_RESTS
    remedy += "" if lag_is_shown else OR_LATE
    return looked_at("motors", MOTORS, evidence, remedy * is_seen)


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
