"""What the smoother's fit of a turn shows: the gyro's bias and scale, latencies, motors."""

from __future__ import annotations

import math

import numpy as np

from magcal_ros.core.doctor.alignment import FIELD, UP
from magcal_ros.core.doctor.axes_hypotheses import AxesHypothesis
from magcal_ros.core.doctor.doctor_tuning import AXES, ERRORS
from magcal_ros.core.doctor.finding import (
    Finding,
    is_vague,
    is_wrong,
    ok_or_warning,
    undetermined,
    vector_in_words,
)
from magcal_ros.core.doctor.motion import MotionResult
from magcal_ros.core.doctor.turn_fit import TurnFit, force_latency
from magcal_ros.core.geometry.arrays import FloatArray
from magcal_ros.core.geometry.attitude import unit
from magcal_ros.core.knowledge import Belief
from magcal_ros.core.samples.rest import LongestRest

FULL_TURN = "stand still, then turn a full circle"
NO_BURSTS = "the stamps must not come in bursts"
FIELD_LAG = 2.0 * AXES.settled
"""Seconds, the error for `is_vague` of the field's latency. Its sigma is the smoother's, which is
right even if a movement shows little; that of the accelerometer's latency is too small then."""
STARTS = "start and stop while you turn, at 20 °/s or more"
LEANS = "lift the nose by 20° within a second or two, or drive over a kerb"
AXES_FIRST = "correct the axes as described above, then check again"
TURN_BETWEEN_RESTS = (
    "if motors turn the robot, their current adds a field. Calibrate by a turn that begins and "
    "ends at rest: it measures this field, and the node subtracts it while the robot moves"
)
MOVE_THE_SENSOR = (
    "if motors turn the robot, their current adds a field, too large to be subtracted well. Move "
    "the sensor away from motors, motor drivers and battery wires, and twist each pair of wires"
)
"""Remedies if the field changes when the robot starts to turn."""
OR_LATE = (
    ". Late stamps of the field look the same: to tell them apart, start and stop several times "
    "while you turn"
)
MOTORS = "field: motors"
BETWEEN_RESTS = "stand still, turn, and stand still again"
ON_THE_SPOT = (
    "the robot drove while it turned, and the field differs from place to place; stand still, "
    "turn on the spot, and stand still again"
)


def findings_by_turn(
    found: MotionResult, hypothesis: AxesHypothesis | None, turn: TurnFit | None
) -> list[Finding]:
    """Return the findings on errors of the gyro and on latencies; `turn` is None without a fit."""
    if hypothesis is None:
        return [
            bias_finding(found.rest, found.factor, found.missing),
            undetermined("rate_scale", "gyro: scale", found.missing),
            undetermined("latency", "field: latency", found.missing),
        ]
    # Each of several possible corrections of the axes would give other errors.
    is_clear = not any(each.key == "axes" and each.is_wrong for each in found.findings)
    known, why = (turn, FULL_TURN) if is_clear else (None, AXES_FIRST)
    # In the gyro's own axes, so that the driver can subtract it.
    by_turn = (np.zeros(3), math.inf)
    if known is not None:
        by_turn = (hypothesis.gyro @ known.bias, known.bias_sigma)
    bias = bias_finding(found.rest, found.factor, why, by_turn)
    if found.prepared.restamped:
        why = NO_BURSTS if is_clear else why
        latency = undetermined("latency", "field: latency", NO_BURSTS)
        return [bias, _scale(None, found.factor, why), latency]
    scale = _scale(None if known is None else known.scale, found.factor, why)
    of_field = Belief.unknown() if turn is None else turn.latency
    return [bias, scale, *_latencies(of_field, force_latency(hypothesis))]


def bias_finding(
    rest: LongestRest | None,
    factor: float,
    shown_by: str,
    by_turn: tuple[FloatArray, float] = (np.zeros(3), math.inf),
) -> Finding:
    """Return the finding on the gyro's bias, by a rest or by a turn, whichever is more certain.

    `factor` converts the gyro's numbers to rad/s. `by_turn` is the bias and its sigma, rad/s.
    """
    bias, off = by_turn
    if rest is not None and factor * rest.sigma < off:
        bias, off = factor * rest.rate, factor * rest.sigma
    if is_vague(off, ERRORS.bias):
        return undetermined("gyro_bias", "gyro: bias", shown_by)
    evidence = f"{vector_in_words(np.degrees(bias))} ± {math.degrees(off):.2f} °/s"
    as_published = ", ".join(f"{value / factor:.4g}" for value in bias)
    remedy = (
        "let the driver measure the gyro's bias while the robot stands, or subtract "
        f"({as_published}) from its rates"
    )
    too_large = is_wrong(Belief(float(np.linalg.norm(bias)), off), ERRORS.bias)
    return ok_or_warning("gyro_bias", "gyro: bias", evidence, remedy * too_large)


