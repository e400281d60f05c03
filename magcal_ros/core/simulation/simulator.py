"""A simulated robot: true values and measurements of its sensors."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from magcal_ros.core.calibration.correction import Correction
from magcal_ros.core.geometry.arrays import FloatArray, freeze
from magcal_ros.core.geometry.attitude import (
    STANDARD_GRAVITY,
    field_in_enu,
    wrap_angle,
    yaw_from_up_and_field,
)
from magcal_ros.core.geometry.rotations import exp_rotation, rotation_from_rpy
from magcal_ros.core.knowledge import Belief, Knowledge, Mounting, ReferenceField
from magcal_ros.core.samples.streams import FieldSample, ImuSample

DEGREE = math.pi / 180.0
UP_ENU: FloatArray = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True, eq=False)
class Robot:
    """The true field, the true errors of the magnetometer, and the noise of the sensors.

    The raw field is `K R_n (I + E) R m_body + h + noise`, as in `Knowledge`.
    """

    strength: float = 50e-6
    inclination: float = 60.0 * DEGREE
    declination: float = 0.0  # the Earth's field at the robot: tesla, radians, radians
    roll: float = 3.0 * DEGREE
    pitch: float = -4.0 * DEGREE
    yaw: float = 0.0
    """Installation error in radians, a pose as in a URDF. The yaw is not observable from one
    turn."""
    hard_iron: FloatArray = field(default_factory=lambda: np.array([30e-6, -20e-6, 25e-6]))
    """Tesla, in the magnetometer's axes. Shape (3,)."""
    mounting: Mounting = field(default_factory=Mounting)  # known gains and nominal pose
    soft_iron: FloatArray = field(default_factory=lambda: np.zeros((3, 3)))
    """E, soft iron that is unknown to the estimator. Shape (3, 3)."""
    noise_field: float = 0.5e-6
    noise_force: float = 0.01 * STANDARD_GRAVITY
    noise_rate: float = 1e-3  # standard deviations per axis and sample: tesla, m/s², rad/s
    gyro_bias: FloatArray = field(default_factory=lambda: np.zeros(3))  # rad/s. Shape (3,).

    def __post_init__(self) -> None:
        freeze(self, hard_iron=(3,), soft_iron=(3, 3), gyro_bias=(3,))

    @cached_property
    def distortion(self) -> FloatArray:
        """The matrix from the field in body axes to the raw field, shape (3, 3)."""
        installation = rotation_from_rpy(self.roll, self.pitch, self.yaw).T
        return np.asarray(self.mounting.matrix @ (np.eye(3) + self.soft_iron) @ installation)

    @cached_property
    def field_enu(self) -> FloatArray:
        """The reference field in true ENU axes, tesla, shape (3,)."""
        return field_in_enu(self.strength, self.inclination, self.declination)

    @property
    def true_correction(self) -> Correction:
        """The correction of a perfect calibration."""
        return Correction(np.asarray(np.linalg.inv(self.distortion)), self.hard_iron)

    def knowledge(self, strength_sigma: float = 0.0, inclination_sigma: float = 0.0) -> Knowledge:
        """Return the prior knowledge of this robot: reference field, mounting, exact sensors.

        The sigmas are in tesla and radians; zero for exactly known, infinite for unknown.
        """
        reference = ReferenceField(
            Belief(self.strength, strength_sigma),
            Belief(self.inclination, inclination_sigma),
            self.declination,
        )
        return Knowledge(reference, self.mounting, exact_sensors=True)

    def raw_field(self, field_body: FloatArray) -> FloatArray:
        """Return the noise-free raw field (n, 3) for the field in body axes (n, 3), tesla."""
        return np.asarray(field_body @ self.distortion.T + self.hard_iron)


def trial_attitudes(tilt: float = 10.0 * DEGREE) -> FloatArray:
    """Return attitudes ENU to body at 24 headings for nine tilts, shape (24, 9, 3, 3).

    The tilts are roll and pitch in {-tilt, 0, tilt}, radians; index 4 is level.
    """
    yaws = np.arange(24) * (2.0 * math.pi / 24)
    steps = (-tilt, 0.0, tilt)
    return np.array([[rotation_from_rpy(r, p, y).T for r in steps for p in steps] for y in yaws])


