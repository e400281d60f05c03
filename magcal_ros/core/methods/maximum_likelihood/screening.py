"""What cannot carry a calibration is refused before any number is used."""

from __future__ import annotations

import math

import numpy as np

from magcal_ros.core.errors import Reason, Refusal
from magcal_ros.core.estimation.block import TurnBlock
from magcal_ros.core.geometry.arrays import FloatArray
from magcal_ros.core.geometry.rotations import turns_about_z
from magcal_ros.core.knowledge import Knowledge
from magcal_ros.core.methods.checks import (
    SCREENING,
    check_agreement,
    check_arc,
    check_radius,
    check_rival,
)
from magcal_ros.core.samples.coverage import Coverage


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


def _check_circle(block: TurnBlock, *, is_known: bool) -> None:
    shared = block.place.state.shared
    radius = float(np.linalg.norm(np.cross(shared.world_axis[:, 2], shared.field_enu)))
    if is_known or radius < SCREENING.smallest_alone:
        check_radius(radius / abs(shared.strength), shared.inclination)
