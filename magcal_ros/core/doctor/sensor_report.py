"""The report of the doctor: every fault of the sensors, graded, with its remedy.

A turn is refused with the same remedies if a fault of the sensors makes it unusable.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from magcal_ros.core.assessment.grading import Grade
from magcal_ros.core.calibration.calibration import Calibration, Evidence
from magcal_ros.core.calibration.correction import PARAMETERS, Correction
from magcal_ros.core.doctor.alignment import FIELD, IRON, SOFT
from magcal_ros.core.doctor.axes_diagnosis import AXES_KEYS, PossibleAxes, mount_of, parameter_line
from magcal_ros.core.doctor.axes_hypotheses import AxesHypothesis, likely_rate_factor
from magcal_ros.core.doctor.doctor_tuning import ERRORS
from magcal_ros.core.doctor.field_by_movement import with_field
from magcal_ros.core.doctor.finding import Finding, ok_or_severe, ok_or_warning, undetermined
from magcal_ros.core.doctor.health import (
    WRONG_UNIT,
    alive_finding,
    field_findings,
    noise_findings,
    stuck_axes,
    up_axis,
)
from magcal_ros.core.doctor.motion import MotionResult, compare
from magcal_ros.core.doctor.prepared import prepare, segment_of_log
from magcal_ros.core.doctor.quirks import known_quirks, orientation_findings
from magcal_ros.core.doctor.turn_errors import findings_by_turn
from magcal_ros.core.doctor.turn_fit import fit_turn
from magcal_ros.core.errors import Reason, Refusal
from magcal_ros.core.geometry.attitude import usual_size
from magcal_ros.core.geometry.rotations import axes_in_words, is_mirrored, rotation_from_rpy
from magcal_ros.core.knowledge import CLEAR, Belief, Knowledge, Mounting
from magcal_ros.core.samples.bursts import bursts_in_words
from magcal_ros.core.samples.streams import SWAY
from magcal_ros.core.samples.units import (
    LEAST_UPRIGHT,
    MISLED_BY_AXES,
    TURNED_OVER,
    Z_NOT_UP,
    likely_field_unit,
    was_turned_over,
)
from magcal_ros.core.samples.window import SensorLog, Window, is_noiseless, working_axes

YAW_BY_COURSE = "axes: yaw by course"
DRIVE_FARTHER = "drive farther: straight, in several directions, and faster than walking pace"

UNPAIRED_ONLY = ("bursts", "stamps", "repeats")  # keys of findings that need unpaired samples


@dataclass(frozen=True)
class SensorReport:
    """All findings on the sensors of a log."""

    findings: tuple[Finding, ...]
    mount_rpy_deg: tuple[int, int, int] | None = None
    """The mounting that corrects the magnetometer's axes; None if they are right or not known, or
    if no mounting corrects them."""
    axes: PossibleAxes | None = None  # the possible axes of the magnetometer
    compass: Calibration | None = None
    """A compass with the likeliest axes, good enough to be compared with a drive's course."""

    @property
    def parameters(self) -> str:
        """The line of a parameter file that corrects the axes; empty if there is none."""
        return "" if self.mount_rpy_deg is None else parameter_line(self.mount_rpy_deg)

    def with_more(self, findings: Iterable[Finding]) -> SensorReport:
        """Return the report with more findings."""
        return replace(self, findings=(*self.findings, *findings))

    def with_course(self, gap: Belief, imu_yaw: Belief) -> SensorReport:
        """Return the report with findings on the axes' yaw, and the mounting that corrects it.

        `gap` is the yaw of the compass with these axes minus course and declination, and minus the
        IMU's yaw if known. `imu_yaw` is the IMU's yaw in the vehicle, positive to the left, from
        the vehicle's acceleration. Both are in radians.
        """
        assert self.axes is not None
        knows_imu = CLEAR * imu_yaw.sigma < ERRORS.near
        report = self.with_more([_imu_yaw(imu_yaw)]) if knows_imu else self
        if not CLEAR * gap.sigma < ERRORS.near:
            return report.with_more([undetermined("field_yaw", YAW_BY_COURSE, DRIVE_FARTHER)])
        quarters = round(gap.value / (0.5 * math.pi))
        off, sigma = math.degrees(gap.value), math.degrees(gap.sigma)
        evidence = f"the compass is {off:+.0f} ± {sigma:.0f}° off the course"
        if not quarters % 4 or abs(gap.value - 0.5 * math.pi * quarters) > ERRORS.near:
            return report.with_more([ok_or_warning("field_yaw", YAW_BY_COURSE, evidence)])
        turn = rotation_from_rpy(0.0, 0.0, -0.5 * math.pi * quarters)
        right = np.rint(self.axes.likeliest @ turn)
        mount = mount_of(right, self.axes.pose)
        axes = f"the magnetometer's axes are {axes_in_words(right)}: set `{parameter_line(mount)}`"
        either = (
            f"either {axes}; or IMU and magnetometer are both turned by {90 * quarters:+d}° to "
            f"the left of the front: set `vehicle_yaw_deg: {90.0 * quarters}`. To tell which, "
            "record the speed too, and accelerate and brake"
        )
        words = axes if knows_imu else either
        report = report.with_more([ok_or_severe("field_yaw", YAW_BY_COURSE, evidence, words)])
        return replace(report, mount_rpy_deg=mount) if knows_imu else report


