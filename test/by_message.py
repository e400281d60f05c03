"""The numbers of messages by their attributes, to compare with what is read from the bytes."""

from magcal_ros.core.messages import fix_from, imu_of, seconds, speed_from, velocity_from
from magcal_ros.core.samples import FieldSample


def imu_sample(message):
    force, rate, q = message.linear_acceleration, message.angular_velocity, message.orientation
    return imu_of(
        seconds(message.header.stamp),
        (force.x, force.y, force.z),
        message.linear_acceleration_covariance[0],
        (rate.x, rate.y, rate.z),
        message.angular_velocity_covariance[0],
        (q.x, q.y, q.z, q.w),
        message.orientation_covariance[0],
    )


def field_sample(message):
    field = message.magnetic_field
    return FieldSample(seconds(message.header.stamp), (field.x, field.y, field.z))


def fix_of(message):
    place = message.latitude, message.longitude, message.altitude
    return fix_from(seconds(message.header.stamp), message.status.status, *place)


def speed_of(message):
    header, linear = message.header, message.twist.twist.linear
    frames, mark = (header.frame_id, message.child_frame_id), message.twist.covariance[0]
    return speed_from(seconds(header.stamp), *frames, mark, linear.x, linear.y)


def velocity_of(message):
    twist, variances = message.twist, ()
    if hasattr(twist, "covariance"):
        variances = float(twist.covariance[0]), float(twist.covariance[7])
        twist = twist.twist
    stamp = seconds(message.header.stamp)
    return velocity_from(stamp, twist.linear.x, twist.linear.y, *variances)
