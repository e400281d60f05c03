"""The unknowns of the smoother, their order, and their priors: the one table of numbers.

Units inside the smoother: microtesla, radians, seconds, metres.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from magcal_ros.core.geometry.arrays import FloatArray
from magcal_ros.core.knowledge import STREET_LENGTH

MICROTESLA = 1e6  # microtesla in a tesla
WAVES = 6  # sine waves that represent the random walk of the gyro's bias over a window

ACCELERATION, VELOCITY, ATTITUDE = slice(0, 2), slice(2, 4), slice(4, 7)
STREET, BODY_FIELD = slice(7, 10), slice(10, 13)
"""Unknowns of a node. Of its motion: correlated change of the velocity (m/s², level axes of the
body); velocity (m/s, the same axes); attitude increment (rad, body axes). Of the field: local
disturbance of the Earth's field (µT, world axes); coloured noise of the body's field (µT). The
unknowns of one measurement are neighbours."""
LOCAL = 13
HEADING_DRIFT, HEADING_RATE = slice(2, 3), slice(3, 4)
"""At known headings, in place of the velocity: the drift of a device's heading, degrees, and its
constant rate, degrees per second."""
RATE, CLIMB = slice(7, 8), slice(8, 9)
"""Without a gyro, in place of the local disturbance: the turn rate about the turn's axis, rad/s,
and the accelerometer's velocity upward, m/s."""


class Unknown(NamedTuple):
    """One group of shared unknowns with its prior.

    The prior is Gaussian about zero. Its sigma is uncertain itself: the whole group is larger or
    smaller by one factor with a truncated log-normal prior, which is estimated with the unknowns.
    An effect that the samples do not show stays near zero; one that they show is not shrunk.
    """

    sigma: tuple[float, ...]  # median of the sigma of each number
    spread: float
    """Standard deviation of the natural logarithm of the factor; zero for a fixed sigma."""
    most: float  # largest factor
    unit: str
    meaning: str
    source: str


class Size(NamedTuple):
    """The standard deviation of one kind of noise: estimated, with a log-normal prior."""

    usual: float  # median
    spread: float  # standard deviation of its natural logarithm
    freedom: float  # degrees of freedom of the Student distribution of the noise itself
    unit: str
    meaning: str
    source: str
    start: float = math.nan  # initial value, if not the median
    most: float = math.inf  # largest value: no sensor or robot exceeds it

    @property
    def rms(self) -> float:
        """The root mean square under the prior."""
        return self.usual * math.exp(self.spread**2)


