"""What streets do to a compass: a field of iron that changes with the place, not with time."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from magcal_ros.core.geometry.arrays import FloatArray
from magcal_ros.core.samples.streams import FieldSample, ImuSample
from magcal_ros.core.simulation.ride import Ride

FREEDOM = 5.0
"""Degrees of freedom of Student's distribution: streets have heavy tails."""
SMALL_IRON = 0.3
"""Share of the variance that changes within `SMALL_REACH` metres."""
SMALL_REACH = 2.0
FORWARD: FloatArray = np.array([1.0, 0.0, 0.0])
LEFT: FloatArray = np.array([0.0, 1.0, 0.0])


class Street:
    """A random field along a way.

    Parameters
    ----------
    rng : numpy.random.Generator
        Source of chance.
    size : float
        Tesla per axis, standard deviation.
    reach : float
        Metres over which it is alike (e to the minus one).

    Attributes
    ----------
    disturbance : ndarray, shape (3,)
        Tesla in ENU at the place of the moment.
    """

    def __init__(self, rng: np.random.Generator, size: float = 3e-6, reach: float = 30.0) -> None:
        self._rng = rng
        sizes = math.sqrt(1.0 - SMALL_IRON) * size, math.sqrt(SMALL_IRON) * size
        self._parts = [(sizes[0], reach), (sizes[1], SMALL_REACH)]
        self._fields = [own * rng.standard_normal(3) for own in sizes]
        self.disturbance = self._fields[0] + self._fields[1]

    def go(self, metres: float) -> FloatArray:
        """Go on by so many metres; returns the disturbance there."""
        for index, (size, reach) in enumerate(self._parts):
            keeps = math.exp(-abs(metres) / reach)
            kick = self._rng.standard_t(FREEDOM, 3) * math.sqrt(1.0 - 2.0 / FREEDOM)
            self._fields[index] = keeps * self._fields[index]
            self._fields[index] = self._fields[index] + size * math.sqrt(1.0 - keeps**2) * kick
        self.disturbance = self._fields[0] + self._fields[1]
        return self.disturbance


def city_drive(
    ride: Ride, street: Street, seconds: float, rng: np.random.Generator
) -> Iterator[list[ImuSample | FieldSample]]:
    """Drive a car through streets: stand, speed up, roll, bend, brake.

    Parameters
    ----------
    ride : Ride
        The car, level.
    street : Street
        What bends its field.
    seconds : float
        How long, at least.
    rng : numpy.random.Generator
        Source of chance.

    Yields
    ------
    list of ImuSample or FieldSample
        What the sensors say in each step.
    """
    begun, speed = ride.stamp, 0.0
    while ride.stamp - begun < seconds:
        cruise = rng.uniform(6.0, 13.0)
        bend = rng.choice([-1.0, 1.0]) * rng.uniform(0.2, 0.45)
        legs = (
            (rng.uniform(3.0, 12.0), 0.0, 0.0),
            (cruise / 1.5, 1.5, 0.0),
            (rng.uniform(5.0, 25.0), 0.0, 0.0),
            ((cruise - 4.0) / 1.5, -1.5, 0.0),
            (rng.uniform(0.7, 1.7) / abs(bend), 0.0, bend),
            (4.0 / 1.5, -1.5, 0.0),
        )
        for duration, forward, rate in legs:
            for _ in range(int(duration / ride.period)):
                speed = max(0.0, speed + forward * ride.period)
                shake = 0.2 * rng.standard_normal(3) if speed else 0.0
                pull = forward * FORWARD + speed * rate * LEFT + shake
                bent = street.go(speed * ride.period) if speed else street.disturbance
                yield ride.step(rate, acceleration=pull, disturbance=bent)
        speed = 0.0
