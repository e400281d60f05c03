"""How far a measured change follows a predicted one."""

from __future__ import annotations

import math


class Slope:
    """Slope of measurements over predictions, by least squares through the origin.

    `memory` is the time over which evidence is kept, seconds. `predicted` is the sum of the squared
    predictions.
    """

    def __init__(self, memory: float) -> None:
        self._memory = memory
        self._together = self.predicted = self._measured = self._count = 0.0

    def add(
        self,
        product: float,
        predicted: float,
        measured: float,
        seconds: float = 0.0,
        count: float = 1.0,
    ) -> None:
        """Add the sums of products and squares of `count` measurements, `seconds` later."""
        keeps = math.exp(-seconds / self._memory)
        self._together = keeps * self._together + product
        self.predicted = keeps * self.predicted + predicted
        self._measured = keeps * self._measured + measured
        self._count = keeps * self._count + count

    @property
    def estimate(self) -> tuple[float, float]:
        """The slope and its sigma, which is infinite without evidence."""
        if self.predicted <= 0.0:
            return 0.0, math.inf
        slope = self._together / self.predicted
        left = max(0.0, self._measured - slope * self._together)
        return slope, math.sqrt(left / max(self._count - 1.0, 1.0) / self.predicted)

    def bounds(self, sigmas: float) -> tuple[float, float]:
        """Return the slope minus and plus some sigmas of it; infinite without evidence."""
        slope, sigma = self.estimate
        return slope - sigmas * sigma, slope + sigmas * sigma

    @property
    def log_odds(self) -> float:
        """Log likelihood ratio of a slope of one against a slope of zero."""
        slope, sigma = self.estimate
        return (slope - 0.5) / max(sigma, 1e-6) ** 2
