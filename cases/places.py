"""Places of turns, for `realistic.py`: in the open, next to a piece of steel, indoors.

The magnetometer does not turn on the spot: it sits beside the robot's axis and goes around in a
field that bends from place to place.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from simulated.turns import Motion

from magcal_ros.core.geometry.arrays import FloatArray

PERMEABILITY = 1e-7
"""T·m/A, over four pi."""


@dataclass(frozen=True)
class Place:
    """The steel around a robot.

    Parameters
    ----------
    pieces : tuple of int
        Fewest and most pieces of steel.
    moment, distance : tuple of float
        Smallest and largest, A·m² and metres from the robot's axis on the level.
    """

    pieces: tuple[int, int]
    moment: tuple[float, float]
    distance: tuple[float, float]


PLACES: dict[str, Place | None] = {
    "open": None,
    "near iron": Place((1, 1), (5.0, 60.0), (1.0, 2.5)),
    "indoors": Place((4, 8), (2.0, 20.0), (0.6, 3.0)),
}
"""A car or a pillar adds .3 to 12 µT; desks, radiators and rebar add up to more."""


def added_field(rng: np.random.Generator, motion: Motion, place: Place) -> FloatArray:
    """Return the field of a place at the magnetometer, tesla in body axes, shape (n, 3)."""
    count = int(rng.integers(place.pieces[0], place.pieces[1] + 1))
    side = rng.uniform(0.0, math.tau)
    beside = rng.uniform(0.0, 0.25)
    arm = np.array([beside * math.cos(side), beside * math.sin(side), rng.uniform(0.1, 0.6)])
    way = np.einsum("nji,j->ni", motion.attitude, arm)
    angle, away = rng.uniform(0.0, math.tau, count), rng.uniform(*place.distance, count)
    height = rng.uniform(-0.5, 1.0, count)
    where = np.column_stack([away * np.cos(angle), away * np.sin(angle), height])
    moments = rng.standard_normal((count, 3))
    moments *= rng.uniform(*place.moment, (count, 1)) / np.linalg.norm(moments, axis=1)[:, None]
    bent = sum(_dipole(way - at, moment) for at, moment in zip(where, moments, strict=True))
    return np.asarray(np.einsum("nij,nj->ni", motion.attitude, bent))


def _dipole(away: FloatArray, moment: FloatArray) -> FloatArray:
    distance = np.linalg.norm(away, axis=1)[:, None]
    unit = away / distance
    field = 3.0 * unit * (unit @ moment)[:, None] - moment
    return np.asarray(PERMEABILITY * field / distance**3)
