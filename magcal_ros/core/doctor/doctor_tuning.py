"""The tuned numbers of the doctor by subject, each with its unit and meaning.

Unless a line says otherwise, the values are from simulated sensors with and without faults
(benchmarks/axes.py and imu_faults.py) and about twenty recordings.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace


@dataclass(frozen=True)
class AlignmentPriors:
    """Priors while candidate axes are compared.

    They allow a gyro bias of 5 °/s, a scale error of a fifth, and half a second of latency.
    """

    installation: float = math.radians(5.0)
    """Radians, standard deviation of the installation error about each axis."""
    soft_iron: float = 0.05  # standard deviation of each element of the soft iron, dimensionless
    bias: float = math.radians(6.0)  # rad/s, standard deviation of the gyro's bias
    scale: float = 0.2  # standard deviation of the gyro's scale error
    lag: float = 0.3  # seconds, standard deviation of the field's latency
    hard_iron: float = 4.0  # standard deviation of the hard iron over the field's size
    field_floor: float = 0.01
    up_floor: float = math.radians(2.0)
    """Least noise that is assumed: over the field's size, and radians."""
    freedom: float = 4.0  # degrees of freedom of the t distribution of the residuals


WIDE = AlignmentPriors()
FORCE_PRIORS = replace(
    WIDE,
    field_floor=1e-3,
    freedom=10.0,
    installation=math.radians(3.0),
    soft_iron=0.02,
    hard_iron=0.3,
)
"""Priors of the fit to single samples; the accelerometer's offset is relative to the changing part
of gravity."""


@dataclass(frozen=True)
class AxesTuning:
    """Limits of the hypotheses on axes and on the gyro's unit."""

    remains: float = 20.0
    """Chi-square, in independent samples, up to which a hypothesis is kept. From twice as much the
    axes as given are called wrong, and beyond four times a hypothesis is not fitted."""
    likely: float = 9.0  # chi-square up to which candidates are ordered by common mistakes
    times: float = 2.0  # residual, relative to the best one, from which a fit is clearly worse
    lift: float = math.radians(3.0)
    """RMS tilt, radians, from which a smaller difference suffices to exclude a hypothesis."""
    worst_fit: float = 0.3
    """Residual, relative to the changing field, beyond which no hypothesis is accepted."""
    dip_sigma: float = math.radians(3.0)
    """Standard deviation, radians, that is added to that of a reference inclination."""
    attitude_error: float = math.radians(0.5)  # radians, smallest error of a propagated attitude
    most_named: int = 3  # candidates that are described for one sensor
    most: int = 32  # hypotheses that are fitted
    doubtful: float = 12.0
    """Largest chi-square of field or gravity if soft iron or acceleration may explain it."""
    good_fit: float = 0.06
    """Residual, relative to the changing field, up to which small differences are significant."""
    settled: float = 0.02  # seconds, change of the latency that ends the iteration
    looks: int = 4  # largest number of iterations of the latency, and of a fit with one noise
    least_turn: float = math.radians(40.0)  # radians, smallest turn between two attitudes
    span: float = 0.6
    """Seconds over which turns are compared: noise dominates shorter turns, bias longer ones. For
    the gyro's unit the field must change, too, for which longer ones are tried."""
    lever: float = 1.0
    """Metres, standard deviation of the lever arm: from the elbow for a sensor that is swung by
    hand, from the rear axle in a vehicle."""
    rounds: int = 3  # iterations of the robust weights
    unit_ratio: float = 5.0  # ratio of the rates from which the unit, not the scale, is wrong
    moved: float = 0.15  # smallest change of the field in a span that is used, relative to its size
    below: float = 8.0
    above: float = 2.2
    """Largest ratio of rough to known factor, and of known to rough: noise enlarges the rough."""


AXES = AxesTuning()


@dataclass(frozen=True)
class LatencyTuning:
    """Settings of the fits for latency, the motors' field, and drives."""

    most: int = 1500  # samples of the accelerometer; more are averaged
    lever: float = 0.3
    """Standard deviation of the accelerometer's lever arm from the turn's axis, metres."""
    walk_steps: int = 40  # of the gyro's random walk
    walk: float = math.radians(0.01)  # radians in a second, random walk of a noise-free gyro
    steady: float = 1.5  # seconds over which the noise is averaged
    least: float = 1e-3  # seconds, standard deviation of the stamps' systematic errors
    turns: float = math.radians(5.0)  # rad/s from which the robot turns
    late: float = 0.1
    """Seconds of latency from which the field is also fitted with this latency subtracted."""
    radius: float = 1.5  # metres, radius of a circle from which the robot drives


FINE = LatencyTuning()


