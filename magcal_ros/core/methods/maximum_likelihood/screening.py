"""What cannot carry a calibration is refused before any number is believed."""

from __future__ import annotations

import math

import numpy as np

from magcal_ros.core.arrays import BoolArray, FloatArray
from magcal_ros.core.errors import Reason, Refusal
from magcal_ros.core.knowledge import Knowledge
from magcal_ros.core.methods.checks import refuse_nonsense
from magcal_ros.core.methods.maximum_likelihood.circle import plane_normal
from magcal_ros.core.methods.maximum_likelihood.model import State
from magcal_ros.core.methods.maximum_likelihood.prepare import without_spikes
from magcal_ros.core.methods.maximum_likelihood.refine import Solution
from magcal_ros.core.window import Window

FEWEST_SAMPLES = 20
WEAKEST_FORCE = 1.0
"""m/s²; an accelerometer at rest reads 9.81."""
WEAKEST_FIELD = 1e-9
"""Tesla; the Earth's field is 20 to 70 millionths."""
LEAST_MOTION = 2.5
"""The raw field must move by this many times its own noise."""
SMALLEST_MOTION = 0.005
"""Spread of the field, or of the force, over its own size."""
LEAST_ARC = math.radians(45.0)
LEAST_ARC_ALONE = math.radians(90.0)
"""Without a known field or a gyro."""
ARC_TOLERANCE = math.radians(1.5)
SMALLEST_RADIUS = 0.15
STEEPEST = math.radians(80.0)
WORST_FIELD_NOISE = 0.15
WORST_WOBBLE = math.radians(30.0)
FEWEST_BELIEVED = 0.4
WIDEST_RIVAL = math.radians(5.0)
WORST_STRAY = math.radians(20.0)


def check_window(window: Window, knowledge: Knowledge) -> None:
    """Refuse what no fit can help.

    Raises
    ------
    Refusal
        `TOO_FEW_SAMPLES`, `GRAVITY_ABSENT`, `FIELD_ABSENT`, `FIELD_TOO_STEEP`, `NO_MOTION` or
        `AXIS_ALONG_FIELD`.
    """
    refuse_nonsense(window)
    n = len(window)
    if n < FEWEST_SAMPLES:
        raise Refusal(
            Reason.TOO_FEW_SAMPLES,
            f"{n} samples are too few for a calibration; collect at least {FEWEST_SAMPLES},"
            " better 500, over one turn",
        )
    if float(np.median(np.linalg.norm(window.specific_force, axis=1))) < WEAKEST_FORCE:
        raise Refusal(
            Reason.GRAVITY_ABSENT,
            "the accelerometer shows no gravity; publish specific force with gravity included",
        )
    if float(np.median(np.linalg.norm(window.field, axis=1))) < WEAKEST_FIELD:
        raise Refusal(Reason.FIELD_ABSENT, "the magnetometer reads zero; check that it is running")
    dip = knowledge.reference.inclination
    if not dip.is_unknown and abs(dip.value) > STEEPEST:
        raise _too_steep(dip.value)
    _check_motion(window)


def _check_motion(window: Window) -> None:
    if visible_motion(window.field):
        return
    if visible_motion(window.specific_force):
        raise Refusal(
            Reason.AXIS_ALONG_FIELD,
            "the robot turned but its field did not change: the axis lies along the field; turn"
            " about another axis",
        )
    raise Refusal(
        Reason.NO_MOTION,
        "the field did not change, so the robot did not turn; turn it once about its upright axis",
    )


def visible_motion(values: FloatArray) -> bool:
    """Return whether vectors (n, 3) spread by more than their sample-to-sample noise."""
    clean = values[without_spikes(values)]
    if len(clean) < FEWEST_SAMPLES // 2:
        clean = values
    noise = float(np.median(np.abs(np.diff(clean, axis=0)))) / 0.954
    spread = math.sqrt(max(float(plane_normal(clean)[1][-1]), 0.0))
    size = float(np.median(np.linalg.norm(clean, axis=1)))
    return spread > max(SMALLEST_MOTION * size, LEAST_MOTION * noise)


