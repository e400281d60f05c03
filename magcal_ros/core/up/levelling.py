"""Up without a gyro: the accelerometer, smoothed, and a word on how far it may be wrong."""

from __future__ import annotations

import math

from magcal_ros.core.geometry.vec3 import Triple, between, distance, length, unit_triple
from magcal_ros.core.up.up_tuning import LevellingTuning


class Levelling:
    """Smooths the direction of the specific force.

    Parameters
    ----------
    force : tuple of float
        First reading of the accelerometer, over gravity; not zero.
    tuning : LevellingTuning, optional
        What is taken for granted.

    Attributes
    ----------
    up : tuple of float
        Unit vector, body axes.
    """

    def __init__(self, force: Triple, tuning: LevellingTuning | None = None) -> None:
        self._tuning = tuning or LevellingTuning()
        self.up = unit_triple(force)
        self._mean = self.up
        self._scatter = 0.0
        self._size = self._rest = length(force)
        self._seconds = 0.0

    def add(self, force: Triple, seconds: float) -> None:
        """Take the next reading, so many seconds after the one before."""
        seen = unit_triple(force)
        up = between(self.up, seen, 1.0 - math.exp(-seconds / self._tuning.smoothing))
        self.up = unit_triple(up) if length(up) > 0.0 else seen
        self._seconds += seconds
        memory = 1.0 - math.exp(-seconds / self._tuning.memory)
        self._mean = between(self._mean, self.up, memory)
        away = distance(self.up, self._mean)
        self._scatter += memory * (0.5 * away * away - self._scatter)
        size = length(force)
        self._size += memory * (size - self._size)
        self._rest += (
            seconds / min(self._seconds + seconds, self._tuning.rest_memory) * (size - self._rest)
        )

    @property
    def variance(self) -> float:
        """Variance of up in either direction, rad².

        Up that scatters is not known better than that, and an acceleration of p g across up
        stretches the accelerometer by p²/2.
        """
        stretch = max(0.0, abs(self._size / self._rest - 1.0) - self._tuning.length_floor)
        return self._tuning.floor**2 + self._scatter + stretch
