"""The numbers of messages by their attributes, to compare with what is read from the bytes."""

import math

from magcal_ros.core.earth_field import Fix
from magcal_ros.core.samples import FieldSample, ImuSample, SpeedSample, VelocitySample
from magcal_ros.files.wire import seconds


def imu_sample(message):
    force, rate, q = message.linear_acceleration, message.angular_velocity, message.orientation
    if message.linear_acceleration_covariance[0] == -1.0:
        return None
    has_rate = message.angular_velocity_covariance[0] != -1.0
    has_orientation = message.orientation_covariance[0] != -1.0
    return ImuSample(
        seconds(message.header.stamp),
        (force.x, force.y, force.z),
        (rate.x, rate.y, rate.z) if has_rate else (math.nan,) * 3,
        (q.x, q.y, q.z, q.w) if has_orientation else None,
    )


def field_sample(message):
    field = message.magnetic_field
    return FieldSample(seconds(message.header.stamp), (field.x, field.y, field.z))


def fix_of(message):
    place = message.latitude, message.longitude, message.altitude
    return Fix(message.status.status >= 0, *place, seconds(message.header.stamp))


def speed_of(message):
    """Return the sample of an odometry whose twist is usable."""
    linear = message.twist.twist.linear
    speed = math.copysign(math.hypot(linear.x, linear.y), linear.x)
    return SpeedSample(seconds(message.header.stamp), speed)


def velocity_of(message):
    """Return the sample of a usable velocity."""
    twist, sigma = message.twist, 0.1
    if hasattr(twist, "covariance"):
        variance = 0.5 * (float(twist.covariance[0]) + float(twist.covariance[7]))
        twist, sigma = twist.twist, math.sqrt(variance) if variance > 0.0 else sigma
    return VelocitySample(seconds(message.header.stamp), twist.linear.x, twist.linear.y, sigma)