def seen_arc(state: State, believed: BoolArray) -> float:
    """Return how much of the circle the believed samples cover, radians up to a full turn.

    The turn minus its largest hole; a hole of a few samples' spacing is none.
    """
    attitude = state.attitude[believed]
    angle = np.arctan2(attitude[:, 1, 0] - attitude[:, 0, 1], attitude[:, 0, 0] + attitude[:, 1, 1])
    if len(angle) < 2:
        return 0.0
    ordered = np.sort(np.mod(angle, 2.0 * math.pi))
    holes = np.append(np.diff(ordered), ordered[0] + 2.0 * math.pi - ordered[-1])
    largest = float(holes.max())
    usual = (2.0 * math.pi - largest) / (len(ordered) - 1)
    return 2.0 * math.pi if largest < 4.0 * usual else 2.0 * math.pi - largest


def check_solution(
    solution: Solution, knowledge: Knowledge, arc: float, rival_gap: float, *, gyro: bool
) -> None:
    """Refuse a fit that explains the samples only in appearance.

    Raises
    ------
    Refusal
        `FIELD_NOT_ON_A_PLANE`, `FIELD_TOO_STEEP`, `AXIS_ALONG_FIELD`, `CIRCLE_TOO_SMALL`,
        `ARC_TOO_SHORT` or `AMBIGUOUS`.
    """
    _check_agreement(solution)
    _check_circle(solution)
    _check_arc(arc, solved_by_knowledge=knowledge.reference.is_complete or gyro)
    if rival_gap > WIDEST_RIVAL:
        raise Refusal(
            Reason.AMBIGUOUS,
            f"two calibrations explain this turn equally well and differ by"
            f" {math.degrees(rival_gap):.0f} degrees of heading; turn a full circle, on level"
            " ground or with the known field given",
        )


def check_gyro(stray: float) -> None:
    """Refuse a compass that the gyro contradicts; `stray` is their difference, radians RMS.

    Raises
    ------
    Refusal
        `AXES_DISAGREE`.
    """
    if stray > WORST_STRAY:
        raise Refusal(
            Reason.AXES_DISAGREE,
            f"gyro and compass differ by {math.degrees(stray):.0f} degrees over the turn; check"
            " that the axes of both sensors belong together, and turn away from iron",
        )


def _check_agreement(solution: Solution) -> None:
    noise = solution.problem.noise
    believed = float(solution.believed.mean())
    strength = abs(solution.state.shared.strength)
    wobble = 0.0 if solution.problem.rigid else noise.wobble
    if (
        noise.field > WORST_FIELD_NOISE * strength
        or wobble > WORST_WOBBLE
        or believed < FEWEST_BELIEVED
    ):
        raise Refusal(
            Reason.FIELD_NOT_ON_A_PLANE,
            "the field does not follow one turn of the robot"
            f" ({believed:.0%} of the samples fit, the rest of the field is"
            f" {noise.field / max(strength, 1e-9):.0%}); turn about one axis, away from iron and"
            " running motors",
        )


def _check_circle(solution: Solution) -> None:
    shared = solution.state.shared
    if abs(shared.inclination) > STEEPEST:
        raise _too_steep(shared.inclination)
    axis = shared.world_axis[:, 2]
    across = float(np.linalg.norm(np.cross(axis, shared.field_enu))) / abs(shared.strength)
    if across >= SMALLEST_RADIUS:
        return
    if math.cos(shared.inclination) > 2.0 * SMALLEST_RADIUS:
        raise Refusal(
            Reason.AXIS_ALONG_FIELD,
            "the robot turned about an axis along the field, which shows nothing of the heading;"
            " turn about an upright axis",
        )
    raise Refusal(
        Reason.CIRCLE_TOO_SMALL,
        f"the field drew a circle of only {across:.0%} of its strength; turn about an axis further"
        " away from the field, or check the field's strength",
    )


def _check_arc(arc: float, *, solved_by_knowledge: bool) -> None:
    least = LEAST_ARC if solved_by_knowledge else LEAST_ARC_ALONE
    if arc >= least - ARC_TOLERANCE:
        return
    remedy = (
        "turn further, at best a full circle"
        if arc < LEAST_ARC
        else "turn further, or give the field's strength and inclination, or use a gyro"
    )
    raise Refusal(
        Reason.ARC_TOO_SHORT,
        f"the robot turned by {math.degrees(arc):.0f} degrees, which is too little; {remedy}",
    )


def _too_steep(inclination: float) -> Refusal:
    return Refusal(
        Reason.FIELD_TOO_STEEP,
        f"at an inclination of {math.degrees(inclination):.0f} degrees too little of the field is"
        " level for a compass; use another source of heading here",
    )
