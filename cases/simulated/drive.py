"""A simulated drive: the samples of sensors, wheels and receiver, and the truth."""

from __future__ import annotations

import dataclasses
import heapq
import math
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
from scipy.special import ndtr, stdtrit

from magcal_ros.core.calibration.correction import Correction
from magcal_ros.core.geometry.arrays import FloatArray, frozen_array, interpolated
from magcal_ros.core.geometry.attitude import STANDARD_GRAVITY
from magcal_ros.core.geometry.rotations import rotation_from_rpy
from magcal_ros.core.samples.streams import (
    FieldSample,
    ImuSample,
    PositionSample,
    SpeedSample,
    VelocitySample,
)
from magcal_ros.core.simulation import UP_ENU, Robot
from simulated.reckoning import Receiver, Wheels
from simulated.travel import Travel


@dataclass(frozen=True)
class Streets:
    """The disturbance of the field by the iron of streets.

    Parameters
    ----------
    size : float
        Tesla per axis, standard deviation: 2.5 to 5 µT in cities.
    reach : float
        Metres over which it is alike (e to the minus one).
    small_share, small_reach : float
        Share of the variance that changes within so many metres: covers, parked cars.
    freedom : float
        Degrees of freedom of Student's distribution: streets have heavy tails.
    waves : int
        Plane waves per reach that the field is made of.
    spacing : float
        Metres of way between the places where the waves are summed.
    """

    size: float = 3e-6
    reach: float = 30.0
    small_share: float = 0.3
    small_reach: float = 2.0
    freedom: float = 4.0
    waves: int = 200
    spacing: float = 0.5


class StreetField:
    """A random field over places: the same street has the same disturbance again.

    Each axis is Gaussian with the covariance exp(-distance/reach), which in the plane is a sum of
    waves whose wave vectors are Student-distributed with one degree of freedom (random Fourier
    features; Rahimi and Recht, 2007). Its marginal is turned into Student's distribution.

    Parameters
    ----------
    streets : Streets
        How much it bends.
    rng : numpy.random.Generator
        Source of chance.
    """

    def __init__(self, streets: Streets, rng: np.random.Generator) -> None:
        self.streets = streets
        share = streets.small_share
        self._parts = [
            (math.sqrt(weight), *_waves(reach, streets.waves, rng))
            for weight, reach in ((1.0 - share, streets.reach), (share, streets.small_reach))
        ]

    def at(self, places: FloatArray) -> FloatArray:
        """Return the disturbance at places (n, 2) in metres: tesla in ENU, shape (n, 3)."""
        total = np.zeros((len(places), 3))
        for weight, waves, amplitudes in self._parts:
            phase = places @ waves.T
            total += weight * np.hstack([np.cos(phase), np.sin(phase)]) @ amplitudes
        freedom = self.streets.freedom
        heavy = stdtrit(freedom, np.clip(ndtr(total), 1e-6, 1.0 - 1e-6))
        return np.asarray(self.streets.size * math.sqrt(1.0 - 2.0 / freedom) * heavy)

    def along(self, places: FloatArray) -> FloatArray:
        """Return the same along a way of dense places (n, 2), shape (n, 3).

        It is summed once each `spacing` metres of way and interpolated between.
        """
        steps = np.hypot(*np.diff(places, axis=0).T)
        metres = np.r_[0.0, np.cumsum(steps)]
        marks = np.arange(0.0, metres[-1] + self.streets.spacing, self.streets.spacing)
        field = self.at(interpolated(marks, metres, places))
        return interpolated(metres, marks, field)


