"""The tuned numbers of the doctor by subject, each with its unit and meaning.

Unless a line says otherwise, the values are from simulated sensors with and without faults
(benchmarks/axes.py and imu_faults.py) and about twenty recordings.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from magcal_ros.core.smoother.unknowns import ANY_WAY, KINDS, UNKNOWNS


@dataclass(frozen=True)
class AlignmentPriors:
    """Priors of the fits of field or gravity to the gyro.

    They allow a gyro bias of 5 °/s, a scale error of a fifth, and half a second of latency.
    """

    installation: float = math.radians(5.0)
    """Radians, standard deviation of the installation error about each axis."""
    soft_iron: float = 0.05
    """Standard deviation of each element of the soft iron, dimensionless, and of the inclination by
    it, radians."""
    bias: float = math.radians(6.0)  # rad/s, standard deviation of the gyro's bias
    scale: float = 0.2  # standard deviation of the gyro's scale error
    lag: float = UNKNOWNS["latency"].sigma[0] * UNKNOWNS["latency"].most
    """Seconds, standard deviation of the field's latency: the largest of the smoother."""
    hard_iron: float = 4.0  # standard deviation of the hard iron over the field's size
    field_floor: float = math.radians(0.5)
    up_floor: float = math.radians(2.0)
    """Least noise that is assumed: over the field's size (also of an attitude by the gyro, radians)
    and of up over many seconds, radians."""
    freedom: float = 4.0  # degrees of freedom of the t distribution of the residuals


WIDE = AlignmentPriors()


@dataclass(frozen=True)
class AxesTuning:
    """Limits of the hypotheses on axes and on the gyro's unit."""

    remains: float = 20.0
    """Chi-square, in independent samples, up to which a hypothesis is kept. From twice as much the
    axes as given are called wrong, and beyond four times a hypothesis is not fitted. Up to half as
    much, candidates are ordered by common mistakes."""
    times: float = 2.0  # residual, relative to the best one, from which a fit is clearly worse
    lift: float = math.radians(3.0)
    """RMS tilt, radians, from which a smaller difference suffices to exclude a hypothesis."""
    worst_fit: float = 0.3
    """Residual, relative to the changing field, beyond which no hypothesis is accepted, and largest
    change of the field from sample to sample of a turn."""
    most_named: int = 3  # candidates that are described for one sensor
    most: int = 32  # hypotheses that are fitted
    doubtful: float = 12.0
    """Largest chi-square of field or gravity if soft iron or acceleration may explain it."""
    good_fit: float = 0.06
    """Residual, relative to the changing field, up to which small differences are significant."""
    settled: float = 0.02
    """Seconds, change of the latency that ends the iteration, and largest sigma of the field's that
    is reported."""
    rounds: int = 4  # iterations of the latency, of a fit with one noise, of robust weights
    least_turn: float = math.radians(40.0)
    """Radians, smallest turn between two attitudes. The guide waits for twice as much."""
    span: float = 0.6
    """Seconds over which turns are compared: noise dominates shorter turns, bias longer ones."""
    lever: float = KINDS[ANY_WAY].lever_arm
    """Metres, standard deviation of the lever arm: from the elbow for a sensor that is swung by
    hand, from the rear axle in a vehicle."""


AXES = AxesTuning()


@dataclass(frozen=True)
class TurnTuning:
    """Settings of the fits for latency, the motors' field, and drives."""

    most: int = 1500  # samples of the accelerometer; more are averaged
    least: float = 1e-3  # seconds, standard deviation of the stamps' systematic errors
    turns: float = math.radians(5.0)  # rad/s from which the robot turns
    radius: float = 1.5  # metres, radius of a circle from which the robot drives


TURN = TurnTuning()


@dataclass(frozen=True)
class ErrorTuning:
    """Errors that are reported: of the gyro, of stamps, of field and reference, and of the yaw.

    A quantity is called wrong if its error is larger than this and significant. It is not reported
    if its sigma is too large for that (`is_vague`).
    """

    bias: float = math.radians(0.8)  # rad/s of the gyro's bias
    scale: float = 0.03  # relative error of the gyro's scale
    lag: float = 0.016  # seconds between the sensors' stamps
    strength: float = 0.2  # relative difference of the strength from the reference
    inclination: float = math.radians(8.0)  # radians of inclination from the reference
    motors: float = 1.5e-6  # tesla, smallest field of the motors
    turned_too_far: float = math.radians(25.0)
    """Heading error by the motors' field from which the sensor should be moved. This field is half
    the level field: a change of the motors' current by a tenth turns the heading by 3°."""
    declination: float = math.radians(25.0)  # largest in inhabited places, if no place is given
    own_yaw: float = math.radians(8.0)
    """Sigma of the mean error of a driver's own compass during a turn or a part of it."""

    @property
    def near(self) -> float:
        """Largest difference from a multiple of 90° if no declination is known, radians."""
        return self.declination + self.own_yaw


ERRORS = ErrorTuning()


@dataclass(frozen=True)
class HealthTuning:
    """Limits of the faults of one stream, and of stamps from two clocks."""

    jitter: float = 0.5  # RMS deviation of the gaps, relative to the usual gap, with a warning
    share: float = 0.05
    """Fraction of samples that repeat the sample before, or that deviate from their neighbours,
    with a warning: places along a road cause up to 4%."""
    coarse: float = 0.5e-6  # tesla, resolution of the field
    lattice: float = 0.05  # mean deviation of numbers from a grid, relative to its step
    saturated: tuple[int, float] = (5, 1.5)
    """Smallest number of cells, along the other two axes, in which a saturated axis is at its
    extreme, and its ratio to the cells just below the extreme. A cell has a twentieth of the
    field's size."""
    by_chance: float = 1e-6  # probability of a constant axis below which it is called stuck
    fewest: int = 50  # samples below which a stream is not checked
    field_noise: float = 3e-6
    rate_noise: float = 0.3
    """Noise per axis (1σ) with a warning, tesla and rad/s. Engine vibration gives about 0.1."""
    frozen: float = 1.0  # seconds from which a repeated value is that of a frozen sensor
    moving: float = 0.25
    """Of a moving robot: change of the field over its range, fraction of the time in which the gyro
    turns, and rate over its fastest."""
    alike: float = 0.25
    """Share of the variance of one by which a shift of the other one explains more than any
    latency, if their clocks differ."""


HEALTH = HealthTuning()


@dataclass(frozen=True)
class GuideTuning:
    """When a step of the guide is done."""

    stand: float = 4.0  # seconds of rest of the first step
    rest: float = 1.0  # seconds of rest that end a turn or a lift
    still: float = 0.06
    """Largest change at rest: of gravity's direction, radians, and of the field over its size."""
    lift: float = math.radians(8.0)  # smallest change of gravity's direction, radians
    patience: float = 45.0  # seconds after which a step is given up


GUIDE = GuideTuning()
