"""The assumptions about drives, by subject: each number with its unit and its reason.

The values suit cars and ground robots.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum


class SpeedSource(str, Enum):
    """Sources of the speed, the best first."""

    ODOMETRY = "odometry"
    VELOCITY = "velocity"
    FIXES = "fixes"


@dataclass(frozen=True)
class SpeedTuning:
    """How speeds are read."""

    largest: float = 100.0  # m/s, no vehicle this is for is faster
    largest_acceleration: float = 15.0  # m/s², a speed that changes faster is no speed
    step: float = 0.5  # m/s by which it may change besides: noise, and the steps of an encoder
    receiver_gap: float = 2.2
    """Seconds between two samples that are interpolated between, and after which another source
    takes the place of one that is silent."""
    seldom: float = 0.3
    """Seconds between samples from which wheels count as a receiver; half of those bridged."""
    receiver_delay: float = 0.5
    """Seconds by which a receiver's stamps are late, until it is measured; .4 to .8 were seen."""
    remembered: int = 6000  # samples kept of a source: ten minutes of ten a second
    shortest: float = 0.045
    """Seconds between samples that are read, and half of those that are kept for minutes; of a
    faster source the others are passed over."""
    newest: int = 512  # samples that are examined for their speed now and for jumps


@dataclass(frozen=True)
class OwnAccelerationTuning:
    """When and how the vehicle's own acceleration is subtracted, and which way it goes."""

    seconds: float = 0.25  # of messages that make a tick: short against a start or a bend
    levelling: float = 60.0
    """Seconds over which the accelerometer levels the gyro's frame: long against starts."""
    steepest: float = 0.05  # sine of x to the upright, below which a body has no heading
    spans: Mapping[SpeedSource, int] = field(
        default_factory=lambda: dict(zip(SpeedSource, (2, 4, 8), strict=True))
    )
    """Ticks over which a change of speed is taken: long against noise, as a receiver averages."""
    slow: Mapping[SpeedSource, float] = field(
        default_factory=lambda: dict(zip(SpeedSource, (0.05, 0.3, 0.6), strict=True))
    )
    """m/s below which a source may be standing."""
    oldest: float = 4.5
    """Seconds by which a matched tick may be late, as up is propagated by the gyro over them; and
    for which nothing is subtracted once it could not be."""
    latest: float = 2.5  # seconds by which a speed may be late to be of use
    watched: int = 60  # ticks over which it is tested whether the speed explains the force: 15 s
    fewest: int = 12  # of them before anything is subtracted
    gain: float = 0.4  # what remains of the force's variance where the speed explains it, at most
    along: float = 0.25
    """Share of the changes of velocity that must be starts and stops, where speed is from fixes."""
    quiet: float = 0.3  # m/s², scatter of the force below which nothing is to be explained
    correlated: float = 4.0  # by how much errors of the force last longer than the smoothing
    standing: float = 0.5  # m/s of a speed that has no sign; a receiver's wanders
    crawling: float = 1.5
    """m/s below which it may have stood, unseen by a receiver that measures once a second."""
    longest: float = 40.0  # seconds since standing that are examined


@dataclass(frozen=True)
class MountingYawTuning:
    """The yaw of the IMU in the vehicle from force against speed."""

    remembered: int = 2400  # ticks that are fitted: ten minutes of driving
    smooth: int = 4  # ticks of the low-pass, one second: latency and vibration
    highpass: int = 80
    """Ticks of the running mean that is subtracted, 20 s: slopes and the accelerometer's bias."""
    moving: float = 0.15  # m/s, slower is standing
    block: float = 10.0  # seconds of a block whose errors count as one
    lever_sigma: float = 1.0  # metres from the rear axle where the IMU may be
    scale: float = 0.2
    rough_scale: float = 0.6
    """By how much the force over the speed's change may differ from one, and how far below it may
    be for a receiver, whose noise makes it less: else the speed's unit or stamps are wrong."""
    energy: float = 25.0  # m²/s³ of changes of velocity that must have been seen: two starts
    first_energy: float = 4.0
    """The same before the yaw is used, and of the force while a speed is stuck: half a start."""
    believed: float = math.radians(6.0)  # radians of sigma below which it is used so
    explained: float = 0.4  # share of the force's changes that the speed must explain
    floor: float = math.radians(0.3)  # radians that no drive removes: springs, tyres
    largest_delay: float = 8.0  # seconds of latency that are tried, and an eighth of them early
    reuse: float = 8.0  # seconds between fits
    wild: float = 0.02  # share of samples that jump as no vehicle can
    recent: int = 240  # ticks of the newest minute, over which a speed must hold as well
    stuck: int = 48
    """Newest ticks, 12 s, over which a speed that never changes is examined by itself."""
    rounds: int = 6  # reweighted fits, also of a course: the weights have settled


@dataclass(frozen=True)
class CourseTuning:
    """Straight stretches of road, whether their course is a heading, and the compass against it."""

    shortest: float = 5.0
    longest: float = 4.0
    """Metres and seconds between the fixes of a chord."""
    largest_sigma: float = math.radians(12.0)
    """Radians of a course, beyond which it is left out, as that of a receiver that stands."""
    largest_rate: float = math.radians(3.0)
    largest_turn: float = math.radians(5.0)
    """rad/s throughout, and radians in all: in bends lever arm, slip and latency show."""
    relative_sigma: float = 0.3
    """Metres of error between neighbouring fixes; not the fix's absolute accuracy."""
    remembered: int = 200  # ticks kept for chords that end late
    span: float = 60.0
    chords: int = 8
    """Seconds of straight driving that are examined, and the fewest chords in them."""
    scatter: float = math.radians(10.0)
    """Radians by which course less gyro yaw may scatter within them; boats exceed it."""
    bias: float = math.radians(0.3)  # rad/s of the gyro's bias that the compass does not show
    turned: float = math.radians(5.0)
    """Radians, RMS, that it must have turned by to show whether its course followed."""
    share: float = 0.5
    """Of its turns that the course leaves out: none of a vehicle's on wheels, all of a hull's."""
    cell: float = 10.0
    """Metres of a cell's side at first; twice as long whenever there are too many."""
    sectors: int = 8  # sectors of course in a cell
    most_cells: int = 400  # cells kept
    reach: float = 30.0  # metres over which streets disturb the field alike
    wave_sigma: float = math.radians(3.0)
    """Radians of the harmonics: hard iron and soft iron that a calibration leaves."""
    noise: float = math.radians(2.2)
    """Radians of compass less course beside streets and fixes: slip, camber, lanes, the compass."""
    street: float = math.radians(7.0)
    street_weight: float = 4.0
    """Radians by which a street turns the compass, and pseudo-observations of it."""
    freedom: float = 5.0  # degrees of freedom of Student's weights
    swing_share: float = 0.5
    """Share of a swing that is in the offset's sigma: its cause may have come or gone."""
    fewest: int = 5  # cells before the first fit


SPEED, OWN = SpeedTuning(), OwnAccelerationTuning()
MOUNTING, COURSE = MountingYawTuning(), CourseTuning()
