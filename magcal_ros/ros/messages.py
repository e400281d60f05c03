"""Numbers to messages: once each, at the door."""

from __future__ import annotations

import numpy as np
from sensor_msgs.msg import Imu, MagneticField

from magcal_ros.core.correction import Correction
from magcal_ros.core.heading import Heading
from magcal_ros.core.messages import ABSENT


def bias_message(correction: Correction, frame: str) -> MagneticField:
    """Return the correction as ctu-vras tools take it: h as the field, A as the covariance."""
    message = MagneticField()
    message.header.frame_id = frame
    message.magnetic_field.x, message.magnetic_field.y, message.magnetic_field.z = (
        float(value) for value in correction.hard_iron
    )
    message.magnetic_field_covariance = correction.matrix.ravel().copy()
    return message


def fill_orientation(
    message: Imu, heading: Heading, declination: float = 0.0, declination_sigma: float = 0.0
) -> None:
    """Write an attitude and its covariance into an Imu; without a declination to magnetic north."""
    q = message.orientation
    q.x, q.y, q.z, q.w = heading.quaternion(declination)
    message.orientation_covariance = np.array(heading.covariance(declination_sigma**2))


def orientation_only() -> Imu:
    """Return an Imu whose rates and accelerations are marked absent."""
    message = Imu()
    message.angular_velocity_covariance[0] = ABSENT
    message.linear_acceleration_covariance[0] = ABSENT
    return message
