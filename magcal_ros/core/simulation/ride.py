"""A simulated robot under way: its sensors' samples one after another, at their own rates."""

from __future__ import annotations

import numpy as np

from magcal_ros.core.geometry.arrays import FloatArray
from magcal_ros.core.geometry.attitude import STANDARD_GRAVITY
from magcal_ros.core.geometry.rotations import exp_rotation, rotation_from_rpy
from magcal_ros.core.samples.streams import FieldSample, ImuSample
from magcal_ros.core.simulation.simulator import UP_ENU, Robot

REST: FloatArray = np.zeros(3)


class Ride:
    """Moves a robot in small steps and lets its sensors watch.

    Parameters
    ----------
    robot : Robot
        Truth and noise.
    rng : numpy.random.Generator
        Source of chance.
    start : float
        First stamp, seconds.
    imu_rate : float
        Hertz; also the rate of the steps.
    steps_per_field : int
        A field sample comes with each so-many-th step.
    gyro : bool
        Whether there is one.

    Attributes
    ----------
    attitude : ndarray, shape (3, 3)
        ENU to body.
    axis : ndarray, shape (3,)
        What the robot turns about, body axes: body z, unless the IMU is tilted on it.
    stamp : float
        Of the newest step, seconds.
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
        """Set the robot down with this attitude (ENU, radians)."""
        self.attitude = rotation_from_rpy(roll, pitch, yaw).T

    def step(
        self,
        yaw_rate: float = 0.0,
        *,
        acceleration: FloatArray = REST,
        tipping: FloatArray = REST,
        disturbance: FloatArray = REST,
    ) -> list[ImuSample | FieldSample]:
        """Move on for one period and return what the sensors report.

        Parameters
        ----------
        yaw_rate : float
            rad/s about `axis`.
        acceleration : ndarray, shape (3,)
            m/s² in body axes, as of a start, a stop or a circle.
        tipping : ndarray, shape (3,)
            rad/s in body axes on top of the yaw rate, as at the foot of a ramp.
        disturbance : ndarray, shape (3,)
            Tesla in ENU that iron nearby adds to the Earth's field.
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
        """The true ENU yaw of body x to magnetic north, radians."""
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
        field = self.robot.raw_field((self.attitude @ (self.robot.field_enu + disturbance))[None])[
            0
        ]
        field = field + self.robot.noise_field * self._rng.standard_normal(3)
        return FieldSample(self.stamp, _triple(field))


def _triple(vector: FloatArray) -> tuple[float, float, float]:
    x, y, z = vector.tolist()
    return x, y, z
