"""The two sensor messages become numbers: of rclpy and of a bag alike, they have the same names."""

from __future__ import annotations

import math
from typing import Any

from magcal_ros.core.streams import FieldSample, ImuSample

NO_RATE = (math.nan, math.nan, math.nan)
ABSENT = -1.0
"""First element of a covariance whose measurement is absent (sensor_msgs/Imu)."""


def seconds(stamp: Any) -> float:
    """Return a builtin_interfaces/Time in seconds."""
    return float(stamp.sec + stamp.nanosec * 1e-9)


def imu_sample(message: Any) -> ImuSample | None:
    """Return the numbers of a sensor_msgs/Imu; None if it says that it has no acceleration."""
    if message.linear_acceleration_covariance[0] == ABSENT:
        return None
    force, rate = message.linear_acceleration, message.angular_velocity
    has_rate = message.angular_velocity_covariance[0] != ABSENT
    return ImuSample(
        seconds(message.header.stamp),
        (force.x, force.y, force.z),
        (rate.x, rate.y, rate.z) if has_rate else NO_RATE,
    )


def field_sample(message: Any) -> FieldSample:
    """Return the numbers of a sensor_msgs/MagneticField."""
    field = message.magnetic_field
    return FieldSample(seconds(message.header.stamp), (field.x, field.y, field.z))