LEVEL_TILT = 4  # index of the level tilt in `trial_attitudes`


def heading_errors(
    correction: Correction, robot: Robot, attitudes: FloatArray | None = None
) -> FloatArray:
    """Return the yaw errors of a correction at known attitudes with perfect sensors.

    They are the estimated minus the true magnetic yaw, radians in (-pi, pi], shape (...). The
    attitudes (..., 3, 3) are from ENU to body, by default `trial_attitudes`.
    """
    poses = trial_attitudes() if attitudes is None else attitudes
    up, field_body = poses @ UP_ENU, poses @ robot.field_enu
    found = yaw_from_up_and_field(up, correction.apply(robot.raw_field(field_body)))
    return wrap_angle(found - yaw_from_up_and_field(up, field_body))


REST: FloatArray = np.zeros(3)


class Ride:
    """Moves a robot in small steps and simulates its sensors.

    The stamps begin at `start`, seconds. There are `imu_rate` steps and IMU samples a second, and a
    field sample in every `steps_per_field`-th step. `attitude` (3, 3) is from ENU to body axes.
    `axis` (3,) is the axis of rotation in body axes, which is z unless the IMU is tilted.
    """

    def __init__(
        self,
        robot: Robot,
        rng: np.random.Generator,
        *,
        start: float,
        imu_rate: float = 100.0,
        steps_per_field: int = 2,
        gyro: bool = True,
    ) -> None:
        self.robot = robot
        self.attitude: FloatArray = np.eye(3)
        self.axis: FloatArray = UP_ENU
        self.stamp = start
        self.period = 1.0 / imu_rate
        self._rng = rng
        self._steps_per_field = steps_per_field
        self._gyro = gyro
        self._steps = 0

    def stand(self, roll: float, pitch: float, yaw: float) -> None:
        """Set the attitude of the robot (ENU, radians)."""
        self.attitude = rotation_from_rpy(roll, pitch, yaw).T

    def step(
        self,
        yaw_rate: float = 0.0,
        *,
        acceleration: FloatArray = REST,
        tipping: FloatArray = REST,
        disturbance: FloatArray = REST,
    ) -> list[ImuSample | FieldSample]:
        """Move for one period and return the samples of the sensors.

        `yaw_rate` is about `axis`, `tipping` (3,) an additional rate in body axes, as at the foot
        of a ramp, both in rad/s. `acceleration` (3,) is in m/s², body axes. `disturbance` (3,) is
        the field of iron nearby in tesla, ENU.
        """
        rate = yaw_rate * self.axis + tipping
        self.attitude = exp_rotation(-rate * self.period) @ self.attitude
        self.stamp += self.period
        samples: list[ImuSample | FieldSample] = [self._imu(rate, acceleration)]
        if self._steps % self._steps_per_field == 0:
            samples.append(self._field(disturbance))
        self._steps += 1
        return samples

    @property
    def magnetic_yaw(self) -> float:
        """The true magnetic ENU yaw of body x, radians."""
        forward = self.attitude[0]
        return float(np.arctan2(forward[1], forward[0]) + self.robot.declination)

    def _imu(self, rate: FloatArray, acceleration: FloatArray) -> ImuSample:
        noise = self._rng.standard_normal((2, 3))
        force = STANDARD_GRAVITY * (self.attitude @ UP_ENU) + acceleration
        force = force + self.robot.noise_force * noise[0]
        measured = rate + self.robot.gyro_bias + self.robot.noise_rate * noise[1]
        if not self._gyro:
            measured = np.full(3, np.nan)
        return ImuSample(self.stamp, _triple(force), _triple(measured))

    def _field(self, disturbance: FloatArray) -> FieldSample:
        field = self.robot.raw_field(self.attitude @ (self.robot.field_enu + disturbance))
        field = field + self.robot.noise_field * self._rng.standard_normal(3)
        return FieldSample(self.stamp, _triple(field))


def _triple(vector: FloatArray) -> tuple[float, float, float]:
    x, y, z = vector.tolist()
    return x, y, z
