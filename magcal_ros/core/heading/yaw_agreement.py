"""Whether several yaws agree, which of them is wrong, and how much their sigmas are too small."""

from __future__ import annotations

import math
from typing import NamedTuple

from magcal_ros.core.geometry.attitude import wrapped
from magcal_ros.core.geometry.vec3 import Triple

SMALLEST_VARIANCE = 1e-10
"""rad². Smallest variance that is believed."""


class CompassYaw(NamedTuple):
    """The yaw of one magnetometer at a moment."""

    number: int  # which it is
    field: Triple  # in the body axes of the moment, tesla
    ahead: float  # its yaw less that of the origin common to all, radians
    variance: float  # of its yaw, rad²


def believed(yaws: list[CompassYaw], known: float, gate: float) -> list[CompassYaw]:
    """Return the yaws without those that are wrong.

    One is left out if the others and the origin agree far better without it, and far better than
    without any other.

    `known` is the variance of the origin's yaw, rad², infinite if it is unknown; `gate` are the
    squared sigmas that count as far.
    """
    kept = yaws
    while len(kept) > 1 and misfit(kept) > gate:
        rests = [kept[:k] + kept[k + 1 :] for k in range(len(kept))]
        rests.sort(key=lambda rest: misfit(rest, known))
        best, second = (misfit(rest, known) for rest in rests[:2])
        if min(misfit(kept, known), second) - best <= gate:
            break
        kept = rests[0]
    return kept


def misfit(yaws: list[CompassYaw], known: float = math.inf) -> float:
    """Return the squared sigmas by which the yaws miss the one that suits them best.

    `known` is as of `believed`.
    """
    first = yaws[0].ahead if math.isinf(known) else 0.0
    whole, moment, square = 1.0 / max(known, SMALLEST_VARIANCE), 0.0, 0.0
    for each in yaws:
        ahead, weight = wrapped(each.ahead - first), 1.0 / each.variance
        whole += weight
        moment += weight * ahead
        square += weight * ahead * ahead
    return square - moment * moment / whole


def excess_variance(yaws: list[CompassYaw]) -> float:
    """Return the variance that each must have beside its own for all to agree, rad².

    The estimate of DerSimonian and Laird for the variance between the studies of a meta-analysis.
    """
    weights = [1.0 / each.variance for each in yaws]
    spread = sum(weights) - sum(weight**2 for weight in weights) / sum(weights)
    if spread <= 0.0:
        return 0.0
    return max(0.0, misfit(yaws) - (len(yaws) - 1)) / spread