def _waves(reach: float, count: int, rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
    """Return wave vectors (count, 2) in rad/m and amplitudes (2 count, 3) of a unit field."""
    vectors = rng.standard_normal((count, 2)) / np.abs(rng.standard_normal((count, 1))) / reach
    return vectors, rng.standard_normal((2 * count, 3)) / math.sqrt(count)


AnySample = ImuSample | FieldSample | SpeedSample | PositionSample | VelocitySample


@dataclass(frozen=True)
class Iron:
    """Iron on the vehicle for a time: a trailer, a load, or a permanent magnet.

    Parameters
    ----------
    field : tuple of float
        Tesla in IMU axes.
    begin, end : float
        Seconds from the start of the drive.
    """

    field: tuple[float, float, float]
    begin: float
    end: float = math.inf


@dataclass(frozen=True)
class Fence:
    """Steel along one side of the road, passed at one heading.

    Parameters
    ----------
    field : tuple of float
        Tesla in vehicle axes.
    heading, width : float
        Radians: passed where the yaw is within half the width of the heading.
    """

    field: tuple[float, float, float]
    heading: float = 0.0
    width: float = math.radians(60.0)


@dataclass(frozen=True, eq=False)
class Vehicle:
    """A robot's compass in a vehicle.

    Parameters
    ----------
    robot : Robot
        The field, the compass's errors and the sensors' noise.
    imu_yaw, imu_roll, imu_pitch : float
        Pose of the IMU in the vehicle, radians, as in a URDF: a positive yaw looks to the left.
    imu_ahead : float
        Metres from the rear axle, which does not slip, to the IMU.
    shaking : float
        m/s² per axis at 50 Hz that the road adds while the vehicle moves.
    bias_walk : float
        rad/s per root second of the gyro's bias.
    """

    robot: Robot = field(
        default_factory=lambda: Robot(noise_force=0.05, noise_rate=2e-3, noise_field=0.3e-6)
    )
    imu_yaw: float = 0.0
    imu_roll: float = 0.0
    imu_pitch: float = 0.0
    imu_ahead: float = 0.0
    shaking: float = 0.3
    bias_walk: float = 1e-5

    @property
    def imu_pose(self) -> FloatArray:
        """From IMU axes to vehicle axes, shape (3, 3)."""
        return rotation_from_rpy(self.imu_roll, self.imu_pitch, self.imu_yaw)

    def with_iron(self, extra: FloatArray) -> Vehicle:
        """Return the vehicle with more hard iron, tesla in IMU axes."""
        iron = self.robot.hard_iron + self.robot.distortion @ extra
        return dataclasses.replace(self, robot=dataclasses.replace(self.robot, hard_iron=iron))


def random_vehicle(rng: np.random.Generator) -> Vehicle:
    """Draw a car's compass: installation, hard and soft iron, gyro bias; the field is Boston's."""
    soft = 0.5 * rng.normal(0.0, 0.02, (3, 3))
    soft = (soft + soft.T) * np.array([[1.0, 1.0, 0.3], [1.0, 1.0, 0.3], [0.3, 0.3, 0.3]])
    robot = Robot(
        strength=51.3e-6,
        inclination=math.radians(66.3),
        roll=math.radians(rng.normal(0.0, 3.0)),
        pitch=math.radians(rng.normal(0.0, 3.0)),
        hard_iron=rng.normal(0.0, 25e-6, 3),
        soft_iron=soft,
        noise_force=0.05,
        noise_rate=2e-3,
        noise_field=0.3e-6,
        gyro_bias=np.radians(rng.normal(0.0, 0.1, 3)),
    )
    return Vehicle(robot)


@dataclass(frozen=True, eq=False)
class Drive:
    """The samples of a drive, in arrays, and the truth.

    Parameters
    ----------
    vehicle : Vehicle
        Who drove.
    truth : Travel
        Where.
    force : ndarray, shape (n, 3)
        Specific force in IMU axes at `truth.time`, m/s².
    rate : ndarray, shape (n, 3)
        Angular rate in IMU axes at `truth.time`, rad/s; NaN without a gyro.
    field : ndarray, shape (n, 3)
        Raw field at `truth.time`, tesla, in the magnetometer's axes.
    disturbance : ndarray, shape (n, 3)
        What streets and fences add to the Earth's field, tesla in ENU.
    irons : tuple of Iron
        What changed on the way.
    speeds, positions, velocities : tuple
        What wheels and receiver said, by stamp; empty where there are none.
    """

    vehicle: Vehicle
    truth: Travel
    force: FloatArray
    rate: FloatArray
    field: FloatArray
    disturbance: FloatArray
    irons: tuple[Iron, ...] = ()
    speeds: tuple[SpeedSample, ...] = ()
    positions: tuple[PositionSample, ...] = ()
    velocities: tuple[VelocitySample, ...] = ()

    def __post_init__(self) -> None:
        for name in ("force", "field", "disturbance"):
            object.__setattr__(self, name, frozen_array(getattr(self, name), (-1, 3), name))

    @property
    def time(self) -> FloatArray:
        """Stamps of IMU and field, seconds, shape (n,)."""
        return self.truth.time

    @property
    def imu_yaw(self) -> FloatArray:
        """The true ENU yaw of the IMU's x to magnetic north, radians, shape (n,)."""
        forward = np.swapaxes(self.truth.attitude, 1, 2) @ self.vehicle.imu_pose[:, 0]
        return np.asarray(
            np.unwrap(np.arctan2(forward[:, 1], forward[:, 0])) + self.vehicle.robot.declination
        )

    @property
    def up(self) -> FloatArray:
        """The true up in IMU axes, shape (n, 3)."""
        return np.asarray(self.truth.attitude @ UP_ENU @ self.vehicle.imu_pose)

    def correction_at(self, stamp: float) -> Correction:
        """Return the perfect calibration at a stamp."""
        vehicle = self.vehicle
        for iron in self.irons:
            if iron.begin <= stamp - self.time[0] < iron.end:
                vehicle = vehicle.with_iron(np.array(iron.field))
        return vehicle.robot.true_correction

    def samples(self) -> Iterator[AnySample]:
        """Yield all samples, in the order of the stamps."""
        streams = (self._sensors(), self.speeds, self.positions, self.velocities)
        yield from heapq.merge(*streams, key=lambda sample: sample.stamp)

    def _sensors(self) -> Iterator[ImuSample | FieldSample]:
        rows = (self.time, self.force, self.rate, self.field)
        for stamp, force, rate, raw in zip(*(row.tolist() for row in rows), strict=True):
            yield ImuSample(stamp, tuple(force), tuple(rate))
            yield FieldSample(stamp, tuple(raw))


def simulated_drive(
    truth: Travel,
    rng: np.random.Generator,
    vehicle: Vehicle = Vehicle(),
    *,
    streets: StreetField | Streets | None = Streets(),
    wheels: Wheels | None = Wheels(),
    receiver: Receiver | None = Receiver(),
    irons: tuple[Iron, ...] = (),
    fences: tuple[Fence, ...] = (),
) -> Drive:
    """Simulate the sensors of a vehicle on a drive.

    Parameters
    ----------
    truth : Travel
        Where it drives.
    rng : numpy.random.Generator
        Source of chance.
    vehicle : Vehicle
        Who drives.
    streets : StreetField, Streets or None
        What bends the field: one that is kept for several drives, one made anew, or nothing.
    wheels, receiver : Wheels or None, Receiver or None
        What else is measured.
    irons, fences : tuple
        What comes with the vehicle for a while, and what it passes.
    """
    if isinstance(streets, Streets):
        streets = StreetField(streets, rng)
    bent = np.zeros((len(truth.time), 3)) if streets is None else streets.along(truth.position)
    bent = bent + _fenced(truth, fences)
    return Drive(
        vehicle,
        truth,
        _force(truth, vehicle, rng),
        _rate(truth, vehicle, rng),
        _field(truth, vehicle, bent, irons, rng),
        bent,
        irons,
        () if wheels is None else wheels.speeds(truth, rng),
        *(((), ()) if receiver is None else receiver.received(truth, rng)),
    )


def _force(truth: Travel, vehicle: Vehicle, rng: np.random.Generator) -> FloatArray:
    rate, ahead = truth.angular_rate, vehicle.imu_ahead
    spin = rate[:, 2]
    lever = np.column_stack(
        [-ahead * spin**2, ahead * np.gradient(spin, truth.period), np.zeros(len(spin))]
    )
    force = STANDARD_GRAVITY * truth.attitude[:, :, 2] + truth.acceleration + lever
    force = force @ vehicle.imu_pose
    # Shaking is given at 50 Hz: a faster sensor measures more of the same spectrum.
    shaking = vehicle.shaking * math.sqrt(0.02 / truth.period)
    size = vehicle.robot.noise_force + shaking * (np.abs(truth.speed) > 0.05)
    return np.asarray(force + size[:, None] * rng.standard_normal(force.shape))


def _rate(truth: Travel, vehicle: Vehicle, rng: np.random.Generator) -> FloatArray:
    robot, shape = vehicle.robot, (len(truth.time), 3)
    walk = vehicle.bias_walk * math.sqrt(truth.period)
    bias = robot.gyro_bias + walk * np.cumsum(rng.standard_normal(shape), axis=0)
    noise = robot.noise_rate * rng.standard_normal(shape)
    return np.asarray(truth.angular_rate @ vehicle.imu_pose + bias + noise)


def _field(
    truth: Travel,
    vehicle: Vehicle,
    bent: FloatArray,
    irons: tuple[Iron, ...],
    rng: np.random.Generator,
) -> FloatArray:
    robot = vehicle.robot
    own = np.einsum("nij,nj->ni", truth.attitude, robot.field_enu + bent) @ vehicle.imu_pose
    since = truth.time - truth.time[0]
    for iron in irons:
        own[(since >= iron.begin) & (since < iron.end)] += iron.field
    return np.asarray(robot.raw_field(own) + robot.noise_field * rng.standard_normal(own.shape))


def _fenced(truth: Travel, fences: tuple[Fence, ...]) -> FloatArray:
    """Return the field of fences, tesla in ENU, shape (n, 3)."""
    added = np.zeros((len(truth.time), 3))
    for fence in fences:
        near = np.cos(truth.yaw - fence.heading) > math.cos(0.5 * fence.width)
        added[near] += np.swapaxes(truth.attitude[near], 1, 2) @ np.array(fence.field)
    return added
