"""The outputs of a field message: the corrected field, and the yaw."""

from __future__ import annotations

import importlib
from typing import Any

import numpy as np
from builtin_interfaces.msg import Time
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import Imu, MagneticField
from std_msgs.msg import Float64

from magcal_ros.core.calibration.calibration import Calibration
from magcal_ros.core.geometry.attitude import true_yaw
from magcal_ros.core.geometry.vec3 import Triple
from magcal_ros.core.heading.compass import Compass, Moment
from magcal_ros.core.heading.disturbance import FieldDoubt
from magcal_ros.core.knowledge import ReferenceField
from magcal_ros.files.plain import plain
from magcal_ros.ros.sensor_frames import SensorFrames
from magcal_ros.ros.wire.incoming import FieldArrival
from magcal_ros.ros.wire.outgoing import (
    AttitudeTemplate,
    FieldTemplate,
    NumberTemplate,
    azimuth_message,
    bias_message,
)

LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
RELIABLE = QoSProfile(depth=10)


class FieldOutput:
    """Publishes the corrected field of one magnetometer, and its bias."""

    def __init__(self, node: Node, topic: str) -> None:
        self._field_out = node.create_publisher(MagneticField, f"{topic}_unbiased", RELIABLE)
        self._bias_out = node.create_publisher(MagneticField, f"{topic}_bias", LATCHED)
        self._field = FieldTemplate()
        self._covariance_in = b""
        self._covariance: tuple[float, ...] = ()
        self._bias: MagneticField | None = None
        self._compass: Compass | None = None

    def put_in_force(self, compass: Compass | None, magnetometer_frame: str = "") -> None:
        """Use a compass from the next message on; None stops the outputs."""
        self._compass = compass
        self._covariance_in = b""
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

    def publish(self, field: Triple, arrived: FieldArrival, frame: str) -> None:
        """Publish a corrected field, tesla, in the IMU's frame."""
        if _is_wanted(self._field_out):
            covariance = self._carried(arrived.covariance)
            self._field_out.publish(self._field.fill(arrived.stamp, frame, field, covariance))

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


class HeadingOutput:
    """Publishes the heading that follows from each field message.

    What nobody listens to is not filled in.
    """

    def __init__(self, node: Node, frames: SensorFrames) -> None:
        self._node, self._frames = node, frames
        self._magnetic_out = node.create_publisher(Imu, "compass/mag/enu/imu", RELIABLE)
        self._true_out = node.create_publisher(Imu, "compass/true/enu/imu", RELIABLE)
        self._yaw_out = node.create_publisher(Float64, "compass/yaw", RELIABLE)
        self._azimuth = azimuth_type()
        self._azimuth_outs: dict[str, Publisher] = {}
        if self._azimuth is not None:
            self._azimuth_outs = {
                north: node.create_publisher(self._azimuth, f"compass/{north}/enu/rad", RELIABLE)
                for north in ("mag", "true")
            }
        self._attitude = AttitudeTemplate()
        self._yaw = NumberTemplate()
        self._doubt: FieldDoubt | None = None
        self.moment: Moment | None = None
        """The newest field message under the calibration in force, its yaw as uncertain as told."""

    def rivals(self) -> str:
        """Say that another node publishes the same heading; empty if none does."""
        topic = self._yaw_out.topic_name
        if self._node.count_publishers(topic) < 2:
            return ""
        infos = self._node.get_publishers_info_by_topic(topic)
        names = [f"{info.node_namespace.rstrip('/')}/{info.node_name}" for info in infos]
        own = self._node.get_fully_qualified_name()
        others = {plain(name) for name in names if name != own} or {"a node of the same name"}
        return (
            f"{topic} is published by {' and '.join(sorted(others))} too, and the headings of both "
            "are mixed there. For two magnetometers start one node and remap imu/mag_2 to the "
            "second (-r imu/mag_2:=...); for two robots give each a namespace (-r __ns:=/robot2)"
        )

    def begin_anew(self, calibration: Calibration | None) -> None:
        """Forget what came before: another calibration is in force, or none."""
        self._doubt = None if calibration is None else FieldDoubt(calibration)
        self.moment = None

    def publish(self, moment: Moment, stamp: bytes, frame: str, reference: ReferenceField) -> None:
        """Publish everything that follows from one field message."""
        moment, declination = self._doubted(moment), reference.declination
        self.moment = moment
        view = self._frames.view
        if moment.heading is None or view is None:
            return
        frame, heading = self._frames.frame(frame), view.heading(moment.heading)
        if _is_wanted(self._magnetic_out):
            self._magnetic_out.publish(self._attitude.fill(stamp, frame, heading))
        if declination is not None and _is_wanted(self._true_out):
            sigma = reference.declination_sigma
            filled = self._attitude.fill(stamp, frame, heading, declination, sigma)
            self._true_out.publish(filled)
        if _is_wanted(self._yaw_out):
            self._yaw_out.publish(self._yaw.fill(true_yaw(heading.yaw, declination or 0.0)))
        for north, out in self._azimuth_outs.items():
            known = None if north == "mag" else reference
            if _is_wanted(out) and (known is None or declination is not None):
                out.publish(azimuth_message(self._azimuth, stamp, frame, heading, known))

    def _doubted(self, moment: Moment) -> Moment:
        """Return the moment with a yaw that is as uncertain as its field is wrong."""
        heading, up = moment.heading, moment.up
        if heading is None or up is None or self._doubt is None:
            return moment
        more = self._doubt.add(moment.stamp, moment.field, up.direction, up.variance)
        variance = heading.yaw_variance + more
        return moment._replace(heading=heading._replace(yaw_variance=variance))


def azimuth_type() -> Any:
    """Return compass_interfaces/msg/Azimuth; None where that package is not installed."""
    try:
        return importlib.import_module("compass_interfaces.msg").Azimuth
    except ImportError:
        return None


def _is_wanted(publisher: Publisher) -> bool:
    return bool(publisher.get_subscription_count())
