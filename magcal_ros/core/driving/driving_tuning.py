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
    """How samples of speed are used."""

    largest: float = 100.0  # m/s
    largest_acceleration: float = 15.0  # m/s², a faster change is a fault
    step: float = 0.5  # m/s of change in addition, by noise and the steps of an encoder
    receiver_gap: float = 2.2
    """Longest gap of a receiver that is interpolated, seconds; beyond, another source replaces a
    silent one."""
    seldom: float = 0.3
    """Interval from which wheels are treated as a receiver, and half of the longest gap of wheels
    that is interpolated, seconds."""
    receiver_delay: float = 0.5
    """Latency of a receiver's stamps until it is measured, seconds; .4 to .8 were seen."""
    remembered: int = 12000  # samples kept of a source: ten minutes at 20 Hz
    shortest: float = 0.045
    """Shortest interval of samples that are used, seconds; the others are skipped."""
    counted: float = 500.0  # newest samples of which impossible jumps are counted


@dataclass(frozen=True)
class VehicleAccelerationTuning:
    """When the vehicle's acceleration is subtracted, and how the direction of travel is found."""

    seconds: float = 0.25  # duration of a tick: short compared with a start or a curve
    levelling: float = 60.0
    """Seconds over which the accelerometer levels the gyro's frame: long compared with starts."""
    steepest: float = 0.05  # least sine between body x and the vertical for a heading
    spans: Mapping[SpeedSource, int] = field(
        default_factory=lambda: dict(zip(SpeedSource, (2, 4, 8), strict=True))
    )
    """Ticks over which a change of speed is measured; a receiver averages over a second or more."""
    slow: Mapping[SpeedSource, float] = field(
        default_factory=lambda: dict(zip(SpeedSource, (0.05, 0.3, 0.6), strict=True))
    )
    """m/s below which the vehicle may be at rest."""
    oldest: float = 3.5
    """Largest latency of a usable speed, and age of a matched tick, over which the gyro propagates
    up, seconds; also the pause after a time in which nothing could be subtracted."""
    watched: int = 60  # ticks over which it is tested whether the speed explains the force: 15 s
    fewest: int = 12  # of these ticks before anything is subtracted
    gain: float = 0.4  # largest fraction of the force's variance that an adequate speed leaves
    along: float = 0.25
    """Least fraction of the changes of velocity that are starts and stops, for fixes."""
    quiet: float = 0.3  # m/s², scatter of the force that needs no explanation
    correlated: float = 4.0  # factor of the variance, as errors of the force are correlated
    speed_at_rest: float = 0.5  # m/s, of an unsigned speed at rest; that of a receiver drifts
    crawling: float = 1.5
    """m/s below which a vehicle may have stopped between two samples of a receiver."""
    longest: float = 40.0  # seconds for which a chord waits for the direction of travel


@dataclass(frozen=True)
class MountingYawTuning:
    """The yaw of the IMU in the vehicle from force against speed."""

    remembered: int = 2400  # ticks that are fitted: ten minutes of driving
    smooth: int = 4  # ticks of the low-pass, one second: latency and vibration
    highpass: int = 80
    """Ticks of the running mean that is subtracted, 20 s: slopes and the accelerometer's bias."""
    block: float = 10.0  # seconds within which errors count as fully correlated
    lever_sigma: float = 1.0  # prior sigma of the IMU's distance from the rear axle, metres
    scale: float = 0.2
    rough_scale: float = 0.6
    """Largest deviation from one of the force over the change of speed; and the largest below one
    for a receiver, whose noise reduces it. Beyond, the speed's unit or stamps are wrong."""
    energy: float = 25.0  # m²/s³, least changes of velocity for a known yaw: two starts
    first_energy: float = 4.0
    """The same for a usable yaw, and for the force while a speed is stuck: half a start."""
    usable: float = math.radians(6.0)  # largest sigma of a usable yaw, radians
    explained: float = 0.4  # least fraction of the force's changes that the speed explains
    floor: float = math.radians(0.3)  # least sigma, radians: suspension, tyres
    largest_delay: float = 8.0  # largest latency that is tried, seconds; the least is -1/8 of it
    reuse: float = 8.0  # seconds between fits
    outliers: float = 0.02  # largest fraction of samples with impossible jumps
    recent: int = 240  # ticks of the last minute, in which wheels are also tested separately
    stuck: int = 48
    """Newest ticks, 12 s, in which a constant speed is tested separately."""
    rounds: int = 6  # reweighted fits, also of a course


@dataclass(frozen=True)
class CourseTuning:
    """Chords, whether their course is a heading, and the compass against course."""

    shortest: float = 5.0
    longest: float = 4.0
    """Shortest distance, metres, and longest time, seconds, between the fixes of a chord."""
    largest_sigma: float = math.radians(12.0)
    """Largest sigma of a course, radians; that of a receiver at rest is larger."""
    largest_rate: float = math.radians(3.0)
    largest_turn: float = math.radians(5.0)
    """Largest turn rate, rad/s, and turn, radians, of a chord: in curves lever arm, slip and
    latency cause errors."""
    relative_sigma: float = 0.3
    """Relative error of neighbouring fixes, metres; not the absolute accuracy."""
    remembered: int = 200  # ticks kept for chords that end late
    together: float = 10.0  # largest time between chords that are compared for drift, seconds
    on_wheels: float = 2.0  # log of the prior odds of wheels against a drifting hull
    most: int = 400  # newest chords that are kept: a few kilometres
    wave_sigma: float = math.radians(3.0)
    """Prior sigma of the harmonics, radians: residual hard iron and soft iron."""
    noise: float = math.radians(2.2)
    """Noise of compass minus course in addition to streets and fixes, radians: slip, camber, lanes,
    the compass."""
    street: float = math.radians(7.0)
    prior_weight: float = 4.0
    """Prior size of the yaw error by local disturbances, radians, and weight in observations."""
    freedom: float = 5.0  # degrees of freedom of the Student weights
    swing_share: float = 0.5
    """Fraction of a swing in the offset's sigma: its cause may have been present temporarily."""
    fewest: int = 5  # chords before the first fit


SPEED, ACCELERATION = SpeedTuning(), VehicleAccelerationTuning()
MOUNTING, COURSE = MountingYawTuning(), CourseTuning()
