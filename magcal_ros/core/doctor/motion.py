"""Compare accelerometer, gyro and field while the robot moves."""

from __future__ import annotations

import math
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
from magcal_ros.core.doctor.doctor_tuning import AXES, ERRORS, is_vague
from magcal_ros.core.doctor.health import (
    Finding,
    ok_or_severe,
    ok_or_warning,
    undetermined,
    vector_in_words,
)
from magcal_ros.core.doctor.prepared import CleanLog, segment_of_log
from magcal_ros.core.doctor.turn_fit import TurnFit, force_latency
from magcal_ros.core.geometry.arrays import FloatArray, interpolated
from magcal_ros.core.geometry.attitude import usual_size
from magcal_ros.core.knowledge import CLEAR, Belief, Knowledge, Mounting
from magcal_ros.core.samples.rest import LongestRest, longest_rest
from magcal_ros.core.samples.units import slow_words
from magcal_ros.core.samples.window import SensorLog, working_axes

FULL_GUIDE = "stand still, turn left once, and lift the nose by 20° or drive over a kerb"
"""The movement that determines all quantities of a report."""

FULL_TURN = "stand still, then turn a full circle"
FASTER = "publish or record the IMU at a higher rate"
NO_BURSTS = "the stamps must not come in bursts"
FIELD_LAG = 2.0 * AXES.settled
"""Seconds, the error for `is_vague` of the field's latency. Its sigma is the smoother's, which is
right even if a movement shows little; that of the accelerometer's latency is too small then."""
STARTS = "start and stop while you turn, at 20 °/s or more"
LEANS = "lift the nose by 20° within a second or two, or drive over a kerb"
NO_GYRO = (
    "without a gyro, turned, swapped or mirrored axes of the magnetometer cannot be recognised: "
    "check them by the data sheet, or drive straight with a speed or a course"
)

TURN_BETWEEN_RESTS = (
    "if motors turn the robot, their current adds a field. Calibrate by a turn that begins and "
    "ends at rest: it measures this field, and the node subtracts it while the robot moves"
)
MOVE_THE_SENSOR = (
    "if motors turn the robot, their current adds a field, too large to be subtracted well. Move "
    "the sensor away from motors, motor drivers and battery wires, and twist each pair of wires"
)
"""Remedies if the field changes when the robot starts to turn."""


AXES_FIRST = "correct the axes as described above, then check again"
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
    return MotionResult(prepared, findings, axes, hypothesis, factor, up_is_down, rest, turn)


def findings_by_turn(
    found: MotionResult, hypothesis: AxesHypothesis, turn: TurnFit | None
) -> list[Finding]:
    """Return the findings on errors of the gyro and on latencies.

    If those of field and accelerometer are equal, the gyro's stamps are early.
    """
    why = NO_BURSTS if found.prepared.restamped else FULL_TURN
    # Each of several possible corrections of the axes would give other errors.
    is_clear = not any(each.key == "axes" and each.is_wrong for each in found.findings)
    clear = (turn, why) if is_clear else (None, AXES_FIRST)
    lines = _gyro_errors(hypothesis, found, *clear)
    if found.prepared.restamped:
        return [*lines, undetermined("latency", "field: latency", NO_BURSTS)]
    field = Belief.unknown() if turn is None else turn.latency
    force = force_latency(hypothesis)
    field_lag, force_lag = _wrong_by(field, FIELD_LAG), _wrong_by(force, ERRORS.lag)
    if field_lag * force_lag > 0.0 and abs(field_lag - force_lag) < ERRORS.lag:
        of_field = of_force = (
            f"the gyro is {field_lag * 1e3:.0f} ms ahead of both field and accelerometer: stamp it "
            "when it measures, and give it the accelerometer's low-pass filter"
        )
    else:
        seconds = f"{abs(field_lag):.3f} s"
        change = f"add {seconds} to the field's, or subtract it from the IMU's"
        if field_lag > 0.0:
            change = f"subtract {seconds} from the field's, or add it to the IMU's"
        of_field = (
            f"stamp both sensors when they measure, or correct the stamps in the driver: {change}"
        )
        of_force = (
            f"acceleration and rate of one message are {abs(force_lag) * 1e3:.0f} ms apart: give "
            "both the same low-pass filter, and put values of the same moment into one message"
        )
    of_field, of_force = of_field * bool(field_lag), of_force * bool(force_lag)
    return [
        *lines,
        _latency("latency", "field", field, FIELD_LAG, STARTS, of_field),
        _latency("force_latency", "accelerometer", force, ERRORS.lag, LEANS, of_force),
    ]


def _wrong_by(latency: Belief, error: float) -> float:
    """Return a latency in seconds; zero if it is too small or too uncertain to be reported."""
    is_clear = abs(latency.value) >= max(ERRORS.lag, CLEAR * latency.sigma)
    return latency.value if is_clear and not is_vague(latency.sigma, error) else 0.0


