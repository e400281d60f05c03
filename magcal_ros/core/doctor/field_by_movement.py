"""Unit, strength and inclination of the field by a movement, and the field of the motors."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from magcal_ros.core.assessment.grading import Grade, axial_field_variance, is_likelier
from magcal_ros.core.doctor.alignment import FIELD, IRON, UP
from magcal_ros.core.doctor.axes_diagnosis import LIFT, NOSE
from magcal_ros.core.doctor.axes_hypotheses import AxesHypothesis
from magcal_ros.core.doctor.doctor_tuning import ERRORS
from magcal_ros.core.doctor.finding import Finding, is_vague, ok_or_warning, undetermined
from magcal_ros.core.doctor.health import WRONG_UNIT
from magcal_ros.core.doctor.motion import MotionResult
from magcal_ros.core.doctor.quirks import FIELD_POINTS_UP
from magcal_ros.core.doctor.turn_errors import FULL_TURN, MOTORS, motors_finding
from magcal_ros.core.doctor.turn_fit import TurnFit
from magcal_ros.core.geometry.attitude import unit
from magcal_ros.core.knowledge import CLEAR, Belief, Knowledge
from magcal_ros.core.samples.units import unit_by_strength

UNIT_FIRST = "correct the field's unit first, then check again"
AGAINST_REFERENCE = "field: strength, inclination"
MOTORS_OFF = "by hand with the motors off (their field hides it)"
HIDDEN, BY_HAND = f"turn once {MOTORS_OFF}", f"{NOSE} {MOTORS_OFF}"
"""The movements to ask for, in place of `FULL_TURN` and `LIFT`, if motors change the field."""


def is_vague_strength(strength: Belief) -> bool:
    """Return whether the movement does not determine this strength."""
    return is_vague(strength.sigma, ERRORS.strength * strength.value)


def strength_of(hypothesis: AxesHypothesis) -> Belief:
    """Return the strength without hard iron, as published, by one hypothesis."""
    size, sigma = (np.linalg.norm(each[FIELD]) for each in (hypothesis.state, hypothesis.sigma))
    return Belief(float(size), float(sigma))


def strength_of_level(hypothesis: AxesHypothesis, knowledge: Knowledge) -> Belief:
    """Return the strength by the known inclination and the level field, as for a level turn."""
    dip = knowledge.reference.inclination
    vector, up = hypothesis.state[FIELD], unit(hypothesis.state[UP])
    level = vector - float(vector @ up) * up
    share = math.cos(dip.value)
    if dip.is_unknown or share <= 0.0 or not level.any():
        return Belief.unknown()
    strength = float(np.linalg.norm(level)) / share
    off = float(np.linalg.norm(hypothesis.sigma[FIELD] * unit(level))) / share
    return Belief(strength, math.hypot(off, strength * math.tan(dip.value) * dip.sigma))


def with_field(
    lines: list[Finding],
    found: MotionResult,
    hypothesis: AxesHypothesis,
    knowledge: Knowledge,
    turn: TurnFit | None,
) -> list[Finding]:
    """Return the lines with findings on the field, by the hypothesis that explains the movement."""
    if any(line.key == WRONG_UNIT and line.is_wrong for line in lines):
        return [
            *_unit_by_strength(lines, hypothesis, knowledge),
            undetermined("reference", AGAINST_REFERENCE, UNIT_FIRST),
            undetermined("motors", MOTORS, UNIT_FIRST),
        ]
    lines = [*lines, reference_finding(hypothesis, knowledge, found.up_is_down)]
    if found.prepared.restamped:
        return lines
    shown = any(f.key == "latency" and f.grade is not Grade.GOOD for f in lines)
    motors = motors_finding(turn, hypothesis, shown)
    if motors.is_wrong:
        # Another turn with the motors on would not determine these quantities either.
        texts = [f.evidence.replace(FULL_TURN, HIDDEN).replace(LIFT, BY_HAND) for f in lines]
        lines = [replace(f, evidence=each) for f, each in zip(lines, texts, strict=True)]
    return [*lines, motors]


def _unit_by_strength(
    lines: list[Finding], hypothesis: AxesHypothesis, knowledge: Knowledge
) -> list[Finding]:
    """Return the lines, with the unit identified by the strength if the movement determines it."""
    strength = strength_of(hypothesis)
    if is_vague_strength(strength):
        strength = strength_of_level(hypothesis, knowledge)
    hint = "" if is_vague_strength(strength) else unit_by_strength(strength.value, strength.sigma)
    if not hint:
        return lines
    size = f"{strength.value:.3g} ± {strength.sigma:.2g} T as published, without hard iron"
    return [
        replace(line, evidence=size, remedy=hint) if line.key == WRONG_UNIT else line
        for line in lines
    ]


def reference_finding(
    hypothesis: AxesHypothesis, knowledge: Knowledge, up_is_down: bool | None
) -> Finding:
    """Compare strength and inclination by one hypothesis with the reference."""
    vector = hypothesis.state[FIELD]
    up = hypothesis.state[UP] * (-1.0 if up_is_down else 1.0)
    whole = strength_of(hypothesis)
    strength, off = whole.value, whole.sigma
    if is_vague_strength(whole):
        upwards = None if up_is_down is not False else _points_up(hypothesis, knowledge)
        return upwards or undetermined("reference", AGAINST_REFERENCE, LIFT)
    along = float(vector @ up / np.linalg.norm(vector) / np.linalg.norm(up))
    dip = -math.asin(max(-1.0, min(1.0, along)))
    iron = float(np.linalg.norm(hypothesis.state[IRON]))
    evidence = (
        f"{strength * 1e6:.1f} ± {off * 1e6:.1f} µT without the hard iron of {iron * 1e6:.0f} µT, "
        f"inclination {math.degrees(dip):.0f}°"
    )
    known = knowledge.reference
    wrong = []
    if not known.strength.is_unknown:
        spread = math.hypot(off, known.strength.sigma)
        apart = abs(strength - known.strength.value)
        if apart > max(ERRORS.strength * known.strength.value, CLEAR * spread):
            wrong.append(f"{known.strength.value * 1e6:.1f} µT")
    if not known.inclination.is_unknown and up_is_down is not None:
        spread = math.hypot(off / strength, known.inclination.sigma)
        limit = max(ERRORS.inclination, CLEAR * spread)
        if abs(dip - known.inclination.value) > limit:
            if abs(dip + known.inclination.value) <= limit:
                return ok_or_warning(
                    "inclination_sign", AGAINST_REFERENCE, evidence, FIELD_POINTS_UP
                )
            wrong.append(f"an inclination of {math.degrees(known.inclination.value):.0f}°")
    remedy = (
        f"the reference field has {' and '.join(wrong)}: turn farther away from iron and walls. If "
        "the difference is the same everywhere, the magnetometer's scale or unit is wrong"
    )
    return ok_or_warning("reference", AGAINST_REFERENCE, evidence, remedy * bool(wrong))


def _points_up(hypothesis: AxesHypothesis, knowledge: Knowledge) -> Finding | None:
    """Return a finding that the field points up, if this needs much less hard iron; else None."""
    known = knowledge.reference
    if not (hypothesis.is_as_given and known.is_complete):
        return None
    up = unit(hypothesis.state[UP])
    field, iron = (hypothesis.state[part] for part in (FIELD, IRON))
    field_off, iron_off = (hypothesis.sigma[part] for part in (FIELD, IRON))
    along = -known.strength.value * math.sin(known.inclination.value)
    # The movement may show the sign. What the reference is off by must not look as if it did.
    variance = float(field_off**2 @ up**2) + axial_field_variance(knowledge)
    if 4.0 * float(up @ field) * along > CLEAR**2 * variance:
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
    return ok_or_warning("inclination_sign", AGAINST_REFERENCE, evidence, remedy)
