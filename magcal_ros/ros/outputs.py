"""The walk of a field message: corrected, turned into a yaw, published."""

from __future__ import annotations

from typing import Any

import numpy as np
from builtin_interfaces.msg import Time
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import Imu, MagneticField
from std_msgs.msg import Float64

from magcal_ros.core.attitude import true_yaw
from magcal_ros.core.calibration import Calibration
from magcal_ros.core.heading import Compass, Heading, Triple
from magcal_ros.core.knowledge import ReferenceField
from magcal_ros.core.up import Up
from magcal_ros.ros.messages import bias_message, fill_orientation, orientation_only

LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
RELIABLE = QoSProfile(depth=10)


class Outputs:
    """Publishes what the calibration in force makes of each field message.

    Messages are made once and filled again: they are serialised before `publish` returns.

    Parameters
    ----------
    node : rclpy.node.Node
        Where the publishers live.
    """

    def __init__(self, node: Node) -> None:
        self._field_out = node.create_publisher(MagneticField, "imu/mag_unbiased", RELIABLE)
        self._magnetic_out = node.create_publisher(Imu, "compass/mag/enu/imu", RELIABLE)
        self._true_out = node.create_publisher(Imu, "compass/true/enu/imu", RELIABLE)
        self._yaw_out = node.create_publisher(Float64, "compass/yaw", RELIABLE)
        self._bias_out = node.create_publisher(MagneticField, "imu/mag_bias", LATCHED)
        self._field = MagneticField()
        self._attitude = orientation_only()
        self._yaw = Float64()
        self._covariance_in = b""
        self._bias: MagneticField | None = None
        self.compass: Compass | None = None
        self.last_heading: Heading | None = None
        self.last_field: Triple | None = None

    def put_in_force(self, calibration: Calibration | None, magnetometer_frame: str = "") -> None:
        """Use a calibration from the next message on; None stops every corrected output."""
        self.compass = None if calibration is None else Compass(calibration)
        self._covariance_in = b""
        self.last_heading = None
        self.last_field = None
        self._bias = None
        if calibration is not None:
            self._bias = bias_message(calibration.correction, magnetometer_frame)
            self.repeat_bias(None)

    def repeat_bias(self, stamp: Time | None) -> None:
        """Publish the bias once more, stamped if a stamp is given."""
        if self._bias is not None:
            if stamp is not None:
                self._bias.header.stamp = stamp
            self._bias_out.publish(self._bias)

    def publish(
        self,
        message: MagneticField,
        field: Triple,
        up: Up | None,
        frame: str,
        reference: ReferenceField,
    ) -> None:
        """Correct one field message and publish everything that follows from it.

        Parameters
        ----------
        message : MagneticField
            As it arrived; stamp and covariance are taken from it.
        field : tuple of float
            Its raw field, tesla.
        up : Up or None
            Of its moment; None leaves only the corrected field.
        frame : str
            The IMU's frame.
        reference : ReferenceField
            Without a declination there is no true north.
        """
        compass = self.compass
        if compass is None:
            return
        corrected = compass.correct(field)
        self.last_field = corrected
        stamp = message.header.stamp
        self._publish_field(compass, message, corrected, frame)
        if up is None:
            return
        heading = compass.heading(corrected, up.direction, up.variance)
        self.last_heading = heading
        if heading is None:
            return
        attitude = self._attitude
        attitude.header.stamp, attitude.header.frame_id = stamp, frame
        if _is_wanted(self._magnetic_out):
            fill_orientation(attitude, heading)
            self._magnetic_out.publish(attitude)
        declination = reference.declination
        if declination is not None and _is_wanted(self._true_out):
            fill_orientation(attitude, heading, declination, reference.declination_sigma)
            self._true_out.publish(attitude)
        self._yaw.data = true_yaw(heading.yaw, declination or 0.0)
        self._yaw_out.publish(self._yaw)

    def _publish_field(
        self, compass: Compass, message: MagneticField, corrected: Triple, frame: str
    ) -> None:
        out = self._field
        out.header.stamp, out.header.frame_id = message.header.stamp, frame
        out.magnetic_field.x, out.magnetic_field.y, out.magnetic_field.z = corrected
        covariance = message.magnetic_field_covariance.tobytes()
        if covariance != self._covariance_in:
            # Drivers send the same covariance with every message, so it is carried over once.
            sigma = np.asarray(message.magnetic_field_covariance).reshape(3, 3)
            carried = compass.calibration.correction.covariance(sigma)
            out.magnetic_field_covariance = np.nan_to_num(carried).ravel()
            self._covariance_in = covariance
        self._field_out.publish(out)


def _is_wanted(publisher: Publisher[Any]) -> bool:
    return bool(publisher.get_subscription_count())
