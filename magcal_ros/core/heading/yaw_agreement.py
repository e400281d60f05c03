"""Whether several yaws agree, who of them is wrong, and what they say of each other's sigma."""

from __future__ import annotations

import math
from typing import NamedTuple

from magcal_ros.core.geometry.attitude import wrapped
from magcal_ros.core.geometry.vec3 import Triple

SMALLEST_VARIANCE = 1e-10
"""rad². What claims to be exact is not."""


class Witness(NamedTuple):
    """What one magnetometer says of a moment.

    Parameters
    ----------
    number : int
        Which it is.
    field : tuple of float
        In the body axes of the moment, tesla.
    ahead : float
        Its yaw less that of the origin common to all, radians.
    variance : float
        Of its yaw, rad².
    """

    number: int
    field: Triple
    ahead: float
    variance: float


def believed(witnesses: list[Witness], known: float, gate: float) -> list[Witness]:
    """Return the witnesses without those that are wrong.

    One is left out if the others and the origin agree far better without it, and far better than
    without any other.

    Parameters
    ----------
    witnesses : list of Witness
    known : float
        Variance of the origin's yaw, rad²; infinite if it tells nothing.
    gate : float
        Squared sigmas that count as far.
    """
    kept = witnesses
    while len(kept) > 1 and misfit(kept) > gate:
        rests = [kept[:k] + kept[k + 1 :] for k in range(len(kept))]
        rests.sort(key=lambda rest: misfit(rest, known))
        best, second = (misfit(rest, known) for rest in rests[:2])
        if min(misfit(kept, known), second) - best <= gate:
            break
        kept = rests[0]
    return kept


def misfit(witnesses: list[Witness], known: float = math.inf) -> float:
    """Return the squared sigmas by which witnesses miss the yaw that suits them best.

    `known` is as of `believed`.
    """
    first = witnesses[0].ahead if math.isinf(known) else 0.0
    whole, moment, square = 1.0 / max(known, SMALLEST_VARIANCE), 0.0, 0.0
    for each in witnesses:
        ahead, weight = wrapped(each.ahead - first), 1.0 / each.variance
        whole += weight
        moment += weight * ahead
        square += weight * ahead * ahead
    return square - moment * moment / whole


def excess_variance(witnesses: list[Witness]) -> float:
    """Return the variance that each must have beside its own for all to agree, rad².

    The estimate of DerSimonian and Laird for the variance between the studies of a meta-analysis.
    """
    weights = [1.0 / each.variance for each in witnesses]
    spread = sum(weights) - sum(weight**2 for weight in weights) / sum(weights)
    if spread <= 0.0:
        return 0.0
    return max(0.0, misfit(witnesses) - (len(witnesses) - 1)) / spread
