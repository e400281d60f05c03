"""The unit of the gyro's rates, by how fast the field turns."""

from __future__ import annotations

import math

import numpy as np

from magcal_ros.core.doctor.axes_hypotheses import turns_in
from magcal_ros.core.doctor.doctor_tuning import AXES
from magcal_ros.core.doctor.segment import Segment
from magcal_ros.core.geometry.arrays import FloatArray
from magcal_ros.core.geometry.attitude import STANDARD_GRAVITY

UNIT_ERRORS: tuple[tuple[float, str], ...] = (
    (math.radians(1.0), "degrees/s published as rad/s"),
    (math.degrees(1.0), "rad/s converted from degrees twice"),
    (math.radians(1.0) / STANDARD_GRAVITY, "rates converted to degrees and multiplied by gravity"),
    (1.0 / STANDARD_GRAVITY, "rates multiplied by gravity, as accelerations are"),
)
"""Factors to rad/s for known errors of the unit, and their causes."""
FEWEST_SPANS = 3  # smallest number of spans that determine the unit


def rate_factors(segment: Segment) -> tuple[float, ...] | None:
    """Return which of 1 and the known factors may convert rates to rad/s; None if they are rad/s.

    In a short time, the field vector moves by its size times the angle. The size is that of the
    field's changing part, which is right within a factor of two from a quarter turn on. The factor
    is 1 if neither gyro nor field determines the unit.
    """
    for rough in (_by_the_gyro(segment), _by_the_field(segment)):
        if rough is None:
            continue
        if 1.0 / AXES.unit_ratio < rough < AXES.unit_ratio:
            return None
        known = (1.0, *(factor for factor, _ in UNIT_ERRORS))
        near = tuple(f for f in known if rough / AXES.below < f < rough * AXES.above)
        if near:
            return near
    return (1.0,)


def _by_the_gyro(segment: Segment) -> float | None:
    """Return the field's movement over the gyro's angle, in the spans with the largest angles.

    The movement by magnetic objects along a road is measured in spans without a turn.
    """
    change, turned = _changes(segment, AXES.span)
    most = float(np.max(turned, initial=0.0))
    quick, slow = turned > 0.5 * most, turned < 0.1 * most
    if quick.sum() < FEWEST_SPANS:
        return None
    street = float(np.median(change[slow])) if slow.sum() >= FEWEST_SPANS else 0.0
    by_turning = float(np.median(change[quick])) ** 2 - street**2
    return math.sqrt(by_turning) / float(np.median(turned[quick])) if by_turning > 0.0 else None


def _by_the_field(segment: Segment) -> float | None:
    """Return this ratio in the spans with the largest movements of the field; None without any.

    A field that varies from place to place moves farther than by the turn: the unit is not wrong.
    """
    for span in AXES.span * 2.0 ** np.arange(4):
        change, turned = _changes(segment, span)
        moved = change > max(AXES.moved, 0.5 * float(np.max(change, initial=0.0)))
        if moved.sum() >= FEWEST_SPANS:
            usual = float(np.median(turned[moved]))
            return float(np.median(change[moved])) / max(usual, 1e-12)
    return None


def _changes(segment: Segment, span: float) -> tuple[FloatArray, FloatArray]:
    """Return the change of the field, over its size, and the gyro's angle in spans of seconds."""
    first, last, turn = turns_in(segment, span)
    change = np.linalg.norm(segment.field[last] - segment.field[first], axis=1)
    return change, np.linalg.norm(turn, axis=1)