UNKNOWNS: dict[str, Unknown] = {
    "iron": Unknown((100.0,) * 3, 0.0, 1.0, "µT", "hard iron about its start", "wider than any"),
    "installation": Unknown(
        (0.07, 0.07), 0.5, 3.0, "rad", "roll and pitch", "boards are level by hand"
    ),
    "soft_iron": Unknown(
        (0.005,) * 3 + (0.0035,) * 3,
        1.2,
        60.0,
        "-",
        "symmetric distortion (xx, yy, zz, xy, xz, yz) by soft iron, gains and axes not orthogonal",
        "0 to 30%; the median is `IRON_OVER_AXES` of this",
    ),
    "axes": Unknown(
        (0.0035,),
        0.9,
        8.0,
        "-",
        "yaw error of non-orthogonal axes; their distortion is of the same size",
        "data sheets of MEMS magnetometers: axes .3 to 1.2% out of square",
    ),
    "shielding": Unknown(
        (0.02,),
        1.5,
        40.0,
        "-",
        "gain of the level field less one",
        "the bodies of cars leave a third to all of it; no heading depends on it",
    ),
    "turned": Unknown(
        (0.09,), 0.0, 1.0, "rad", "yaw of the installation", "boards: 5°; shown by several tilts"
    ),
    "earth": Unknown(
        (9.0, 25.0), 0.0, 1.0, "µT", "level and downward field", "the reference, or all cities"
    ),
    "gyro_bias": Unknown((0.003,) * 3, 0.8, 30.0, "rad/s", "gyro bias", "MEMS: .1 to 5 °/s"),
    "bias_walk": Unknown(
        (1.8e-5,) * WAVES,
        1.0,
        10.0,
        "rad/s/√s",
        "walk of the gyro's bias about z",
        "cheap gyros: .001 to .01 °/s in a minute",
    ),
    "gyro_matrix": Unknown(
        (0.008,) * 9, 0.5, 3.0, "-", "gyro scale and misalignment, by rows", "MEMS: .2 to 2%"
    ),
    "lever_arm": Unknown(
        (0.08,) * 3, 0.5, 4.0, "m", "accelerometer from the pivot", "small robots"
    ),
    "latency": Unknown(
        (0.005,), 1.5, 60.0, "s", "latency of the field", "drivers: 0 to 20 ms, some .3 s"
    ),
    "motors_moving": Unknown(
        (0.05,) * 3, 2.0, 600.0, "µT", "field while the robot moves", "most: none"
    ),
    "motors_rate": Unknown((0.05,) * 3, 2.0, 2000.0, "µT s", "field per turn rate", "most: none"),
    "drift": Unknown(
        (0.15,) * 3, 0.7, 30.0, "µT", "drift of hard iron over the window", ".2 to 1 µT"
    ),
    "added": Unknown(
        (10.0,) * 3,
        1.0,
        10.0,
        "µT",
        "hard iron that is added at one moment",
        "a load: 3 to 30",
    ),
    "entered": Unknown(
        (10.0,) * 3,
        1.0,
        10.0,
        "µT",
        "local disturbance that starts at one moment of a drive and stays, world axes",
        "bridges, garages: 5 to 20",
    ),
    "came": Unknown(
        (0.3,),
        0.0,
        1.0,
        "-",
        "fraction of its node in which a change is present, minus a half",
        "uniform",
    ),
    "force_moving": Unknown(
        (0.01,) * 3,
        1.2,
        50.0,
        "m/s²",
        "shift of the accelerometer while the robot moves",
        "vibration: most none, some .1",
    ),
    "force_offset": Unknown(
        (0.06,) * 3, 0.5, 10.0, "m/s²", "offset of the accelerometer", "MEMS: .02 to .5"
    ),
    "sway_arm": Unknown(
        (0.08, 0.08, 0.2),
        0.0,
        1.0,
        "m",
        "accelerometer from the pivot of its sway: ahead, left, up",
        "robots: 0 to .6 above it",
    ),
    "mounting_yaw": Unknown(
        (0.06,), 0.7, 8.0, "rad", "forward direction, left of the x axis", "boards fixed by hand"
    ),
    "axis": Unknown(
        (0.3, 0.3), 0.0, 1.0, "rad", "the turn's axis in the body, off its guess", "level by hand"
    ),
    "upright": Unknown(
        (0.1, 0.1), 0.0, 1.0, "rad", "the turn's axis in the world, to east and north", "slopes"
    ),
    "gradient": Unknown(
        (0.2,) * 6,
        1.5,
        60.0,
        "µT",
        "field gradient on the magnetometer's circle, by east and north of the body's x axis",
        "a sensor 0 to .25 m beside the axis; .1 to 20 µT/m",
    ),
    "place": Unknown(
        (0.05,) * 3,
        1.0,
        30.0,
        "µT",
        "field at the place of a turn, minus that of the other turns, world axes",
        "a few metres apart in the open: .02 to .3",
    ),
    "motors_current": Unknown(
        (0.05,) * 3,
        2.0,
        600.0,
        "µT",
        "field at the largest current of the battery; per ampere in a state",
        "most: none, some 20",
    ),
    "current_late": Unknown(
        (0.1,), 0.0, 1.0, "s", "latency of the current, about `USUALLY_LATE`", "drivers"
    ),
}
MOTORS = "motors_moving", "motors_rate", "motors_current"
BEYOND_USUAL = 2.0  # factor of the motors' usual size from which they are taken to add a field
USUALLY_LATE = 0.1
"""Usual latency of the current of a battery, and of a field that is late, seconds."""
MOST_SPREADS = 4.0
"""Limit of the logarithms of sizes, in spreads from the median; beyond it nothing changes."""

IRON_OVER_AXES = 0.4  # median distortion by soft iron over that by gains and non-orthogonal axes
MODULE = ("axes", "gyro_bias", "gyro_matrix", "force_offset")
"""Groups that depend on the quality of the sensor module: a cheap one has all of them larger."""
ALIKE = 0.5  # correlation of the logarithms of their factors

