"""Whether the hard iron that follows from the reference field makes the reference doubtful.

The hard iron along a turn's axis is what is left of the field there after the reference's part.
So an inclination of the wrong sign looks like a magnet of twice that part, and nothing else in the
turn contradicts it. A robot may carry such a magnet, so a person has to decide.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from magcal_ros.core.assessment.grading import Aspect, Check, Grade, shown
from magcal_ros.core.calibration.estimate import Estimate
from magcal_ros.core.calibration.figure import Figure
from magcal_ros.core.knowledge import Knowledge


@dataclass(frozen=True)
class DoubtTuning:
    """When a hard iron along the axis makes the reference doubtful."""

    noticeable: float = 0.4
    """Strengths of the field; a smaller one is what robots have, whatever the other sign says."""
    several: float = 3.0
    """Times that it must be larger than with the other sign of the inclination."""
    field: float = 1.0
    """Strengths of the field from which it is doubtful in any case."""
    shown: float = 10.0
    """Sigmas by which the wobble of the turn must contradict the other sign to exclude it."""


TUNING = DoubtTuning()


def check_reference(
    estimate: Estimate, figures: Mapping[Figure, float], knowledge: Knowledge
) -> Check | None:
    """Check the hard iron along the turn's axis; None if more than the reference shows it."""
    if not knowledge.reference.is_complete or _is_shown(estimate, figures):
        return None
    axial_field = -estimate.strength * math.sin(estimate.inclination)
    correction = estimate.correction
    axial = float(estimate.axis @ correction.matrix @ correction.hard_iron)
    own, other = abs(axial), abs(axial + 2.0 * axial_field)
    words = f"hard iron along the turn's axis, by the reference field, {_microtesla(own)}"
    found = Grade.EXCELLENT
    if own > TUNING.noticeable * estimate.strength and own > TUNING.several * other:
        found = Grade.WARN
        words += (
            f", but {_microtesla(other)} if the inclination had the other sign: check the sign of "
            "reference.inclination_deg (positive where the field points down, as in the north), or "
            "turn on ramps; of a simulator, whether it publishes the field in north-east-down axes "
            "(NED; Gazebo: use_earth_frame_ned false)"
        )
    elif own > TUNING.field * estimate.strength:
        found = Grade.WARN
        words += (
            f", more than the field itself ({_microtesla(estimate.strength)}): check "
            "reference.strength_ut and inclination_deg, or turn on ramps"
        )
    return Check(Figure.AXIAL_IRON, Aspect.CONFIDENCE, found, words)


def _is_shown(estimate: Estimate, figures: Mapping[Figure, float]) -> bool:
    """Whether the samples alone would contradict the other sign."""
    if Figure.INSTALLATION_YAW_SIGMA in figures or Figure.SPHERE_EXTENT in figures:
        return True
    wobble, count = figures.get(Figure.WOBBLE, 0.0), np.count_nonzero(estimate.inliers)
    axial_field = estimate.strength * math.sin(abs(estimate.inclination))
    noise = math.hypot(estimate.noise_field, axial_field * estimate.noise_up)
    swing = 2.0 * axial_field * wobble * math.sqrt(2.0 * count)
    return swing > TUNING.shown * noise


def _microtesla(value: float) -> str:
    return f"{shown(value * 1e6)} µT"


def level_field_sigma(knowledge: Knowledge) -> float:
    """Return the relative standard deviation of the reference's level field; 0 if unknown."""
    strength, dip = knowledge.reference.strength, knowledge.reference.inclination
    if strength.is_unknown or dip.is_unknown:
        return 0.0
    return math.hypot(
        strength.sigma / (abs(strength.value) or 1.0), math.tan(dip.value) * dip.sigma
    )
