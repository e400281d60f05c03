"""The assumptions about drives, by subject: each number with its unit and its reason.

The values suit cars and ground robots.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
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
    shortest: float = 0.045
    """Shortest interval of samples that are used, seconds; the others are skipped."""
    outliers: float = 0.02  # largest fraction of samples with impossible jumps


@dataclass(frozen=True)
class VehicleAccelerationTuning:
    """When the vehicle's acceleration is subtracted, and how the direction of travel is found."""

    seconds: float = 0.25  # duration of a tick: short compared with a start or a curve
    levelling: float = 60.0
    """Seconds over which the accelerometer levels the gyro's frame: long compared with starts."""
    steepest: float = 0.05  # least sine between body x and the vertical for a heading
    oldest: float = 3.5
    """Largest latency of a usable speed, and age of a matched tick, over which the gyro propagates
    up, seconds."""
    memory: float = 20.0
    """Seconds over which slopes and the accelerometer's bias are constant, and for which a force
    counts that the speed does not explain."""
    remembered: float = 600.0  # seconds of driving that are kept
    speed_at_rest: float = 0.5
    """m/s below which a vehicle is at rest; the speed of a receiver drifts."""
    quiet: float = 0.3  # m/s², scatter of the force that needs no explanation
    backwards: float = 100.0  # metres that no vehicle drives backwards before it drives forwards


@dataclass(frozen=True)
class MountingYawTuning:
    """The yaw of the IMU in the vehicle from force against speed."""

    smooth: int = 4  # ticks of the low-pass, one second: latency and vibration
    lever_sigma: float = 1.0  # prior sigma of the IMU's distance from the rear axle, metres
    scale: float = 0.2
    """Largest deviation of the scale from one; beyond, the speed's unit is wrong."""
    energy: float = 10.0  # m²/s³, changes of the force by which a speed is judged: one start
    usable: float = math.radians(6.0)  # largest sigma of a usable yaw, radians
    explained: float = 0.4  # least fraction of the force's changes that the speed explains
    floor: float = math.radians(0.3)  # least sigma, radians: suspension, tyres
    largest_delay: float = 8.0  # largest latency that is tried, seconds; the least is -1/8 of it
    reuse: float = 8.0  # seconds between fits
    density_known_for: float = 40.0
    """Weight of the prior of the residual's spectral density, seconds of a drive. In the prior,
    errors last as long as accelerations."""
    rounds: int = 6  # reweighted fits, also of a course


@dataclass(frozen=True)
class CourseTuning:
    """Chords, whether their course is a heading, and the compass against course."""

    shortest: float = 5.0
    longest: float = 4.0
    """Shortest distance, metres, and longest time, seconds, between the fixes of a chord, and the
    latter between chords that are compared for drift."""
    largest_sigma: float = math.radians(12.0)
    """Largest sigma of a course, radians; that of a receiver at rest is larger."""
    largest_turn: float = math.radians(5.0)
    """Largest turn of a chord, radians: in curves lever arm, slip and latency cause errors."""
    relative_sigma: float = 0.3
    """Relative error of neighbouring fixes, metres; not the absolute accuracy."""
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
