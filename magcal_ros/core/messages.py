"""The two sensor messages become numbers: of rclpy and of a bag alike, they have the same names."""

from __future__ import annotations

import math
from typing import Any

from magcal_ros.core.earth_field.position import Fix
from magcal_ros.core.geometry.vec3 import Triple
from magcal_ros.core.samples.streams import FieldSample, ImuSample

NO_RATE: Triple = (math.nan, math.nan, math.nan)
ABSENT = -1.0
"""First element of a covariance whose measurement is absent (sensor_msgs/Imu)."""


STATUS_FIX = 0
"""Lowest status of a sensor_msgs/NavSatStatus that has a fix."""


def seconds(stamp: Any) -> float:
    """Return a builtin_interfaces/Time in seconds."""
    return float(stamp.sec + stamp.nanosec * 1e-9)


def imu_sample(message: Any) -> ImuSample | None:
    """Return the numbers of a sensor_msgs/Imu; None if it says that it has no acceleration."""
    force, rate = message.linear_acceleration, message.angular_velocity
    return imu_of(
        seconds(message.header.stamp),
        (force.x, force.y, force.z),
        message.linear_acceleration_covariance[0],
        (rate.x, rate.y, rate.z),
        message.angular_velocity_covariance[0],
    )


def imu_of(
    stamp: float, force: Triple, force_mark: float, rate: Triple, rate_mark: float
) -> ImuSample | None:
    """Return the sample of an Imu's numbers; None if it says that it has no acceleration.

    Parameters
    ----------
    stamp : float
        Seconds.
    force, rate : tuple of float
        m/s² and rad/s.
    force_mark, rate_mark : float
        First element of the covariance of each, which tells whether it is absent.
    """
    if force_mark == ABSENT:
        return None
    return ImuSample(stamp, force, NO_RATE if rate_mark == ABSENT else rate)


def field_sample(message: Any) -> FieldSample:
    """Return the numbers of a sensor_msgs/MagneticField."""
    field = message.magnetic_field
    return FieldSample(seconds(message.header.stamp), (field.x, field.y, field.z))


def fix_of(message: Any) -> Fix:
    """Return the numbers of a sensor_msgs/NavSatFix."""
    return Fix(
        message.status.status >= STATUS_FIX,
        message.latitude,
        message.longitude,
        message.altitude,
        seconds(message.header.stamp),
    )
