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
from magcal_ros.core.heading import Compass, Heading
from magcal_ros.core.knowledge import ReferenceField
from magcal_ros.core.triples import Triple
from magcal_ros.core.up import Up
from magcal_ros.ros.messages import bias_message
from magcal_ros.ros.wire.incoming import FieldArrival
from magcal_ros.ros.wire.outgoing import AttitudeTemplate, FieldTemplate, NumberTemplate

LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
RELIABLE = QoSProfile(depth=10)


class Outputs:
    """Publishes what the calibration in force makes of each field message.

    What nobody listens to is neither computed nor filled in.

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
        self._field = FieldTemplate()
        self._attitude = AttitudeTemplate()
        self._yaw = NumberTemplate()
        self._covariance_in = b""
        self._covariance: tuple[float, ...] = ()
        self._bias: MagneticField | None = None
        self._last_up: Up | None = None
        self._heading: Heading | None = None
        self._is_heading_known = True
        self.compass: Compass | None = None
        self.last_field: Triple | None = None

    @property
    def last_heading(self) -> Heading | None:
        """The attitude at the last field message; None if it had none."""
        if not self._is_heading_known and self.compass is not None:
            self._is_heading_known = True
            field, up = self.last_field, self._last_up
            if field is not None and up is not None:
                self._heading = self.compass.heading(field, up.direction, up.variance)
        return self._heading

    def put_in_force(self, calibration: Calibration | None, magnetometer_frame: str = "") -> None:
        """Use a calibration from the next message on; None stops every corrected output."""
        self.compass = None if calibration is None else Compass(calibration)
        self._covariance_in = b""
        self.last_field = None
        self._heading = None
        self._is_heading_known = True
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
        self, arrived: FieldArrival, up: Up | None, frame: str, reference: ReferenceField
    ) -> None:
        """Correct one field message and publish everything that follows from it.

        Parameters
        ----------
        arrived : FieldArrival
            What the message says; its stamp and covariance are carried over.
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
        field = self.last_field = compass.correct(arrived.sample.field)
        self._last_up, declination = up, reference.declination
        self._heading, self._is_heading_known = None, False
        if _is_wanted(self._field_out):
            covariance = self._carried(compass, arrived.covariance)
            self._field_out.publish(self._field.fill(arrived.stamp, frame, field, covariance))
        magnetic, yaw = _is_wanted(self._magnetic_out), _is_wanted(self._yaw_out)
        true = declination is not None and _is_wanted(self._true_out)
        if not (magnetic or yaw or true):
            return
        heading = self.last_heading
        if heading is None:
            return
        if magnetic:
            self._magnetic_out.publish(self._attitude.fill(arrived.stamp, frame, heading))
        if true:
            sigma = reference.declination_sigma
            filled = self._attitude.fill(arrived.stamp, frame, heading, declination or 0.0, sigma)
            self._true_out.publish(filled)
        if yaw:
            self._yaw_out.publish(self._yaw.fill(true_yaw(heading.yaw, declination or 0.0)))

    def _carried(self, compass: Compass, covariance: bytes) -> tuple[float, ...]:
        """Return the covariance in body axes; drivers send the same with every message."""
        if covariance != self._covariance_in:
            sigma = np.frombuffer(covariance, "<f8").reshape(3, 3)
            with np.errstate(over="ignore", invalid="ignore"):
                carried = compass.calibration.correction.covariance(sigma)
            # By convention zeros stand for a covariance that is not known.
            is_known = np.isfinite(carried).all()
            self._covariance = tuple(carried.ravel().tolist()) if is_known else (0.0,) * 9
            self._covariance_in = covariance
        return self._covariance


def _is_wanted(publisher: Publisher[Any]) -> bool:
    return bool(publisher.get_subscription_count())
