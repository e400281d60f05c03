"""The assumptions about the compass against course."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class ChordTuning:
    """Which stretches of road are straight enough for a course.

    Parameters
    ----------
    shortest : float
        Metres.
    longest : float
        Seconds.
    slowest : float
        m/s for positions: those of a standing receiver wander.
    slowest_velocity : float
        m/s where the receiver tells a velocity of a sigma below `good_velocity`.
    good_velocity : float
        m/s.
    largest_rate, largest_turn : float
        rad/s throughout, and radians in all: in bends lever arm, slip and latency show.
    relative_sigma : float
        Metres of error between neighbouring fixes; not the fix's absolute accuracy.
    course_sigma : float
        Radians of any course: slip, camber, lanes.
    remembered : int
        Yaws kept, ten a second, for chords that end late.
    spacing : float
        Seconds between them.
    """

    shortest: float = 5.0
    longest: float = 4.0
    slowest: float = 2.0
    slowest_velocity: float = 0.5
    good_velocity: float = 0.1
    largest_rate: float = math.radians(3.0)
    largest_turn: float = math.radians(5.0)
    relative_sigma: float = 0.3
    course_sigma: float = math.radians(1.0)
    remembered: int = 200
    spacing: float = 0.1


@dataclass(frozen=True)
class DriftTuning:
    """When a vehicle does not go where it looks.

    Parameters
    ----------
    span, chords : float, int
        Seconds of straight driving that are looked at, and chords in them from which it is told.
    scatter : float
        Radians by which course less gyro yaw may scatter within them; boats exceed it.
    bias : float
        rad/s of the gyro's bias that the compass does not show.
    turned : float
        Radians, RMS, that it must have turned by to tell whether its course followed.
    share : float
        Of its turns that the course leaves out: none of a vehicle's on wheels, all of a hull's.
    """

    span: float = 60.0
    chords: int = 8
    scatter: float = math.radians(10.0)
    bias: float = math.radians(0.3)
    turned: float = math.radians(5.0)
    share: float = 0.5


@dataclass(frozen=True)
class CourseTuning:
    """The offset of compass against course, and its harmonics.

    Parameters
    ----------
    cell : float
        Metres of a cell's side at first; twice as long whenever there are too many.
    sectors : int
        Sectors of course in a cell.
    most_cells : int
        Cells kept.
    reach : float
        Metres over which streets bend alike.
    small_share, small_reach : float
        Share of the bend's variance that is alike over so many metres only; .2 to .4 were seen.
    first_sigma, second_sigma : float
        Radians of the harmonics: hard iron and soft iron that a calibration leaves.
    noise : float
        Radians of a chord's compass beside streets and course.
    street, street_weight : float
        Radians a street bends by, and pseudo-observations of it.
    freedom : float
        Degrees of freedom of Student's weights.
    cluster : float
        Metres of a cluster of the sandwich.
    few_clusters : int
        Clusters that are taken off their number: a small sample's correction.
    swing_share : float
        Share of a swing of compass against course that is in the offset's sigma: what swings it may
        have come or gone on the way.
    fewest : int
        Cells before anything is said.
    rounds : int
        Reweighted ones: weights and the street's size have settled.
    new_chords : int
        Chords after which the course is fitted anew.
    drift : DriftTuning
        When a vehicle does not go where it looks.
    """

    cell: float = 10.0
    sectors: int = 8
    most_cells: int = 400
    reach: float = 30.0
    small_share: float = 0.25
    small_reach: float = 2.0
    first_sigma: float = math.radians(3.0)
    second_sigma: float = math.radians(2.0)
    noise: float = math.radians(2.0)
    street: float = math.radians(7.0)
    street_weight: float = 4.0
    freedom: float = 5.0
    cluster: float = 150.0
    few_clusters: int = 1
    swing_share: float = 0.5
    fewest: int = 5
    rounds: int = 5
    new_chords: int = 5
    drift: DriftTuning = DriftTuning()
