"""The assumptions about drives, by subject: each number with its unit and its reason."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum
from typing import TypeVar

from magcal_ros.core.geometry.arrays import FloatArray


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


Span = TypeVar("Span", float, FloatArray)


class SpeedSource(str, Enum):
    """Sources of the speed, the best first."""

    ODOMETRY = "odometry"
    VELOCITY = "velocity"
    FIXES = "fixes"


@dataclass(frozen=True)
class SpeedTuning:
    """How speeds are read."""

    largest: float = 100.0
    """m/s. No vehicle this is for is faster."""
    largest_acceleration: float = 15.0
    """m/s². A speed that changes faster is no speed."""
    step: float = 0.5
    """m/s by which it may change besides: noise, and the steps of an encoder."""
    odometry_gap: float = 0.6
    receiver_gap: float = 2.2
    """Seconds between two samples that are interpolated between."""
    seldom: float = 0.3
    """Seconds between samples from which wheels count as a receiver in this."""
    receiver_delay: float = 0.5
    """Seconds by which a receiver's stamps are late, until it is measured; .4 to .8 were seen."""
    remembered: int = 6000
    """Samples kept of a source: ten minutes of ten a second."""
    spacing: float = 0.09
    """Seconds between samples that are kept for minutes."""
    shortest: float = 0.045
    """Seconds between samples that are read; of a faster source the others are passed over."""
    newest: int = 512
    fewest: int = 20
    """Samples that are looked at for their speed now and for jumps; and from which these are
    told."""
    silent: float = 3.0
    """Seconds after which another source takes its place."""

    def largest_change(self, seconds: Span) -> Span:
        """Return by how much a speed may change meanwhile, m/s; beyond it is a jump."""
        return self.largest_acceleration * seconds + self.step


@dataclass(frozen=True)
class TickTuning:
    """How IMU messages are gathered."""

    seconds: float = 0.25
    """Of messages that make a tick: short against a start or a bend."""
    levelling: float = 60.0
    """Seconds over which the frame that the gyro keeps is levelled by the accelerometer; long
    against starts and stops."""
    steepest: float = 0.05
    """A body whose x is closer to upright than this (sine) has no heading."""


@dataclass(frozen=True)
class OwnAccelerationTuning:
    """When and how the vehicle's own acceleration is taken off."""

    spans: Mapping[SpeedSource, int] = field(
        default_factory=lambda: {
            SpeedSource.ODOMETRY: 2,
            SpeedSource.VELOCITY: 4,
            SpeedSource.FIXES: 8,
        }
    )
    """Ticks over which a change of speed is taken: long against the noise of wheels, and as long as
    a receiver averages."""
    slow: Mapping[SpeedSource, float] = field(
        default_factory=lambda: {
            SpeedSource.ODOMETRY: 0.05,
            SpeedSource.VELOCITY: 0.3,
            SpeedSource.FIXES: 0.6,
        }
    )
    """m/s below which a source may be standing."""
    oldest: float = 4.5
    """Seconds by which a matched tick may be late; up is propagated by the gyro over them."""
    pause: float = 5.0
    """Seconds for which nothing is taken off once it could not be."""
    latest: float = 2.5
    """Seconds by which a speed may be late to be of use."""
    watched: int = 60
    """Ticks over which it is tried whether the speed explains the force: 15 s."""
    fewest: int = 12
    """Ticks that must have been tried before anything is taken off."""
    gain: float = 0.3
    rough_gain: float = 0.5
    """What is left of the force's variance where the speed explains it, at most, and where the
    speed is that of mere fixes."""
    pulling: float = 0.25
    """Share of the changes of velocity that must be starts and stops, where the speed is that of
    mere fixes."""
    quiet: float = 0.3
    """m/s². Scatter of the force below which nothing is to be explained."""


