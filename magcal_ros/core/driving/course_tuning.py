"""The assumptions about the compass against course."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class ChordTuning:
    """Which stretches of road are straight enough for a course."""

    shortest: float = 5.0
    """Metres."""
    longest: float = 4.0
    """Seconds."""
    slowest: float = 2.0
    """m/s for positions: those of a standing receiver wander."""
    slowest_velocity: float = 0.5
    """m/s where the receiver tells a velocity of a sigma below `good_velocity`."""
    good_velocity: float = 0.1
    """m/s."""
    largest_rate: float = math.radians(3.0)
    largest_turn: float = math.radians(5.0)
    """rad/s throughout, and radians in all: in bends lever arm, slip and latency show."""
    relative_sigma: float = 0.3
    """Metres of error between neighbouring fixes; not the fix's absolute accuracy."""
    course_sigma: float = math.radians(1.0)
    """Radians of any course: slip, camber, lanes."""
    remembered: int = 200
    """Yaws kept, ten a second, for chords that end late."""
    spacing: float = 0.1
    """Seconds between them."""


@dataclass(frozen=True)
class DriftTuning:
    """When a vehicle does not go where it looks."""

    span: float = 60.0
    chords: int = 8
    """Seconds of straight driving that are looked at, and chords in them from which it is told."""
    scatter: float = math.radians(10.0)
    """Radians by which course less gyro yaw may scatter within them; boats exceed it."""
    bias: float = math.radians(0.3)
    """rad/s of the gyro's bias that the compass does not show."""
    turned: float = math.radians(5.0)
    """Radians, RMS, that it must have turned by to tell whether its course followed."""
    share: float = 0.5
    """Of its turns that the course leaves out: none of a vehicle's on wheels, all of a hull's."""


@dataclass(frozen=True)
class CourseTuning:
    """The offset of compass against course, and its harmonics."""

    cell: float = 10.0
    """Metres of a cell's side at first; twice as long whenever there are too many."""
    sectors: int = 8
    """Sectors of course in a cell."""
    most_cells: int = 400
    """Cells kept."""
    reach: float = 30.0
    """Metres over which streets bend alike."""
    small_share: float = 0.25
    small_reach: float = 2.0
    """Share of the bend's variance that is alike over so many metres only; .2 to .4 were seen."""
    first_sigma: float = math.radians(3.0)
    second_sigma: float = math.radians(2.0)
    """Radians of the harmonics: hard iron and soft iron that a calibration leaves."""
    noise: float = math.radians(2.0)
    """Radians of a chord's compass beside streets and course."""
    street: float = math.radians(7.0)
    street_weight: float = 4.0
    """Radians a street bends by, and pseudo-observations of it."""
    freedom: float = 5.0
    """Degrees of freedom of Student's weights."""
    cluster: float = 150.0
    """Metres of a cluster of the sandwich."""
    few_clusters: int = 1
    """Clusters that are taken off their number: a small sample's correction."""
    swing_share: float = 0.5
    """Share of a swing of compass against course that is in the offset's sigma: what swings it may
    have come or gone on the way."""
    fewest: int = 5
    """Cells before anything is said."""
    rounds: int = 5
    """Reweighted ones: weights and the street's size have settled."""
    new_chords: int = 5
    """Chords after which the course is fitted anew."""
    drift: DriftTuning = DriftTuning()
    """When a vehicle does not go where it looks."""
