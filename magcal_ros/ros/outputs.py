"""The walk of a field message: corrected, turned into a yaw, published."""

from __future__ import annotations

import numpy as np
from builtin_interfaces.msg import Time
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import Imu, MagneticField
from std_msgs.msg import Float64

from magcal_ros.core.geometry.attitude import true_yaw
from magcal_ros.core.heading.compass import Compass
from magcal_ros.core.heading.moment import Moment
from magcal_ros.core.knowledge import ReferenceField
from magcal_ros.ros.messages import bias_message
from magcal_ros.ros.seat import Seat
from magcal_ros.ros.wire.incoming import FieldArrival
from magcal_ros.ros.wire.outgoing import AttitudeTemplate, FieldTemplate, NumberTemplate

LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
RELIABLE = QoSProfile(depth=10)


class Outputs:
    """Publishes what the calibration in force makes of each field message.

    What nobody listens to is not filled in.

    Parameters
    ----------
    node : rclpy.node.Node
        Where the publishers live.
    seat : Seat
        Tells whose attitude is published.
    """

    def __init__(self, node: Node, seat: Seat) -> None:
        self._seat = seat
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
        self._compass: Compass | None = None
        self.moment: Moment | None = None
        """The newest field message under the calibration in force."""

    def put_in_force(self, compass: Compass | None, magnetometer_frame: str = "") -> None:
        """Use a compass from the next message on; None stops every corrected output."""
        self._compass = compass
        self._covariance_in = b""
        self.moment = None
        self._bias = None
        if compass is not None:
            correction = compass.calibration.correction
            self._bias = bias_message(correction, magnetometer_frame)
            self.repeat_bias(None)

    def repeat_bias(self, stamp: Time | None) -> None:
        """Publish the bias once more, stamped if a stamp is given."""
        if self._bias is not None:
            if stamp is not None:
                self._bias.header.stamp = stamp
            self._bias_out.publish(self._bias)

    def publish(
        self, moment: Moment, arrived: FieldArrival, frame: str, reference: ReferenceField
    ) -> None:
        """Publish everything that follows from one field message.

        Parameters
        ----------
        moment : Moment
            What it comes to; without a heading only the corrected field is published.
        arrived : FieldArrival
            What it said; its stamp and covariance are carried over.
        frame : str
            The IMU's frame.
        reference : ReferenceField
            Without a declination there is no true north.
        """
        self.moment, declination = moment, reference.declination
        stamp, view = arrived.stamp, self._seat.view
        if _is_wanted(self._field_out):
            covariance = self._carried(arrived.covariance)
            self._field_out.publish(self._field.fill(stamp, frame, moment.field, covariance))
        if moment.heading is None or view is None:
            return
        frame, heading = self._seat.frame(frame), view.heading(moment.heading)
        if _is_wanted(self._magnetic_out):
            self._magnetic_out.publish(self._attitude.fill(stamp, frame, heading))
        if declination is not None and _is_wanted(self._true_out):
            sigma = reference.declination_sigma
            filled = self._attitude.fill(stamp, frame, heading, declination, sigma)
            self._true_out.publish(filled)
        if _is_wanted(self._yaw_out):
            self._yaw_out.publish(self._yaw.fill(true_yaw(heading.yaw, declination or 0.0)))

    def _carried(self, covariance: bytes) -> tuple[float, ...]:
        """Return the covariance in body axes; drivers send the same with every message."""
        if self._compass is not None and covariance != self._covariance_in:
            sigma = np.frombuffer(covariance, "<f8").reshape(3, 3)
            with np.errstate(over="ignore", invalid="ignore"):
                carried = self._compass.calibration.correction.covariance(sigma)
            # By convention zeros stand for a covariance that is not known.
            is_known = np.isfinite(carried).all()
            self._covariance = tuple(carried.ravel().tolist()) if is_known else (0.0,) * 9
            self._covariance_in = covariance
        return self._covariance


def _is_wanted(publisher: Publisher) -> bool:
    return bool(publisher.get_subscription_count())