@dataclass(frozen=True)
class MountingYawTuning:
    """The yaw of the IMU in the vehicle from force against speed.

    Parameters
    ----------
    remembered : int
        Ticks that are fitted: ten minutes of driving.
    smooth : int
        Ticks of the low-pass, one second: latency and vibration.
    highpass : int
        Ticks of the running mean that is taken off, 20 s: slopes and the accelerometer's bias.
    standing : float
        Seconds of standing after which ticks are no longer kept.
    moving : float
        m/s, slower is standing.
    block : float
        Seconds of a block whose errors are taken as one.
    short : float
        Seconds of driving below which the sigma is widened.
    widening : float
        By this: NEES of such drives is 3 to 8 at one minute, 1 to 3 at two.
    lever_sigma : float
        Metres ahead of the rear axle where the IMU may be.
    lowest, highest : float
        What the force may be of the speed's change: else the speed's unit or stamps are wrong.
    lowest_rough : float
        The same for a receiver, whose noise makes it less.
    energy : float
        m²/s³ of changes of velocity that must have been seen: two starts.
    first_energy : float
        The same before the yaw is used to take the own acceleration off: half a start.
    believed : float
        Radians of sigma below which it is used so.
    explained : float
        Share of the force's changes that the speed must explain.
    floor : float
        Radians that no drive takes away: springs, tyres.
    largest_delay, earliest_delay : float
        Seconds of latency that are tried.
    reuse, reuse_first : float
        Seconds between fits, and in the first minute.
    wild : float
        Share of samples that jump as no vehicle can.
    recent : int
        Ticks of the newest minute, over which a speed must hold as well.
    stuck : int
        Newest ticks, 12 s, over which a speed that never changes is looked at by itself.
    stuck_energy : float
        m²/s³ of the force meanwhile that say that the vehicle moves: more than slopes and hands do.
    stuck_levelling : float
        Seconds over which the force's mean follows slopes meanwhile.
    iterations : int
        Reweighted steps: the weights have settled.
    """

    remembered: int = 2400
    smooth: int = 4
    highpass: int = 80
    standing: float = 10.0
    moving: float = 0.15
    block: float = 10.0
    short: float = 180.0
    widening: float = 1.5
    lever_sigma: float = 1.0
    lowest: float = 0.8
    lowest_rough: float = 0.4
    highest: float = 1.2
    energy: float = 25.0
    first_energy: float = 4.0
    believed: float = math.radians(6.0)
    explained: float = 0.4
    floor: float = math.radians(0.3)
    largest_delay: float = 8.0
    earliest_delay: float = -1.0
    reuse: float = 15.0
    reuse_first: float = 4.0
    wild: float = 0.02
    recent: int = 240
    stuck: int = 48
    stuck_energy: float = 4.0
    stuck_levelling: float = 20.0
    iterations: int = 6


@dataclass(frozen=True)
class TripTuning:
    """Forwards or backwards, from the force."""

    clear: float = 3.0
    """Sigmas that decide."""
    correlated: float = 4.0
    """By how much errors of the force last longer than the smoothing."""
    standing: float = 0.5
    """m/s of a speed that has no sign; a receiver's wanders."""
    crawling: float = 1.5
    """m/s below which it may have stood meanwhile, unseen by a receiver that speaks once a
    second."""
    longest: float = 40.0
    """Seconds since standing that are looked at."""


@dataclass(frozen=True)
class FrontTuning:
    """When a sensor counts as misaligned."""

    clear: float = 3.0
    """Sigmas beyond which compass and accelerations contradict each other."""
    near: float = 2.0
    """Sigmas within which the contradiction is twice the declination."""
    smallest: float = math.radians(3.0)
    """Radians that nobody need hear of."""
    useful: float = math.radians(2.0)
    """Radians of sigma below which an offset may be applied."""
    lost: float = math.radians(10.0)
    """Radians of sigma of course beyond which it is not used."""


@dataclass(frozen=True)
class DrivingTuning:
    """All of them; the defaults suit cars and ground robots."""

    speed: SpeedTuning = field(default_factory=SpeedTuning)
    ticks: TickTuning = field(default_factory=TickTuning)
    own: OwnAccelerationTuning = field(default_factory=OwnAccelerationTuning)
    mounting: MountingYawTuning = field(default_factory=MountingYawTuning)
    trip: TripTuning = field(default_factory=TripTuning)
    chords: ChordTuning = field(default_factory=ChordTuning)
    course: CourseTuning = field(default_factory=CourseTuning)
    front: FrontTuning = field(default_factory=FrontTuning)
