"""Compare accelerometer, gyro and field while the robot moves."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from magcal_ros.core.doctor.alignment import NO_BIAS
from magcal_ros.core.doctor.axes_diagnosis import (
    PossibleAxes,
    check_gravity_direction,
    diagnose_axes,
)
from magcal_ros.core.doctor.axes_hypotheses import (
    UNIT_ERRORS,
    AxesHypotheses,
    AxesHypothesis,
    compare_axes,
    likely_rate_factor,
)
from magcal_ros.core.doctor.doctor_tuning import AXES
from magcal_ros.core.doctor.finding import Finding, ok_or_severe, ok_or_warning, undetermined
from magcal_ros.core.doctor.prepared import CleanLog, segment_of_log
from magcal_ros.core.doctor.turn_fit import TurnFit
from magcal_ros.core.geometry.arrays import FloatArray, interpolated
from magcal_ros.core.geometry.attitude import usual_size
from magcal_ros.core.knowledge import Belief, Knowledge, Mounting
from magcal_ros.core.samples.rest import LongestRest, longest_rest
from magcal_ros.core.samples.units import slow_words
from magcal_ros.core.samples.window import SensorLog, working_axes

FULL_GUIDE = "stand still, turn left once, and lift the nose by 20° or drive over a kerb"
"""The movement that determines all quantities of a report."""
FASTER = "publish or record the IMU at a higher rate"
NO_GYRO = (
    "without a gyro, turned, swapped or mirrored axes of the magnetometer cannot be recognised: "
    "check them by the data sheet, or drive straight with a speed or a course"
)
GRAVITY_FIRST = "correct the accelerometer as described below, then check again"


@dataclass(frozen=True, eq=False)
class MotionResult:
    """The findings of the comparison, and the hypothesis behind them."""

    prepared: CleanLog  # the clean log that was compared
    findings: tuple[Finding, ...]
    axes: PossibleAxes | None = None
    """The possible axes of the magnetometer; None if they are not determined."""
    hypothesis: AxesHypothesis | None = None
    """The chosen hypothesis; None if none explains the movement."""
    factor: float = 1.0  # converts the gyro's numbers to rad/s
    up_is_down: bool | None = False
    """Whether gravity's sign is wrong; None if undecided."""
    rest: LongestRest | None = None
    """A rest that the field proves, with rates as published."""
    missing: str = ""  # the movement that the comparison needs; empty if it was made
    turn: TurnFit | None = None  # the fit by the hypothesis, if it was compared with others


def compare(
    prepared: CleanLog, knowledge: Knowledge, turned_left: bool | None = None
) -> MotionResult:
    """Compare accelerometer, gyro and field."""
    log, mounting = prepared.log, knowledge.mounting
    if prepared.is_short:
        return MotionResult(prepared, ())
    if not log.has_gyro:
        found = ok_or_warning("no_gyro", "gyro", "absent", NO_GYRO)
        up = check_gravity_direction(log, None, None, turned_left, mounting)[0]
        return MotionResult(prepared, (found, up))
    body = replace(log, field=log.field @ mounting.to_body.T)
    part = segment_of_log(body)
    # The field must change by more than its noise.
    if part is None or usual_size(np.diff(part.field, axis=0)) >= AXES.worst_fit:
        return _nothing_shown(prepared, None, turned_left, mounting)
    inside = (body.field_time >= body.imu_time[0]) & (body.field_time <= body.imu_time[-1])
    time = body.field_time[inside]
    rates = interpolated(time, body.imu_time, body.rate)
    rest = longest_rest(time, body.field[inside], rates)
    bias = NO_BIAS if rest is None else rest.rate
    # Only a rest that the field proves is reported.
    rest = rest if rest is not None and rest.is_certain else None
    likely = likely_rate_factor(part)
    given, factor = _explained(body, likely, knowledge, bias)
    if given is None:
        return _nothing_shown(prepared, rest, turned_left, mounting)
    # If gravity points down, its sign may be wrong, and then the field seems to point up.
    dip = knowledge.reference.inclination
    other = replace(given, inclination=Belief(-dip.value, dip.sigma))
    living = working_axes(log.rate)
    dead = any(living) and not all(living)
    stands, up_is_down = check_gravity_direction(
        log, None if dead else given, other, turned_left, mounting
    )
    hypotheses = other if up_is_down else given
    if up_is_down and turned_left is not None:
        turned_left = not turned_left
    diagnosis = diagnose_axes(hypotheses, knowledge, turned_left, bool(up_is_down), dead)
    if stands.is_wrong and not up_is_down and any(each.is_wrong for each in diagnosis.findings):
        # Those findings are in the IMU's axes, which may need a correction themselves.
        unclear = (undetermined("axes", "axes", GRAVITY_FIRST),)
        diagnosis = diagnosis._replace(findings=unclear, axes=None)
    findings = _unit(factor, likely), stands, *diagnosis.findings
    hypothesis = None if diagnosis.chosen is None else hypotheses.hypothesis(diagnosis.chosen)
    axes, turn = diagnosis.axes, diagnosis.turn
    return MotionResult(prepared, findings, axes, hypothesis, factor, up_is_down, rest, turn=turn)


def _explained(
    log: SensorLog, factor: float, knowledge: Knowledge, bias: FloatArray
) -> tuple[AxesHypotheses | None, float]:
    """Explain the movement, with a known error of the gyro's unit if this fits better."""

    def explained(factor: float) -> AxesHypotheses | None:
        inclination = knowledge.reference.inclination
        return compare_axes(replace(log, rate=factor * log.rate), inclination, factor * bias)

    slip = None if factor == 1.0 else explained(factor)
    # Rates in a wrong unit take longest to fit, so they are not compared with a good fit.
    if slip is not None and slip.explains(AXES.good_fit):
        return slip, factor
    given = explained(1.0)
    rival = AXES.worst_fit if given is None else min(AXES.worst_fit, float(given.fit.rms.min()))
    return (slip, factor) if slip is not None and slip.explains(rival) else (given, 1.0)


def _nothing_shown(
    prepared: CleanLog, rest: LongestRest | None, turned_left: bool | None, mounting: Mounting
) -> MotionResult:
    """Return the result without a comparison; a rest still shows the gyro's bias."""
    log = prepared.log
    missing = FASTER if slow_words(float(np.median(np.diff(log.imu_time)))) else FULL_GUIDE
    up = check_gravity_direction(log, None, None, turned_left, mounting)[0]
    findings = undetermined("axes", "axes", missing), up
    return MotionResult(prepared, findings, rest=rest, missing=missing)


def _unit(factor: float, likely: float) -> Finding:
    if factor != likely:
        return undetermined("rate_unit", "gyro: unit", "turn on the spot, away from iron")
    if factor == 1.0:
        return ok_or_warning("rate_unit", "gyro: unit", "rad/s, by how fast the field turns")
    evidence = f"rad/s times {1.0 / factor:.4g}, by how fast the field turns"
    times, size = (1.0 / factor, "large") if factor < 1.0 else (factor, "small")
    words = (
        f"the gyro's rates are {times:.3g} times too {size}, which looks like "
        f"{UNIT_ERRORS[factor]}; multiply them by {factor:.6g} in the driver"
    )
    return ok_or_severe("rate_unit", "gyro: unit", evidence, words)
