"""Whether the gyro's numbers are rad/s, by how fast the field turns."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from magcal_ros.core.geometry.attitude import STANDARD_GRAVITY
from magcal_ros.core.samples.stretch import Stretch

DEGREE = math.pi / 180.0

KNOWN: tuple[tuple[float, str], ...] = (
    (DEGREE, "degrees/s published as rad/s"),
    (1.0 / DEGREE, "rad/s converted from degrees twice"),
    (DEGREE / STANDARD_GRAVITY, "rates converted to degrees and multiplied by gravity"),
    (1.0 / STANDARD_GRAVITY, "rates multiplied by gravity, as accelerations are"),
)
"""What makes rad/s of rates that people have published, and how it comes to be."""


@dataclass(frozen=True)
class RateUnitTuning:
    """When the gyro is taken to count in another unit."""

    plain: float = 5.0
    """Times too large or too small from which no scale error can be meant."""
    span: float = 0.5
    """Seconds over which field and gyro are compared."""
    moved: float = 0.15
    """Share of its size by which the field must move in that time to take part."""
    below: float = 8.0
    above: float = 2.2
    """Times by which a known factor may be below and above the rough one: short arcs and noise make
    that too large."""


TUNING = RateUnitTuning()


def rate_factors(stretch: Stretch) -> tuple[float, ...] | None:
    """Return what may make rad/s of the gyro's rates, 1 or a known slip; None if they are rad/s.

    The way that the field goes in half a second is its size times the angle; the size is that of
    the field's changing part, which is right within a factor two for a quarter turn or more. A
    field that changes from place to place goes farther than the gyro turns, and is no slip.
    """
    seconds = np.concatenate([[0.0], np.cumsum(stretch.seconds)])
    angle = np.concatenate([np.zeros((1, 3)), np.cumsum(stretch.turn, axis=0)])
    last = np.searchsorted(seconds, seconds + TUNING.span)
    first = np.flatnonzero(last < len(seconds))
    last = last[first]
    way = np.linalg.norm(stretch.field[last] - stretch.field[first], axis=1)
    turned = np.linalg.norm(angle[last] - angle[first], axis=1)
    moved = way > max(TUNING.moved, 0.5 * float(np.max(way, initial=0.0)))
    if moved.sum() < 3:
        return None
    rough = float(np.median(way[moved])) / max(float(np.median(turned[moved])), 1e-12)
    if 1.0 / TUNING.plain < rough < TUNING.plain:
        return None
    known = (1.0, *(factor for factor, _ in KNOWN))
    return tuple(f for f in known if rough / TUNING.below < f < rough * TUNING.above)


def factor_in_words(factor: float) -> str:
    """Say what a factor of `rate_factors` means, and what to do."""
    size = (
        f"{1.0 / factor:.3g} times too large" if factor < 1.0 else f"{factor:.3g} times too small"
    )
    known = dict(KNOWN)[factor]
    return (
        f"the gyro's rates are {size}, which looks like {known}; multiply them by {factor:.6g} in "
        "the driver"
    )