def examine(
    log: SensorLog, knowledge: Knowledge = Knowledge(), turned_left: bool | None = None
) -> SensorReport:
    """Check the sensors of a log for all known faults.

    `turned_left` is whether the user turned the robot to the left; None if unknown.
    """
    return _report(log, compare(prepare(log), knowledge, turned_left), knowledge)


def _report(log: SensorLog, found: MotionResult, knowledge: Knowledge) -> SensorReport:
    """Return the findings on a log whose sensors have been compared."""
    prepared, hypothesis, axes = found.prepared, found.hypothesis, found.axes
    if prepared.is_short:
        return SensorReport((*prepared.findings, *known_quirks(log)))
    lines = [*prepared.findings, *noise_findings(prepared.log, found.factor), *found.findings]
    mount = wrong = compass = None
    if found.missing:
        lines += findings_by_turn(found, None, None)
    elif hypothesis is not None:
        is_wrong_unit = any(each.key == WRONG_UNIT and each.is_wrong for each in lines)
        is_usable = not prepared.restamped and not is_wrong_unit
        turn = found.turn if is_usable else None
        if is_usable and turn is None:
            turn = fit_turn(hypothesis, knowledge, bool(found.up_is_down))
        lines += findings_by_turn(found, hypothesis, turn)
        lines = with_field(lines, found, hypothesis, knowledge, turn)
        if axes is not None and found.factor == 1.0 and not found.up_is_down:
            compass = compass_of(hypothesis, knowledge)
    is_field = any(finding.key == AXES_KEYS["magnetometer"] for finding in found.findings)
    if axes is not None and is_field and len(axes.candidates) == 1:
        mount, wrong = axes.mount_rpy_deg, axes.candidates[0]
    lines += known_quirks(log, wrong)
    lines += orientation_findings(log, knowledge) if wrong is None else []
    return SensorReport(tuple(lines), mount, axes, compass)


# A refusal and a report need the same turn several times.
@lru_cache(maxsize=1)
def _compared_window(window: Window, knowledge: Knowledge) -> MotionResult:
    return compare(prepare(SensorLog.of_window(window)), knowledge)


@lru_cache(maxsize=1)
def examine_window(window: Window, knowledge: Knowledge = Knowledge()) -> SensorReport:
    """Check the sensors by the samples of a turn, which are already paired and cleaned."""
    found = _compared_window(window, knowledge)
    report = _report(SensorLog.of_window(window), found, knowledge)
    kept = [f for f in report.findings if f.key not in UNPAIRED_ONLY]
    return replace(report, findings=tuple(kept))


