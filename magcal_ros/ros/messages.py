"""Messages to numbers, and numbers to messages: once each, at the door."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from sensor_msgs.msg import Imu, MagneticField

from magcal_ros.core.correction import Correction
from magcal_ros.core.heading import Heading, Triple
from magcal_ros.core.streams import FieldSample, ImuSample

NO_RATE: Triple = (math.nan, math.nan, math.nan)
ABSENT = -1.0
"""First element of a covariance whose measurement is absent (sensor_msgs/Imu)."""


def seconds(stamp: Any) -> float:
    """Return a builtin_interfaces/Time in seconds."""
    return float(stamp.sec + stamp.nanosec * 1e-9)


def imu_sample(message: Imu) -> ImuSample | None:
    """Return the numbers of an Imu; None if it says that it has no acceleration."""
    if message.linear_acceleration_covariance[0] == ABSENT:
        return None
    force, rate = message.linear_acceleration, message.angular_velocity
    has_rate = message.angular_velocity_covariance[0] != ABSENT
    return ImuSample(
        seconds(message.header.stamp),
        (force.x, force.y, force.z),
        (rate.x, rate.y, rate.z) if has_rate else NO_RATE,
    )


def field_sample(message: MagneticField) -> FieldSample:
    """Return the numbers of a MagneticField."""
    field = message.magnetic_field
    return FieldSample(seconds(message.header.stamp), (field.x, field.y, field.z))


def bias_message(correction: Correction, frame: str) -> MagneticField:
    """Return the correction as ctu-vras tools take it: h as the field, A as the covariance."""
    message = MagneticField()
    message.header.frame_id = frame
    message.magnetic_field.x, message.magnetic_field.y, message.magnetic_field.z = (
        float(value) for value in correction.hard_iron
    )
    message.magnetic_field_covariance = correction.matrix.ravel().copy()
    return message


def fill_orientation(message: Imu, heading: Heading, declination: float) -> None:
    """Write an attitude and its covariance into an Imu."""
    q = message.orientation
    q.x, q.y, q.z, q.w = heading.quaternion(declination)
    message.orientation_covariance = np.array(heading.covariance())


def orientation_only() -> Imu:
    """Return an Imu whose rates and accelerations are marked absent."""
    message = Imu()
    message.angular_velocity_covariance[0] = ABSENT
    message.linear_acceleration_covariance[0] = ABSENT
    return message