def _scale(scale: Belief | None, factor: float, shown_by: str) -> Finding:
    """Return the finding on the gyro's scale; `shown_by` is what would show it without a fit."""
    if scale is None:
        return undetermined("rate_scale", "gyro: scale", shown_by)
    if is_vague(scale.sigma, ERRORS.scale):
        within = f"within {scale.sigma:.1%}; " if math.isfinite(scale.sigma) else ""
        return undetermined("rate_scale", "gyro: scale", within + FULL_TURN)
    evidence = f"{scale.value:+.1%} ± {scale.sigma:.1%}"
    # Motors and iron that change the field during one turn look like a scale error.
    remedy = (
        "check again: stand still, turn a full circle on the spot, away from iron, and stand "
        f"still. If the field again turns by so much {'less' if scale.value > 0.0 else 'more'} "
        f"than the gyro shows, multiply the gyro's rates by {factor / (1.0 + scale.value):.4g} in "
        "the driver"
    )
    return ok_or_warning(
        "rate_scale", "gyro: scale", evidence, remedy * is_wrong(scale, ERRORS.scale)
    )


def _latencies(field: Belief, force: Belief) -> list[Finding]:
    """Return the findings on both sensors' latencies; if they are equal, the gyro is early."""
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
        _latency("latency", "field", field, FIELD_LAG, STARTS, of_field),
        _latency("force_latency", "accelerometer", force, ERRORS.lag, LEANS, of_force),
    ]


def _wrong_by(latency: Belief, error: float) -> float:
    """Return a latency in seconds; zero if it is too small or too uncertain to be reported."""
    is_shown = not is_vague(latency.sigma, error)
    return latency.value if is_shown and is_wrong(latency, ERRORS.lag) else 0.0


def _latency(
    key: str, sensor: str, latency: Belief, error: float, shown_by: str, remedy: str
) -> Finding:
    if is_vague(latency.sigma, error):
        return undetermined(key, f"{sensor}: latency", shown_by)
    lag, off = round(latency.value * 1e3), latency.sigma * 1e3
    how = f"{abs(lag)} ± {off:.0f} ms {'early' if lag < 0 else 'late'} against the gyro"
    return ok_or_warning(key, f"{sensor}: latency", how, remedy)


def motors_finding(turn: TurnFit | None, hypothesis: AxesHypothesis, lag_is_shown: bool) -> Finding:
    """Check for a field that exists only while the robot turns; a late field looks the same."""
    if turn is not None and turn.drove:
        return undetermined("motors", MOTORS, ON_THE_SPOT)
    if turn is None or turn.motors is None:
        return undetermined("motors", MOTORS, BETWEEN_RESTS)
    off, strength = turn.motors_sigma, float(np.linalg.norm(turn.motors))
    is_seen = is_wrong(Belief(strength, off), ERRORS.motors)
    if off > ERRORS.motors and not is_seen:
        return undetermined("motors", MOTORS, f"within {off * 1e6:.1f} µT; {BETWEEN_RESTS}")
    field, up = hypothesis.state[FIELD], unit(hypothesis.state[UP])
    turned = math.atan2(strength, float(np.linalg.norm(np.cross(field, up))))
    words = ", ".join(f"{value * 1e6:+.1f}" for value in turn.motors)
    evidence = (
        f"({words}) ± {off * 1e6:.1f} µT while the robot turns: up to {math.degrees(turned):.0f}° "
        "of heading"
    )
    if strength <= ERRORS.motors:
        evidence = f"{strength * 1e6:.1f} ± {off * 1e6:.1f} µT while the robot turns"
    remedy = MOVE_THE_SENSOR if turned > ERRORS.turned_too_far else TURN_BETWEEN_RESTS
    remedy += "" if lag_is_shown else OR_LATE
    return ok_or_warning("motors", MOTORS, evidence, remedy * is_seen)