SIZES: dict[str, Size] = {
    "field": Size(
        0.07, 0.7, 6.0, "µT", "noise of a node's field beyond white noise", "steps of resolution"
    ),
    "force": Size(0.03, 1.5, 4.0, "m/s²", "noise of a link's level force", "vibration: .01 to .5"),
    "force_up": Size(0.03, 1.5, 4.0, "m/s²", "the same along z", "bumps of the road: to 1"),
    # Without a limit the fit would explain the acceleration of a drive by gyro noise.
    "gyro": Size(
        0.001, 0.5, 3.0, "rad/√s", "random walk about x and y", "MEMS: .0002 to .003", most=0.004
    ),
    "gyro_up": Size(
        0.001, 0.5, 3.0, "rad/√s", "the same about z", "MEMS: .0002 to .003", most=0.004
    ),
    "street": Size(1.0, 1.0, 6.0, "µT", "local disturbance per axis", "cars in cities: 2.5 to 5"),
    "revisited": Size(
        1.0,
        1.0,
        6.0,
        "µT",
        "part of it that the places do not explain, where a path repeats",
        "cars: .5 to 2.4",
    ),
    "traffic": Size(
        0.05, 1.5, 6.0, "µT/√s", "change of the local disturbance at rest", "none to .3 in traffic"
    ),
    "body_field": Size(0.1, 1.0, 6.0, "µT", "coloured noise of the body at rest", "currents"),
    # The initial value is large: otherwise the local disturbance absorbs the motors' field.
    "motors_noise": Size(
        0.1, 1.5, 3.0, "µT", "the same while the robot moves", "currents .05, motors to 20", 0.5
    ),
    "acceleration": Size(
        0.01,
        2.0,
        4.0,
        "m/s²",
        "change of the velocity ahead",
        "cars .1 to .3, on the spot 0",
        most=3.0,
    ),
    "speed": Size(0.1, 1.0, 4.0, "m/s", "error of the speed of the wheels", "slip: .02 to .3"),
    "slip": Size(0.01, 2.0, 4.0, "m/s²", "the same sideways", "wheels .01 to .05", most=3.0),
}

LEAN = Size(0.02, 0.7, 6.0, "rad", "tilt of the body off its axis on the way", "roads: .01 to .05")
SWAY: Mapping[str, Size] = {
    "lean": Size(0.01, 1.5, 6.0, "rad", "tilt of the body off its axis", "robots: 0 to .05", 0.03),
    "gyro_up": Size(0.01, 1.5, 4.0, "rad/√s", "yaw beyond a changing rate", "jerks", 0.05),
    "rate_change": Size(0.05, 1.5, 4.0, "rad/s/√s", "change of the turn rate", "0 to .3", 0.2),
    "speed_change": Size(
        0.003, 1.2, 4.0, "m/s", "velocity that neither turn nor sway explains", "on the spot: none"
    ),
}
"""With dead axes of the gyro, the tilt off the turn's axis; the others without a gyro."""

DISTURBANCE_AT_REST = Size(
    0.7, 0.5, 6.0, "µT", "local disturbance where a robot stands, per axis", "open places: .3 to 2"
)
"""Of a robot at rest at a known heading, in place of `street`."""


FIELDS_ON_EARTH = (
    (0.25, 28.0, 39.0, 5.0, 5.0),
    (0.19, 34.0, 30.0, 6.0, 5.0),
    (0.20, 20.0, 48.0, 5.0, 5.0),
    (0.12, 37.0, 12.0, 6.0, 7.0),
    (0.12, 35.0, -9.0, 6.0, 9.0),
    (0.10, 18.0, -17.0, 5.0, 6.0),
    (0.02, 25.0, -53.0, 5.0, 6.0),
)
"""Prior of an unknown field: weights, level and downward field, and their sigmas, µT. It is the
World Magnetic Model at the 6,200 cities of more than 100,000 people (GeoNames), with a local
deviation of 4 µT."""
NOTHING = 1e-3  # size of a local disturbance or of motors' noise that is known to be zero, µT
EXACT_IRON = 1e-5, 2.5, 1e4
"""Median size of soft iron, its spread and its largest factor, where the sensors are exact."""


