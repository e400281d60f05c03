"""The messages become numbers: of rclpy and of a bag alike, they have the same names."""

from __future__ import annotations

import math
from typing import Any

from magcal_ros.core.earth_field.position import Fix
from magcal_ros.core.geometry.vec3 import Triple
from magcal_ros.core.samples.streams import FieldSample, ImuSample
from magcal_ros.core.samples.travel_samples import SpeedSample, VelocitySample

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


RECEIVER_SPEED_SIGMA = 0.1
"""m/s per axis of a receiver's velocity; a TwistStamped carries no covariance."""


def speed_of(message: Any) -> SpeedSample | str:
    """Return the signed speed of a nav_msgs/Odometry, or why it has none.

    REP-105 and nav_msgs have the twist in `child_frame_id`, the vehicle's own frame.
    """
    child, world = message.child_frame_id, message.header.frame_id
    if child and child == world:
        return (
            f"its child_frame_id {child!r} is its frame_id, so that its twist is no speed along "
            "the vehicle: name the vehicle's frame there"
        )
    if message.twist.covariance[0] == ABSENT:
        return "its twist is marked absent (covariance -1)"
    linear = message.twist.twist.linear
    if not math.isfinite(linear.x + linear.y):
        return "its twist is not finite"
    # What lies across belongs to the way as well: frames sit askew by little.
    speed = math.copysign(math.hypot(linear.x, linear.y), linear.x)
    return SpeedSample(seconds(message.header.stamp), speed)


def velocity_of(message: Any) -> VelocitySample | str:
    """Return the velocity of a TwistStamped in ENU, or why it has none.

    A geometry_msgs/TwistWithCovarianceStamped may tell its sigma, too.
    """
    twist, sigma = message.twist, RECEIVER_SPEED_SIGMA
    if hasattr(twist, "covariance"):
        east, north = float(twist.covariance[0]), float(twist.covariance[7])
        if east == ABSENT:
            return "its velocity is marked absent (covariance -1)"
        if east > 0.0 and north > 0.0:
            sigma = math.sqrt(0.5 * (east + north))
        twist = twist.twist
    linear = twist.linear
    if not math.isfinite(linear.x + linear.y + sigma):
        return "its velocity is not finite"
    return VelocitySample(seconds(message.header.stamp), linear.x, linear.y, sigma)
