"""The gyro-aided yaw as a topic: carried at the IMU's rate, corrected at the field's."""

from __future__ import annotations

import math

from diagnostic_msgs.msg import DiagnosticStatus, KeyValue
from rclpy.node import Node
from sensor_msgs.msg import Imu

from magcal_ros.core.field_watch import PATIENCE, Trust
from magcal_ros.core.fusion import FusedYaw
from magcal_ros.core.knowledge import ReferenceField
from magcal_ros.core.up import Up, UpFollower
from magcal_ros.ros.outputs import RELIABLE, Outputs
from magcal_ros.ros.wire.outgoing import AttitudeTemplate

TOPIC = "compass/fused/enu/imu"


class FusedOutput:
    """Publishes the fused yaw while a calibration is in force and somebody listens.

    Parameters
    ----------
    node : rclpy.node.Node
        Where the publisher lives.
    follower : UpFollower
        Has taken each IMU message before it comes here.
    outputs : Outputs
        Has the compass in force, and what it made of the newest field message.
    """

    def __init__(self, node: Node, follower: UpFollower, outputs: Outputs) -> None:
        self.patience = PATIENCE
        self._out = node.create_publisher(Imu, TOPIC, RELIABLE)
        self._follower, self._outputs = follower, outputs
        self._attitude = AttitudeTemplate()
        self._fused: FusedYaw | None = None

    def begin_anew(self) -> None:
        """Forget the yaw: another calibration is in force, or none."""
        self._fused = None

    def on_imu(self, seconds: float, stamp: bytes, frame: str, reference: ReferenceField) -> None:
        """Carry the yaw to an IMU message, and publish it there.

        Parameters
        ----------
        seconds, stamp : float, bytes
            The message's stamp, as a number and as it came.
        frame : str
            The IMU's frame.
        reference : ReferenceField
            Without a declination the yaw is to magnetic north, else to true north.
        """
        compass = self._outputs.compass
        if compass is None:
            return
        if not self._out.get_subscription_count():
            self._fused = None
            return
        if self._fused is None:
            self._fused = FusedYaw(compass.calibration, self.patience)
        fused, up = self._fused, self._follower.at(seconds, 0.0)
        if up is None or not self._follower.is_carried:
            fused.restart()
            return
        fused.carry(seconds, up, self._follower.mean_rate)
        heading = fused.heading()
        if heading is not None:
            declination = reference.declination
            sigma = 0.0 if declination is None else reference.declination_sigma
            message = self._attitude.fill(stamp, frame, heading, declination or 0.0, sigma)
            self._out.publish(message)

    def on_field(self, seconds: float, up: Up | None) -> None:
        """Let the newest field message, stamped so many seconds, correct the yaw."""
        if self._fused is None or up is None or not self._follower.is_carried:
            return
        field, heading = self._outputs.last_field, self._outputs.last_heading
        if field is not None and heading is not None:
            self._fused.watch.patience = self.patience
            self._fused.correct(seconds, field, up, heading)

    def diagnostic(self, name: str) -> DiagnosticStatus:
        """Say whether the yaw is carried, and whether the field is believed."""
        status = DiagnosticStatus(name=f"{name}: Fused", hardware_id="magnetometer")
        status.level = DiagnosticStatus.OK
        status.message = self._silence()
        if status.message:
            if self._fused is not None:
                status.level = DiagnosticStatus.WARN
            return status
        assert self._fused is not None
        watch, heading = self._fused.watch, self._fused.heading()
        values = {"field": watch.trust.value, "field departure": f"{watch.departure:.1f} sigma"}
        status.message = "the compass corrects the gyro"
        if watch.last is not None:
            values["last disturbance"] = watch.last.in_words
        if watch.trust is not Trust.GOOD:
            status.level = DiagnosticStatus.WARN
            status.message = f"the field is not the calibrated one and {watch.trust.value}"
            if watch.trust is Trust.IGNORED and watch.last is not None:
                status.message += f": {watch.last.in_words}; the gyro alone carries the yaw"
        if heading is not None:
            values["yaw"] = f"{math.degrees(heading.yaw):.1f}° (ENU, magnetic)"
            values["yaw sigma"] = f"{math.degrees(math.sqrt(heading.yaw_variance)):.2f}°"
        status.values = [KeyValue(key=key, value=value) for key, value in values.items()]
        return status

    def _silence(self) -> str:
        """Say why nothing is published; empty if something is."""
        if self._outputs.compass is None:
            return "no fused yaw before a calibration is in force"
        if self._fused is None:
            return f"nobody listens to {TOPIC}"
        if not self._follower.gyro_is_believed:
            return (
                f"nothing on {TOPIC}: the gyro turns against the accelerometer; "
                "its axes or its sign are wrong in the driver"
            )
        if not self._follower.is_carried:
            return f"nothing on {TOPIC}: the IMU has no gyro"
        if self._fused.heading() is None:
            return f"nothing on {TOPIC} yet: no field has come"
        return ""