class KindOfMotion(NamedTuple):
    """A kind of motion, with the groups that are free in it."""

    speed: float  # usual velocity ahead, m/s
    sideways: float  # usual velocity sideways over that ahead: wheels roll ahead
    lever_arm: float  # usual distance of the accelerometer from the pivot, metres per axis
    begins: float
    """Initial size of the acceleration, m/s². If it is too small, acceleration is taken for tilt;
    if it is too large, tilt is taken for acceleration."""
    motors: float = 2.0
    """Spread of the logarithm of the motors' field. In a vehicle it is small at the compass: rest
    and motion differ because the place does."""
    soft_iron: float = 1.0  # factor of the usual soft iron: a vehicle's body is of steel
    gradient: float = 1.0
    """Factor of the usual gradient of the field; a drive has local disturbances instead."""
    traffic: bool = False  # whether passing vehicles change the local disturbance at rest
    tilted: float = 1.0
    """Correlation time of the tilt off a fixed axis, seconds. A robot that stays is on one slope,
    and sways; the slope of a road changes within some 100 m."""

    @property
    def velocity(self) -> FloatArray:
        """Usual velocity ahead and sideways, m/s, shape (2,)."""
        return self.speed * np.array([1.0, self.sideways])

    @property
    def accelerations(self) -> tuple[float, float]:
        """Initial sizes of the acceleration ahead and sideways, m/s²."""
        return self.begins, self.begins * math.sqrt(self.sideways)

    @property
    def has_wheels(self) -> bool:
        """Whether the robot drives ahead, so that its accelerations show the forward direction."""
        return self.sideways < 1.0


ON_THE_SPOT, SMALL_CIRCLE = "on the spot", "small circle"
ON_WHEELS, ANY_WAY = "drive on wheels", "drive any way"
DRIVES = (ON_WHEELS, ANY_WAY)
KINDS: dict[str, KindOfMotion] = {
    ON_THE_SPOT: KindOfMotion(0.02, 1.0, 0.08, 0.01),
    SMALL_CIRCLE: KindOfMotion(0.8, 1.0, 0.08, 0.01),
    ON_WHEELS: KindOfMotion(6.0, 0.05, 1.0, 0.3, 0.7, 5.0, 0.0, True, 20.0),
    ANY_WAY: KindOfMotion(6.0, 1.0, 1.0, 0.3, 0.7, 5.0, 0.0, True, 20.0),
}
"""The kinds of motion that are tried; they differ in these priors only."""
LATE = f"{ON_THE_SPOT}, field late"
"""A turn on the spot, in which a latency of the field replaces the motors' field."""
MOVED = f"{ON_THE_SPOT}, parts moved"
"""A turn on the spot, in which a lid, an arm or a load on the robot is moved."""
PASSED = f"{ON_THE_SPOT}, something passes"
"""A turn on the spot of exact sensors, past which something magnetic moves."""
FREEDOM_IF_PASSED = 1.0  # degrees of freedom of the field's noise for `PASSED`
LASTING = 60.0  # correlation time of the body's coloured noise for `MOVED`: steps that last, s
USUAL: Mapping[str, float] = {ON_THE_SPOT: 0.5, LATE: 0.5, MOVED: 0.05, PASSED: 0.05, ANY_WAY: 0.1}
"""Relative prior weights of the kinds of motion; one if none is given. Most robots have wheels, few
turn exactly on the spot, and few have a part that is moved during a turn."""
ROLLING: Mapping[str, float] = {**USUAL, ANY_WAY: 0.5}
"""The same if the speed of the wheels is known. Some IMUs are mounted sideways without a parameter
that says so; a steady circle does not show it."""


@dataclass(frozen=True)
class Lengths:
    """Correlation lengths and times."""

    street: float = STREET_LENGTH  # correlation length of the local disturbance, metres (1/e)
    body_field: float = 4.0  # correlation time of the body's coloured noise, seconds
    acceleration: float = 3.0  # correlation time of the change of velocity, seconds
    beside: float = 0.15
    """Distance of the magnetometer from the pivot, metres, for its path in a turn."""
    creep: float = 0.01  # m/s that a robot at rest may still move
    moving: float = 0.03  # rad/s of turn rate from which a robot on the spot counts as moving


def _slices() -> tuple[dict[str, slice], int]:
    found, at = {}, 0
    for name, unknown in UNKNOWNS.items():
        found[name] = slice(at, at + len(unknown.sigma))
        at += len(unknown.sigma)
    return found, at


AT, SHARED = _slices()  # the slice of each group of shared unknowns, and their number
BIAS_UP = AT["gyro_bias"].start + 2
ROLL_PITCH, YAW = AT["installation"], AT["axes"].start
SHIELDING = AT["shielding"].start
TURNED = AT["turned"].start
EARTH = AT["earth"]
CURRENT_LATE = AT["current_late"].start