def compass_of(hypothesis: AxesHypothesis, knowledge: Knowledge) -> Calibration | None:
    """Return the compass of a hypothesis in rad/s and body axes; None if it is not usable."""
    state = hypothesis.state
    if not np.array_equal(hypothesis.gyro, np.eye(3)) or is_mirrored(hypothesis.field):
        return None
    level = float(np.linalg.norm(np.cross(state[FIELD], hypothesis.part.up[0])))
    if not float(hypothesis.sigma[IRON].max()) < ERRORS.near / CLEAR * level:
        return None
    to_axes = hypothesis.field.T @ knowledge.mounting.to_body
    soft = np.eye(3) + state[SOFT].reshape(3, 3)
    hard_iron = np.asarray(np.linalg.solve(to_axes, state[IRON]), dtype=np.float64)
    return Calibration(
        Correction(np.linalg.inv(soft) @ to_axes, hard_iron),
        1e-4 * np.eye(PARAMETERS),
        1e-6,
        math.radians(1.0),
        float(np.linalg.norm(state[FIELD])),
        0.0,
        Evidence("doctor", "", "", ""),
    )


def _imu_yaw(measured: Belief) -> Finding:
    degrees = math.degrees(measured.value)
    evidence = (
        f"x points {abs(degrees):.0f} ± {math.degrees(measured.sigma):.0f}° to the "
        f"{'left' if degrees >= 0.0 else 'right'} of the front"
    )
    remedy = (
        f"turn the IMU's axes in the driver or its joint in the URDF by {degrees:.0f}° about z, or "
        f"set `vehicle_yaw_deg: {degrees:.0f}.0`"
    )
    is_off = abs(measured.value) > ERRORS.near
    return ok_or_warning("imu_yaw", "IMU: yaw in the vehicle", evidence, remedy * is_off)


CONTRADICTIONS = ("axes", *AXES_KEYS.values(), "rate_unit", "frozen")
"""Keys of the findings that explain why field, gyro and gravity disagree."""


def wrong_axes(window: Window, knowledge: Knowledge) -> Refusal | None:
    """Return a refusal if axes are certainly wrong; None if they may be right."""
    refusal = _wrong_gyro(window, knowledge)
    if refusal is not None or window.angular_rate is None:
        return refusal
    certain = _refusal_by_comparison(window, knowledge, least=Grade.REFUSED)
    return None if certain is None else wrong_stamps(window) or certain


def wrong_reading(window: Window, knowledge: Knowledge) -> Refusal | None:
    """Return a refusal of readings that no fit can use; None if a fit can be tried.

    Saturation makes the hard iron look smaller, and a field in another unit contradicts the priors
    of a fit, which are in tesla.
    """
    for found in field_findings(window.field) if len(window) >= 3 else ():
        if found.is_wrong and found.key == WRONG_UNIT:
            return _refusal_by(examine_window(window, knowledge).findings, (WRONG_UNIT,))
        if found.is_wrong and found.key == "saturation":
            words = f"the magnetometer saturates ({found.evidence}); {found.remedy}"
            return Refusal(Reason.NO_SOLUTION, words)
        if found.key == "frozen" and stuck_axes(window.field):
            words = f"{found.remedy}, or its range ends below the field"
            return Refusal(Reason.NO_SOLUTION, words)
    return _wrong_gyro(window, knowledge)


