"""Legs of a drive: traffic lights, bends, ramps, parking, one street repeatedly."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np


class Leg(NamedTuple):
    """A piece of a drive.

    `speed` (m/s, negative backwards) and `pitch` (radians, positive uphill) are what they are at
    its end, changing evenly; `curvature` (1/m, positive to the left) and `turn_rate` (rad/s, on
    top, of robots that turn in place) hold throughout.
    """

    seconds: float
    speed: float = 0.0
    curvature: float = 0.0
    turn_rate: float = 0.0
    pitch: float = 0.0


def seconds_of(legs: list[Leg]) -> float:
    """Return the total duration of the legs."""
    return sum(leg.seconds for leg in legs)


def standing(seconds: float) -> list[Leg]:
    """Stand."""
    return [Leg(seconds)]


def city(
    rng: np.random.Generator, seconds: float, *, fastest: float = 13.0, ramps: float = 0.2
) -> list[Leg]:
    """Drive through a city: stand at lights, speed up, roll, slow down, bend, brake.

    Parameters
    ----------
    rng : numpy.random.Generator
        Source of chance.
    seconds : float
        How long, at least.
    fastest : float
        m/s between crossings; a robot at walking pace has 1.2.
    ramps : float
        Share of the straights that climb or fall by up to 5°.
    """
    legs = standing(5.0)
    while seconds_of(legs) < seconds:
        legs += _block(rng, fastest, ramps)
    return legs


def _block(rng: np.random.Generator, fastest: float, ramps: float) -> list[Leg]:
    """From one light to the next, with a bend at its end."""
    pace = fastest / 13.0
    cruise, slow = pace * rng.uniform(6.0, 13.0), pace * 4.0
    gain, brake = rng.uniform(0.8, 2.0, 2)
    angle = rng.choice([-1.0, 1.0]) * rng.uniform(0.5, 1.7)
    radius = rng.uniform(8.0, 20.0) * max(pace, 0.1)
    pitch = math.radians(rng.uniform(-5.0, 5.0)) if rng.random() < ramps else 0.0
    legs = [Leg(rng.uniform(3.0, 12.0))] if rng.random() < 0.7 else []
    legs += [
        Leg(cruise / gain, cruise),
        Leg(rng.uniform(3.0, 10.0), cruise, pitch=pitch),
        Leg(rng.uniform(3.0, 12.0), cruise, rng.normal(0.0, 0.002) / max(pace, 0.1), pitch=pitch),
        Leg((cruise - slow) / brake, slow),
        Leg(abs(angle) * radius / slow, slow, math.copysign(1.0 / radius, angle)),
    ]
    if rng.random() < 0.6:
        legs.append(Leg(slow / brake))
    return legs


def parking(rng: np.random.Generator) -> list[Leg]:
    """Stop, reverse into a gap with two opposite bends, and pull out of it again."""
    side = rng.choice([-1.0, 1.0])
    there = [
        Leg(2.0),
        Leg(2.0, -1.2, 0.15 * side),
        Leg(2.5, -1.2, 0.15 * side),
        Leg(2.5, -1.2, -0.15 * side),
        Leg(1.5, 0.0, -0.15 * side),
        Leg(3.0),
    ]
    out = [Leg(1.5, 1.5, -0.15 * side), Leg(3.0, 1.5, 0.12 * side), Leg(1.5)]
    return there + out


def reversing(rng: np.random.Generator, trips: int, share: float = 0.5) -> list[Leg]:
    """Trips from standing to standing, some of them backwards, straight and through bends."""
    legs = standing(3.0)
    for _ in range(trips):
        sign = -1.0 if rng.random() < share else 1.0
        speed, gain = sign * rng.uniform(1.5, 5.0), rng.uniform(0.6, 1.5)
        curvature = float(rng.choice([0.0, 0.05, -0.05]))
        legs += [
            Leg(abs(speed) / gain, speed),
            Leg(rng.uniform(3.0, 10.0), speed),
            Leg(rng.uniform(3.0, 8.0), speed, curvature),
            Leg(abs(speed) / gain),
            Leg(rng.uniform(2.0, 6.0)),
        ]
    return legs


def one_street(
    times: int, length: float = 200.0, speed: float = 8.0, *, back: bool = True
) -> list[Leg]:
    """Drive one street again and again: there and back with a narrow turn at each end.

    Parameters
    ----------
    times : int
        How often it is driven.
    length : float
        Metres.
    speed : float
        m/s.
    back : bool
        Whether each second time goes the other way; otherwise the vehicle backs up for it.
    """
    legs = standing(5.0)
    gain, radius = 1.5, 6.0
    rolling = max(0.0, length - speed**2 / gain) / speed
    for time in range(times):
        way = 1.0 if back or time % 2 == 0 else -1.0
        legs += [Leg(speed / gain, way * speed), Leg(rolling, way * speed), Leg(speed / gain)]
        legs += [Leg(2.0)]
        if back:
            legs += [Leg(2.0, 3.0), Leg(math.pi * radius / 3.0 - 1.0, 3.0, 1.0 / radius)]
            legs += [Leg(2.0, 0.0, 1.0 / radius), Leg(1.0)]
    return legs


def circles(seconds: float, speed: float = 3.0, radius: float = 8.0) -> list[Leg]:
    """Speed up, then circle evenly."""
    return [Leg(3.0), Leg(2.0, speed), Leg(seconds, speed, 1.0 / radius)]


def motorway(rng: np.random.Generator, seconds: float, speed: float = 28.0) -> list[Leg]:
    """Speed up once, then roll on with wide bends."""
    legs = [Leg(5.0), Leg(speed / 1.5, speed)]
    while seconds_of(legs) < seconds:
        legs.append(Leg(rng.uniform(10.0, 30.0), speed + rng.normal(), rng.normal(0.0, 5e-4)))
    return legs


def joined(*parts: list[Leg]) -> list[Leg]:
    """Return the legs of several parts, one after the other."""
    return list(_all(parts))


def _all(parts: tuple[list[Leg], ...]) -> Iterator[Leg]:
    for part in parts:
        yield from part