def _latency(
    key: str, sensor: str, latency: Belief, error: float, shown_by: str, remedy: str
) -> Finding:
    if is_vague(latency.sigma, error):
        return undetermined(key, f"{sensor}: latency", shown_by)
    lag, off = round(latency.value * 1e3), latency.sigma * 1e3
    how = f"{abs(lag)} ± {off:.0f} ms {'early' if lag < 0 else 'late'} against the gyro"
    return ok_or_warning(key, f"{sensor}: latency", how, remedy)


def _explained(
    log: SensorLog, factor: float, knowledge: Knowledge, bias: FloatArray
) -> tuple[AxesHypotheses | None, float]:
    """Explain the movement, with a known error of the gyro's unit if only this one fits well."""

    def explained(factor: float) -> AxesHypotheses | None:
        inclination = knowledge.reference.inclination
        return compare_axes(replace(log, rate=factor * log.rate), inclination, factor * bias)

    # Rates in a wrong unit take longest to fit as they are, so a known error comes first.
    slip = None if factor == 1.0 else explained(factor)
    if slip is not None and slip.confirms_unit:
        return slip, factor
    given = explained(1.0)
    # After too small a turn, a unit that may be right is kept. Among magnetic objects, as in a
    # street, no unit fits the field well.
    if given is not None and slip is not None and not given.fits_well and slip.is_better(given):
        return slip, factor
    return given, 1.0


def _nothing_shown(
    prepared: CleanLog, rest: LongestRest | None, turned_left: bool | None, mounting: Mounting
) -> MotionResult:
    """Return the findings without a comparison; a rest still shows the gyro's bias."""
    log = prepared.log
    why = FASTER if slow_words(float(np.median(np.diff(log.imu_time)))) else FULL_GUIDE
    bias = undetermined("gyro_bias", "gyro: bias", why)
    findings = (
        undetermined("axes", "axes", why),
        bias if rest is None else _bias(rest.rate, rest.sigma, 1.0),
        undetermined("rate_scale", "gyro: scale", why),
        undetermined("latency", "field: latency", why),
        check_gravity_direction(log, None, None, turned_left, mounting)[0],
    )
    return MotionResult(prepared, findings)


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


def _gyro_errors(
    hypothesis: AxesHypothesis, found: MotionResult, turn: TurnFit | None, why: str
) -> list[Finding]:
    """Return the findings on the gyro's bias and scale; `why` says why there is no turn."""
    factor, rest = found.factor, found.rest
    bias, off = np.zeros(3), math.inf
    if turn is not None:
        # In the gyro's own axes, so that the driver can subtract it.
        bias, off = hypothesis.gyro @ turn.bias, turn.bias_sigma
    if rest is not None and factor * rest.sigma < off:
        bias, off = factor * rest.rate, factor * rest.sigma
    line = _bias(bias, off, factor)
    if is_vague(off, ERRORS.bias):
        line = undetermined("gyro_bias", "gyro: bias", FULL_TURN if why == NO_BURSTS else why)
    if turn is None:
        return [line, undetermined("rate_scale", "gyro: scale", why)]
    return [line, _scale(turn.scale, factor)]


def _scale(scale: Belief, factor: float) -> Finding:
    if is_vague(scale.sigma, ERRORS.scale):
        within = f"within {scale.sigma:.1%}; " if math.isfinite(scale.sigma) else ""
        return undetermined("rate_scale", "gyro: scale", within + FULL_TURN)
    too_large = abs(scale.value) > max(ERRORS.scale, CLEAR * scale.sigma)
    evidence = f"{scale.value:+.1%} ± {scale.sigma:.1%}"
    # Motors and iron that change the field during one turn look like a scale error.
    remedy = (
        "check again: stand still, turn a full circle on the spot, away from iron, and stand "
        f"still. If the field again turns by so much {'less' if scale.value > 0.0 else 'more'} "
        f"than the gyro shows, multiply the gyro's rates by {factor / (1.0 + scale.value):.4g} in "
        "the driver"
    )
    return ok_or_warning("rate_scale", "gyro: scale", evidence, remedy * too_large)


def _bias(bias: FloatArray, off: float, factor: float) -> Finding:
    evidence = f"{vector_in_words(np.degrees(bias))} ± {math.degrees(off):.2f} °/s"
    as_published = ", ".join(f"{value / factor:.4g}" for value in bias)
    remedy = (
        "let the driver measure the gyro's bias while the robot stands, or subtract "
        f"({as_published}) from its rates"
    )
    too_large = float(np.linalg.norm(bias)) > max(ERRORS.bias, CLEAR * off)
    return ok_or_warning("gyro_bias", "gyro: bias", evidence, remedy * too_large)
