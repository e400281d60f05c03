"""A rest that shaking hides: an engine runs, and only means over seconds stay what they are.

From block to block such a robot moves as much as one under way. Over seconds its force, its turn
rate and the field stay, which they do for nobody who starts, stops, turns or passes steel.
"""

from __future__ import annotations

from collections import deque
from typing import NamedTuple

from magcal_ros.core.geometry.vec3 import Triple, between, distance, length
from magcal_ros.core.up.steady import ZERO, BlockMeans
from magcal_ros.core.up.up_tuning import ShakenRestTuning

Means = tuple[Triple, Triple, Triple]


class ShownAtRest(NamedTuple):
    """What a rest has shown: force (g), and rate (rad/s) with its variance per axis."""

    force: Triple
    rate: Triple
    variance: float


class ShakenRest:
    """Averages blocks, and tells the gyro's bias once the means have stayed for some seconds.

    Parameters
    ----------
    tuning : ShakenRestTuning
        What is taken for granted.
    """

    def __init__(self, tuning: ShakenRestTuning) -> None:
        self._tuning = tuning
        self._means: deque[Means] = deque(maxlen=tuning.spans)
        self._begin()

    def _begin(self) -> None:
        self._seconds, self._count = 0.0, 0
        self._sums: Means = (ZERO, ZERO, ZERO)

    def forget(self) -> None:
        """Begin anew: the field came no more, or time has jumped."""
        self._means.clear()
        self._begin()

    def add(self, block: BlockMeans, field: Triple) -> ShownAtRest | None:
        """Take a block and the raw field at its end, in any unit; None while nothing is shown."""
        self._count += 1
        self._seconds += block.seconds
        force, rate, mean = self._sums
        share = 1.0 / self._count
        self._sums = (
            between(force, block.force, share),
            between(rate, block.rate, share),
            between(mean, field, share),
        )
        if self._seconds < self._tuning.span:
            return None
        self._means.append(self._sums)
        self._begin()
        return self._told()

    def _told(self) -> ShownAtRest | None:
        tuning, means = self._tuning, self._means
        if len(means) < tuning.spans:
            return None
        force, rate, field = (_mean([each[k] for each in means]) for k in range(3))
        bounds = (tuning.force, tuning.rate, tuning.field * length(field))
        for each in means:
            gaps = (distance(each[0], force), distance(each[1], rate), distance(each[2], field))
            if any(gap > bound for gap, bound in zip(gaps, bounds, strict=True)):
                return None
        scatter = sum(distance(each[1], rate) ** 2 for each in means) / (3.0 * (len(means) - 1))
        # The next one is of other seconds.
        means.clear()
        return ShownAtRest(force, rate, tuning.sigma**2 + scatter / tuning.spans)


def _mean(vectors: list[Triple]) -> Triple:
    x, y, z = (sum(axis) / len(vectors) for axis in zip(*vectors, strict=True))
    return (float(x), float(y), float(z))
