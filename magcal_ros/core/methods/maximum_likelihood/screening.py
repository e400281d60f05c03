"""What cannot carry a calibration is refused before any number is used."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from magcal_ros.core.errors import Reason, Refusal
from magcal_ros.core.estimation.averaging import without_spikes
from magcal_ros.core.estimation.block import TurnBlock
from magcal_ros.core.geometry.arrays import FloatArray
from magcal_ros.core.geometry.attitude import unit
from magcal_ros.core.geometry.planes import plane_normal
from magcal_ros.core.geometry.rotations import turns_about_z
from magcal_ros.core.knowledge import Knowledge
from magcal_ros.core.methods.checks import refuse_empty
from magcal_ros.core.samples.coverage import Coverage
from magcal_ros.core.samples.window import Window


@dataclass(frozen=True)
class Screening:
    """Bounds beyond which a turn is refused.

    Parameters
    ----------
    fewest_samples : int
    least_motion : float
        The raw field must move by this many times its own noise.
    smallest_motion : float
        Spread of the field, or of the force, over its own size.
    least_arc, least_arc_alone : float
        Radians; the latter without a known field or a gyro.
    full_arc : float
        Radians from which a full circle is not asked for again.
    arc_tolerance : float
        Radians: the ends of an arc are known to no better.
    smallest_radius : float
        Of the circle, over the field's strength: below it the heading drowns in noise.
    smallest_alone : float
        The same in field scales where the reference field is not known: of one turn strength and
        inclination are then a guess, and only the circle is seen.
    steepest : float
        Radians of inclination at which too little of the field is level. Up to there the heading's
        sigma tells what the steepness costs.
    worst_field_noise : float
        Over the field's strength.
    worst_wobble : float
        Radians: such a robot does not turn about an axis.
    fewest_inliers : float
        Share of the samples.
    widest_rival : float
        Radians of heading by which rival solutions may differ.
    worst_deviation : float
        Radians between gyro and compass: no room distorts so much.
    """

    fewest_samples: int = 20
    least_motion: float = 2.5
    smallest_motion: float = 0.005
    least_arc: float = math.radians(45.0)
    least_arc_alone: float = math.radians(90.0)
    full_arc: float = math.radians(300.0)
    arc_tolerance: float = math.radians(1.5)
    smallest_radius: float = 0.1
    smallest_alone: float = 0.05
    steepest: float = math.radians(84.0)
    worst_field_noise: float = 0.15
    worst_wobble: float = math.radians(30.0)
    fewest_inliers: float = 0.4
    widest_rival: float = math.radians(5.0)
    worst_deviation: float = math.radians(20.0)


SCREENING = Screening()


def check_window(window: Window, knowledge: Knowledge) -> None:
    """Refuse what no fit can help.

    Raises
    ------
    Refusal
        As of `refuse_empty`, and `FIELD_TOO_STEEP`, `NO_MOTION` or `AXIS_ALONG_FIELD`.
    """
    refuse_empty(window, SCREENING.fewest_samples)
    dip = knowledge.reference.inclination
    if not dip.is_unknown and abs(dip.value) > SCREENING.steepest:
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
    turned = _turned_by_gyro(window)
    if turned > SCREENING.least_arc:
        raise Refusal(
            Reason.FIELD_TOO_STEEP,
            f"the gyro shows {math.degrees(turned):.0f} degrees of turn in which the field did not "
            "change: it is too steep for a compass here, or the magnetometer does not measure it",
        )
    raise Refusal(
        Reason.NO_MOTION,
        "the field did not change, so the robot did not turn; turn it once about its upright axis",
    )


def _turned_by_gyro(window: Window) -> float:
    """Return how far the gyro says the robot turned, radians; zero without one."""
    if window.angular_rate is None or len(window) < 2:
        return 0.0
    steps = 0.5 * (window.angular_rate[1:] + window.angular_rate[:-1])
    steps = steps * np.diff(window.time)[:, None]
    return float(np.ptp(np.cumsum(steps @ unit(window.specific_force.mean(axis=0)))))


def visible_motion(values: FloatArray) -> bool:
    """Return whether vectors (n, 3) spread by more than their sample-to-sample noise."""
    clean = values[without_spikes(values)]
    if len(clean) < SCREENING.fewest_samples // 2:
        clean = values
    noise = float(np.median(np.abs(np.diff(clean, axis=0)))) / 0.954
    spread = math.sqrt(max(float(plane_normal(clean)[1][-1]), 0.0))
    size = float(np.median(np.linalg.norm(clean, axis=1)))
    return spread > max(SCREENING.smallest_motion * size, SCREENING.least_motion * noise)


def seen_arc(block: TurnBlock) -> float:
    """Return how much of the circle the inliers cover, radians up to a full turn."""
    angles = turns_about_z(block.place.state.attitude[block.weighting.inliers])
    seen = Coverage.of(angles).arc
    if seen == math.tau:
        return seen
    # Where a robot rests, its noisiest headings would add degrees at either end.
    return min(seen, Coverage.of(_without_noise(angles)).arc)


def _without_noise(angles: FloatArray) -> FloatArray:
    """Return angles as means over a twentieth of the samples, with straight lines at the ends."""
    count = (len(angles) // 20) | 1
    if count < 3:
        return angles
    angles = np.unwrap(angles)
    means = np.convolve(angles, np.full(count, 1.0 / count), "valid")
    steps = np.arange(count) - 0.5 * (count - 1)
    first, last = (steps @ part / (steps @ steps) for part in (angles[:count], angles[-count:]))
    return np.concatenate([[means[0] + first * steps[0]], means, [means[-1] + last * steps[-1]]])


def check_solution(
    block: TurnBlock, knowledge: Knowledge, arc: float, rival_gap: float, *, gyro: bool
) -> None:
    """Refuse a fit that explains the samples only in appearance.

    Raises
    ------
    Refusal
        `FIELD_NOT_ON_A_PLANE`, `FIELD_TOO_STEEP`, `AXIS_ALONG_FIELD`, `CIRCLE_TOO_SMALL`,
        `ARC_TOO_SHORT` or `AMBIGUOUS`.
    """
    _check_agreement(block)
    _check_circle(block, is_known=knowledge.reference.is_complete)
    check_arc(arc, solved_by_knowledge=knowledge.reference.is_complete or gyro)
    check_rival(rival_gap, knowledge, arc)


def check_rival(rival_gap: float, knowledge: Knowledge, arc: float) -> None:
    """Refuse a turn that two calibrations explain; `rival_gap` is radians of heading between them.

    Raises
    ------
    Refusal
        `AMBIGUOUS`.
    """
    if rival_gap <= SCREENING.widest_rival:
        return
    raise Refusal(
        Reason.AMBIGUOUS,
        f"two calibrations explain this turn equally well and differ by"
        f" {math.degrees(rival_gap):.0f} degrees of heading; {_other_turn(arc)}"
        f"{'' if knowledge.reference.is_complete else ', or give the reference field'}",
    )


def _other_turn(arc: float) -> str:
    """Say which turn would tell two calibrations apart: another than the one that was made."""
    if arc < SCREENING.full_arc:
        return "turn a full circle on level ground"
    return "turn once more on other ground, more slowly, with the robot upright"


def check_gyro(deviation: float) -> None:
    """Refuse a compass that the gyro contradicts; `deviation` is their difference, radians RMS.

    Raises
    ------
    Refusal
        `AXES_DISAGREE`.
    """
    if deviation > SCREENING.worst_deviation:
        raise Refusal(
            Reason.AXES_DISAGREE,
            f"gyro and compass differ by {math.degrees(deviation):.0f} degrees over the turn; turn "
            "on the spot and away from iron; if they differ there, `magcal doctor` says which errs",
        )


def _check_agreement(block: TurnBlock) -> None:
    noise = block.weighting.noise
    inliers = float(block.weighting.inliers.mean())
    strength = abs(block.place.state.shared.strength)
    check_agreement(noise.field / max(strength, 1e-9), block.wobble, inliers)


def check_agreement(deviation: float, wobble: float, inliers: float) -> None:
    """Refuse a field that follows no turn.

    Parameters
    ----------
    deviation : float
        What the field deviates by, over its strength.
    wobble : float
        Radians.
    inliers : float
        Share of the samples.

    Raises
    ------
    Refusal
        `FIELD_NOT_ON_A_PLANE`.
    """
    causes = []
    if deviation > SCREENING.worst_field_noise:
        causes.append(f"the field deviates by {deviation:.0%} of its strength")
    if wobble > SCREENING.worst_wobble:
        causes.append(f"the turn's axis wobbles by {math.degrees(wobble):.0f} degrees")
    if inliers < SCREENING.fewest_inliers:
        causes.append(f"only {inliers:.0%} of the samples fit")
    if causes:
        raise Refusal(
            Reason.FIELD_NOT_ON_A_PLANE,
            f"the field does not follow one turn of the robot ({', '.join(causes)}); turn about one"
            " axis, away from iron and running motors",
        )


def _check_circle(block: TurnBlock, *, is_known: bool) -> None:
    shared = block.place.state.shared
    radius = float(np.linalg.norm(np.cross(shared.world_axis[:, 2], shared.field_enu)))
    if is_known or radius < SCREENING.smallest_alone:
        check_radius(radius / abs(shared.strength), shared.inclination)


def check_radius(across: float, inclination: float) -> None:
    """Refuse a circle of which too little is level; `across` is its radius over the strength.

    Raises
    ------
    Refusal
        `FIELD_TOO_STEEP`, `AXIS_ALONG_FIELD` or `CIRCLE_TOO_SMALL`.
    """
    if abs(inclination) > SCREENING.steepest:
        raise _too_steep(inclination)
    if across >= SCREENING.smallest_radius:
        return
    if math.cos(inclination) > 2.0 * SCREENING.smallest_radius:
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


def check_arc(arc: float, *, solved_by_knowledge: bool) -> None:
    """Refuse a turn that is too short; `solved_by_knowledge` says that a field or a gyro is known.

    Raises
    ------
    Refusal
        `ARC_TOO_SHORT`.
    """
    least = SCREENING.least_arc if solved_by_knowledge else SCREENING.least_arc_alone
    if arc >= least - SCREENING.arc_tolerance:
        return
    remedy = (
        "turn further, at best a full circle"
        if arc < SCREENING.least_arc
        else "turn further, or give the field's strength and inclination, or use a gyro"
    )
    raise Refusal(
        Reason.ARC_TOO_SHORT,
        f"the robot turned by {math.degrees(arc):.0f} degrees, which is too little; {remedy}",
    )


def _too_steep(inclination: float) -> Refusal:
    # A search may leave the quarter circle in which inclinations are told.
    steep = math.degrees(math.asin(math.sin(inclination)))
    return Refusal(
        Reason.FIELD_TOO_STEEP,
        f"at an inclination of {steep:.0f} degrees too little of the field is"
        " level for a compass; use another source of heading here",
    )
