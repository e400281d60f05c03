"""Messages become numbers, whether they come from rclpy or from a bag."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from magcal_ros.core.earth_field.reference import Fix
from magcal_ros.core.geometry.vec3 import Triple
from magcal_ros.core.samples.streams import (
    FieldSample,
    HeadingSample,
    ImuSample,
    SpeedSample,
    VelocitySample,
)

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
    q = message.orientation
    return imu_of(
        seconds(message.header.stamp),
        (force.x, force.y, force.z),
        message.linear_acceleration_covariance[0],
        (rate.x, rate.y, rate.z),
        message.angular_velocity_covariance[0],
        (q.x, q.y, q.z, q.w),
        message.orientation_covariance[0],
    )


def imu_of(
    stamp: float,
    force: Triple,
    force_mark: float,
    rate: Triple,
    rate_mark: float,
    orientation: tuple[float, float, float, float],
    orientation_mark: float,
) -> ImuSample | None:
    """Return the sample of an Imu's numbers; None if it says that it has no acceleration.

    Parameters
    ----------
    stamp : float
        Seconds.
    force, rate : tuple of float
        m/s² and rad/s.
    orientation : tuple of float
        Quaternion x, y, z, w.
    force_mark, rate_mark, orientation_mark : float
        First element of the covariance of each, which tells whether it is absent.
    """
    if force_mark == ABSENT:
        return None
    return ImuSample(
        stamp,
        force,
        NO_RATE if rate_mark == ABSENT else rate,
        None if orientation_mark == ABSENT else orientation,
    )


def field_sample(message: Any) -> FieldSample:
    """Return the numbers of a sensor_msgs/MagneticField."""
    field = message.magnetic_field
    return FieldSample(seconds(message.header.stamp), (field.x, field.y, field.z))


def fix_of(message: Any) -> Fix:
    """Return the numbers of a sensor_msgs/NavSatFix."""
    place = message.latitude, message.longitude, message.altitude
    return fix_from(seconds(message.header.stamp), message.status.status, *place)


def fix_from(stamp: float, status: int, latitude: float, longitude: float, altitude: float) -> Fix:
    """Return the fix that a NavSatFix tells: seconds, its status, degrees and metres."""
    return Fix(status >= STATUS_FIX, latitude, longitude, altitude, stamp)


RECEIVER_SPEED_SIGMA = 0.1
"""m/s per axis of a receiver's velocity; a TwistStamped carries no covariance."""


def speed_of(message: Any) -> SpeedSample | str:
    """Return the signed speed of a nav_msgs/Odometry, or why it has none."""
    header, linear = message.header, message.twist.twist.linear
    frames = header.frame_id, message.child_frame_id
    mark = message.twist.covariance[0]
    return speed_from(seconds(header.stamp), *frames, mark, linear.x, linear.y)


def speed_from(
    stamp: float, world: str, child: str, mark: float, x: float, y: float
) -> SpeedSample | str:
    """Return the signed speed that an Odometry tells, or why it has none.

    REP-105 and nav_msgs have the twist in `child_frame_id`, the vehicle's own frame.

    Parameters
    ----------
    stamp : float
        Seconds.
    world, child : str
        Its frames.
    mark : float
        First element of the twist's covariance, which tells whether it is absent.
    x, y : float
        Of its linear velocity, m/s.
    """
    if child and child == world:
        return (
            f"its child_frame_id {child!r} is its frame_id, so that its twist is no speed along "
            "the vehicle: name the vehicle's frame there"
        )
    if mark == ABSENT:
        return "its twist is marked absent (covariance -1)"
    if not math.isfinite(x + y):
        return "its twist is not finite"
    # The sideways part counts as well: frames are misaligned a little.
    return SpeedSample(stamp, math.copysign(math.hypot(x, y), x))


def velocity_of(message: Any) -> VelocitySample | str:
    """Return the velocity of a TwistStamped in ENU, or why it has none.

    A geometry_msgs/TwistWithCovarianceStamped may tell its sigma, too.
    """
    twist, variances = message.twist, (0.0, 0.0)
    if hasattr(twist, "covariance"):
        variances = float(twist.covariance[0]), float(twist.covariance[7])
        twist = twist.twist
    stamp, linear = seconds(message.header.stamp), twist.linear
    return velocity_from(stamp, linear.x, linear.y, *variances)


def velocity_from(
    stamp: float, east: float, north: float, of_east: float = 0.0, of_north: float = 0.0
) -> VelocitySample | str:
    """Return the velocity that a twist tells, or why it has none.

    Parameters
    ----------
    stamp : float
        Seconds.
    east, north : float
        m/s.
    of_east, of_north : float
        Variance of each, (m/s)²; zero where it is unknown.
    """
    if of_east == ABSENT:
        return "its velocity is marked absent (covariance -1)"
    sigma = RECEIVER_SPEED_SIGMA
    if of_east > 0.0 and of_north > 0.0:
        sigma = math.sqrt(0.5 * (of_east + of_north))
    if not math.isfinite(east + north + sigma):
        return "its velocity is not finite"
    return VelocitySample(stamp, east, north, sigma)


HEADING_SIGMA = math.radians(1.0)
"""Of a heading whose orientation covariance is zero, which says that nobody knows it."""
NO_HEADING = math.radians(30.0)
"""Sigma from which a driver says that it has no heading at the moment."""


def heading_of(message: Any) -> HeadingSample | str:
    """Return the yaw of a sensor_msgs/Imu's orientation, or why it has none."""
    q, covariance = message.orientation, message.orientation_covariance
    marks = covariance[0], float(covariance[8])
    return heading_from(seconds(message.header.stamp), (q.x, q.y, q.z, q.w), *marks)


def heading_from(
    stamp: float, orientation: Sequence[float], mark: float, variance: float
) -> HeadingSample | str:
    """Return the yaw that an Imu's orientation tells, or why it has none.

    Parameters
    ----------
    stamp : float
        Seconds.
    orientation : sequence of float
        Quaternion x, y, z, w.
    mark : float
        First element of its covariance, which tells whether it is absent.
    variance : float
        Of the yaw, rad².
    """
    if mark == ABSENT:
        return "its orientation is marked absent (covariance -1)"
    x, y, z, w = orientation
    size = x * x + y * y + z * z + w * w
    if not abs(size - 1.0) < 0.02:
        return f"its orientation is no unit quaternion (length {math.sqrt(abs(size)):.3g})"
    if not (math.isfinite(variance) and 0.0 <= variance < NO_HEADING**2):
        return "its orientation covariance says that the yaw is not known"
    yaw = math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
    sigma = math.sqrt(variance) if variance > 0.0 else HEADING_SIGMA
    return HeadingSample(stamp, yaw, sigma)


def current_of(message: Any) -> tuple[float, float]:
    """Return stamp (s) and current (A) of a sensor_msgs/BatteryState."""
    return seconds(message.header.stamp), float(message.current)