def _wrong_gyro(window: Window, knowledge: Knowledge) -> Refusal | None:
    """Return a refusal of a gyro that is frozen, dead about the vertical, or in a wrong unit.

    A frozen accelerometer is refused, too. Its force may be constant if the gyro shows no noise:
    then the sensors are simulated.
    """
    rate = window.angular_rate
    if rate is None or len(window) < 3:
        return None
    readings = [rate] if is_noiseless(rate) else [rate, window.specific_force]
    if rate.any() and any(not np.ptp(each, axis=0).any() for each in readings):
        frozen = _refusal_by_comparison(window, knowledge, ("frozen",))
        if frozen is not None:
            return frozen
    living = working_axes(rate)
    if any(living) and not living[up_axis(window.specific_force)]:
        return Refusal(
            Reason.AXES_DISAGREE,
            f"{alive_finding('gyro', rate, window.specific_force).remedy}; correct the driver, or "
            "let it mark the rates as absent (angular_velocity_covariance[0] = -1; in a table, "
            "leave the columns out) to be calibrated without a gyro",
        )
    segment = segment_of_log(SensorLog.of_window(window))
    if segment is not None and likely_rate_factor(segment) != 1.0:
        return _refusal_by_comparison(window, knowledge, ("rate_unit",))
    return None


def wrong_stamps(window: Window) -> Refusal | None:
    """Return a refusal if there is a gyro and the stamps come in bursts; else None."""
    bursts = "" if window.angular_rate is None else bursts_in_words(window.time)
    if not bursts:
        return None
    return Refusal(Reason.AXES_DISAGREE, f"gyro and field do not match: {bursts}")


def refusal_by_axes(refusal: Refusal, window: Window, knowledge: Knowledge) -> Refusal:
    """Return the refusal for wrong axes if they caused a method's refusal, else the latter."""
    wrong = wrong_axes(window, knowledge) if refusal.reason in MISLED_BY_AXES else None
    return with_explanation(refusal, window, knowledge.mounting) if wrong is None else wrong


def with_explanation(refusal: Refusal, window: Window, mounting: Mounting = Mounting()) -> Refusal:
    """Add the likely cause to a refusal, if it is a fault of the samples.

    Such faults are the field's unit, axes that point down, stamps in bursts, and a slow IMU.
    """
    if len(window) == 0:
        return refusal
    hint = likely_field_unit(usual_size(window.field))
    if not hint and refusal.reason in MISLED_BY_AXES:
        force = window.specific_force.mean(axis=0)
        if was_turned_over(window):
            hint = TURNED_OVER
        elif math.cos(mounting.lean(force)) < LEAST_UPRIGHT:
            hint = Z_NOT_UP
        hint = hint or bursts_in_words(window.time) or _slow_gyro_in_words(window)
    return Refusal(refusal.reason, f"{str(refusal).rstrip('.')}; {hint}") if hint else refusal


def _slow_gyro_in_words(window: Window) -> str:
    """Say that a gyro is too slow for a shaking robot; empty if it is not."""
    gap = window.imu_gap
    # A sway is resolved with at least two samples in half a period.
    if window.angular_rate is None or gap <= 0.5 * SWAY:
        return ""
    return (
        f"or the robot shakes too fast for an IMU of {1.0 / gap:.2g} Hz: publish or record it at "
        "10 Hz or more, if possible at 50 Hz"
    )


def refusal_by_sensors(refusal: Refusal, window: Window, knowledge: Knowledge) -> Refusal:
    """Return the refusal of a turn that was not detected, or that for the faults behind it."""
    return _wrong_gyro(window, knowledge) or _refusal_by_comparison(window, knowledge) or refusal


def _refusal_by_comparison(
    window: Window,
    knowledge: Knowledge,
    keys: tuple[str, ...] = CONTRADICTIONS,
    least: Grade = Grade.WARN,
) -> Refusal | None:
    """Return a refusal by the comparison of the sensors, without the rest of the report."""
    found = _compared_window(window, knowledge)
    return _refusal_by(found.prepared.findings + found.findings, keys, least)


def _refusal_by(
    findings: Iterable[Finding], keys: tuple[str, ...], least: Grade = Grade.WARN
) -> Refusal | None:
    """Return a refusal with the remedies of some findings; None if they have none."""
    remedies = [f.remedy for f in findings if f.key in keys and f.grade.rank >= least.rank]
    return Refusal(Reason.AXES_DISAGREE, "; ".join(remedies)) if any(remedies) else None
