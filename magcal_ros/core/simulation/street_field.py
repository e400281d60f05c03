"""What streets do to a compass: a field of iron that changes with the place, not with time."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.special import ndtr, stdtrit

from magcal_ros.core.geometry.arrays import FloatArray, interpolated


@dataclass(frozen=True)
class Streets:
    """How much the iron of streets bends the field.

    Parameters
    ----------
    size : float
        Tesla per axis, standard deviation: 2.5 to 5 µT in cities.
    reach : float
        Metres over which it is alike (e to the minus one).
    small_share, small_reach : float
        Share of the variance that changes within so many metres: covers, parked cars.
    freedom : float
        Degrees of freedom of Student's distribution: streets have heavy tails.
    waves : int
        Plane waves per reach that the field is made of.
    spacing : float
        Metres of way between the places where the waves are summed.
    """

    size: float = 3e-6
    reach: float = 30.0
    small_share: float = 0.3
    small_reach: float = 2.0
    freedom: float = 4.0
    waves: int = 200
    spacing: float = 0.5


class StreetField:
    """A random field over places: the same street bends the field in the same way again.

    Each axis is Gaussian with the covariance exp(-distance/reach), which in the plane is a sum of
    waves whose wave vectors are Student-distributed with one degree of freedom (random Fourier
    features; Rahimi and Recht, 2007). Its marginal is turned into Student's distribution.

    Parameters
    ----------
    streets : Streets
        How much it bends.
    rng : numpy.random.Generator
        Source of chance.
    """

    def __init__(self, streets: Streets, rng: np.random.Generator) -> None:
        self.streets = streets
        share = streets.small_share
        self._parts = [
            (math.sqrt(weight), *_waves(reach, streets.waves, rng))
            for weight, reach in ((1.0 - share, streets.reach), (share, streets.small_reach))
        ]

    def at(self, places: FloatArray) -> FloatArray:
        """Return the disturbance at places (n, 2) in metres: tesla in ENU, shape (n, 3)."""
        total = np.zeros((len(places), 3))
        for weight, waves, amplitudes in self._parts:
            phase = places @ waves.T
            total += weight * np.hstack([np.cos(phase), np.sin(phase)]) @ amplitudes
        freedom = self.streets.freedom
        heavy = stdtrit(freedom, np.clip(ndtr(total), 1e-6, 1.0 - 1e-6))
        return np.asarray(self.streets.size * math.sqrt(1.0 - 2.0 / freedom) * heavy)

    def along(self, places: FloatArray) -> FloatArray:
        """Return the same along a way of dense places (n, 2), shape (n, 3).

        It is summed once each `spacing` metres of way and interpolated between.
        """
        steps = np.hypot(*np.diff(places, axis=0).T)
        metres = np.r_[0.0, np.cumsum(steps)]
        marks = np.arange(0.0, metres[-1] + self.streets.spacing, self.streets.spacing)
        field = self.at(interpolated(marks, metres, places))
        return interpolated(metres, marks, field)


def _waves(reach: float, count: int, rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
    """Return wave vectors (count, 2) in rad/m and amplitudes (2 count, 3) of a unit field."""
    vectors = rng.standard_normal((count, 2)) / np.abs(rng.standard_normal((count, 1))) / reach
    return vectors, rng.standard_normal((2 * count, 3)) / math.sqrt(count)