@dataclass(frozen=True)
class ErrorTuning:
    """Errors that are reported: of the gyro, of stamps, of field and reference, and of the yaw."""

    bias: float = math.radians(0.8)  # rad/s of the gyro's bias
    scale: float = 0.03  # relative error of the gyro's scale
    at_rest: float = math.radians(0.1)  # rad/s, standard deviation of a bias measured at rest
    confirmed: float = 0.4  # largest difference from the rate at rest, relative to the bias
    lag: float = 0.015  # seconds between the sensors' stamps
    vague: tuple[float, float, float, float] = (math.radians(0.6), 0.015, 0.02, 0.008)
    """Largest sigma of bias (rad/s), scale, and lag of field and of force (s) that is reported."""
    largest_noise: float = 0.25
    """Usual difference of successive samples, relative to the changing part, of mere noise."""
    strength: float = 0.2  # relative difference of the strength from the reference
    vague_strength: float = 0.1  # largest relative standard deviation of a strength that is used
    inclination: float = math.radians(8.0)  # radians of inclination from the reference
    motors: float = 1.5e-6  # tesla, smallest field of the motors
    turned_too_far: float = math.radians(25.0)
    """Heading error by the motors' field from which the sensor should be moved. This field is half
    the level field: a change of the motors' current by a tenth turns the heading by 3°."""
    vague_yaw: float = math.radians(12.0)  # largest sigma of a difference of yaw that is used
    near: float = math.radians(35.0)
    """Largest difference from a multiple of 90°, which allows for an unknown declination."""
    iron: float = 0.3
    """Largest sigma of the hard iron, relative to the level field, of a usable compass."""
    declination: float = math.radians(25.0)  # largest in inhabited places, if no place is given
    own_yaw: float = math.radians(8.0)
    """Sigma of the mean error of a driver's own compass during a turn or a part of it."""


ERRORS = ErrorTuning()


@dataclass(frozen=True)
class HealthTuning:
    """Limits of the faults of one stream, and of stamps from two clocks."""

    jitter: float = 0.5  # RMS deviation of the gaps, relative to the usual gap, with a warning
    repeats: float = 0.05  # fraction of samples that repeat the sample before
    spikes: float = 0.05
    """Fraction of samples that deviate from their neighbours, with a warning: places along a road
    cause up to 4%."""
    spiky_gap: float = 0.07  # seconds between samples up to which a movement causes no spikes
    coarse: float = 0.5e-6  # tesla, resolution of the field
    lattice: float = 0.05  # largest deviation of numbers from a grid, relative to its step
    saturated: tuple[int, float] = (5, 1.5)
    """Smallest number of cells, along the other two axes, in which a saturated axis is at its
    extreme, and its ratio to the cells just below the extreme. A cell has a twentieth of the
    field's size."""
    quiet: float = 10e-9  # tesla, smallest noise of any magnetometer
    rounding: float = 0.71  # apparent noise, in steps, of a number that rises half a step a sample
    by_chance: float = 1e-6  # probability of a constant axis below which it is called stuck
    gravity: float = 0.15  # relative difference of the usual specific force from gravity
    fewest: int = 50  # samples below which a stream is not checked
    field_noise: float = 3e-6
    rate_noise: float = 0.3
    """Noise per axis (1σ) with a warning, tesla and rad/s. Engine vibration gives about 0.1."""
    frozen: float = 1.0  # seconds from which a repeated value is that of a frozen sensor
    moving_field: float = 0.2  # change of the field, relative to its range, of a moving robot
    overlap: float = 0.5  # smallest overlap of two streams on one clock, relative to the shorter
    pace_step: float = 0.1
    longest: float = 7200.0
    """Time step of the correlation of gyro and field, and the longest log for it, seconds."""
    latency: float = 0.6  # seconds up to which a shift is a latency, not another clock
    alike: float = 0.55
    better: float = 0.2
    """Smallest correlation at a larger shift, and its lead over those within a latency."""


HEALTH = HealthTuning()


@dataclass(frozen=True)
class GuideTuning:
    """When a step of the guide is done."""

    block: float = 0.25  # seconds that are averaged
    stand: float = 4.0  # seconds of rest of the first step
    rest: float = 1.0  # seconds of rest that end a turn or a lift
    still: tuple[float, float] = (math.radians(2.0), 0.06)
    """Largest change at rest: of gravity, radians, and of the field, relative to its size."""
    angle: float = math.radians(75.0)  # smallest turn by the gyro, radians
    swing: float = 0.4
    """Change of the field, relative to its size, that shows a turn without the gyro."""
    stopped: float = 0.25  # largest pace at the end of a turn, relative to its fastest
    lift: float = math.radians(8.0)  # smallest change of gravity's direction, radians
    patience: float = 45.0  # seconds after which a step is given up


GUIDE = GuideTuning()
