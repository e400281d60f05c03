"""The gyro-aided yaw as a topic: propagated at the IMU's rate, corrected at the field's."""

from __future__ import annotations

import math

from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.node import Node
from sensor_msgs.msg import Imu

from magcal_ros.core.calibration.calibration import Calibration
from magcal_ros.core.heading.compass import Moment
from magcal_ros.core.heading.disturbance import PATIENCE, Trust
from magcal_ros.core.heading.fused_yaw import FusedYaw
from magcal_ros.core.knowledge import ReferenceField
from magcal_ros.core.up import UpFollower
from magcal_ros.ros.outputs import RELIABLE
from magcal_ros.ros.sensor_frames import SensorFrames
from magcal_ros.ros.wire.outgoing import AttitudeTemplate, diagnostic, key_values

TOPIC = "compass/fused/enu/imu"


class FusedOutput:
    """Publishes the fused yaw while a calibration is in force and somebody listens."""

    def __init__(self, node: Node, follower: UpFollower, frames: SensorFrames) -> None:
        self._frames = frames
        self.patience = PATIENCE
        self.is_needed = False
        """Whether the yaw is propagated although nobody listens."""
        self._out = node.create_publisher(Imu, TOPIC, RELIABLE)
        self._follower = follower
        self._calibration: Calibration | None = None
        self._attitude = AttitudeTemplate()
        self._fused: FusedYaw | None = None

    def begin_anew(self, calibration: Calibration | None) -> None:
        """Forget the yaw: another calibration is in force, or none.

        While two antennas tell it, no compass is needed to know it.
        """
        self._calibration = calibration
        if calibration is not None and self._fused is not None and self._fused.is_told:
            self._fused.use(calibration, self.patience)
        else:
            self._fused = None

    def on_imu(self, seconds: float, stamp: bytes, frame: str, reference: ReferenceField) -> None:
        """Propagate the yaw to an IMU message, and publish it there."""
        if self._calibration is None:
            return
        is_heard = bool(self._out.get_subscription_count())
        if not (is_heard or self.is_needed):
            self._fused = None
            return
        if self._fused is None:
            self._fused = FusedYaw(self._calibration, self.patience)
        fused, up = self._fused, self._follower.at(seconds, 0.0)
        if up is None or not self._follower.is_propagated:
            fused.restart()
            return
        follower = self._follower
        fused.propagate(seconds, up, follower.mean_rate, follower.gyro_bias, follower.is_at_rest)
        if not is_heard:
            return
        heading, view = fused.heading(), self._frames.view
        if heading is not None and view is not None:
            declination = reference.declination
            sigma = 0.0 if declination is None else reference.declination_sigma
            seen, frame = view.heading(heading), self._frames.frame(frame)
            message = self._attitude.fill(stamp, frame, seen, declination or 0.0, sigma)
            self._out.publish(message)

    def on_field(self, moment: Moment) -> None:
        """Let a field message correct the yaw."""
        if self._fused is None or not self._follower.is_propagated:
            return
        if moment.up is not None and moment.heading is not None:
            self._fused.detector.patience = self.patience
            self._fused.correct(moment.stamp, moment.field, moment.up, moment.heading)

    @property
    def yaw(self) -> FusedYaw | None:
        """The yaw that is propagated; None while none is."""
        return self._fused

    def diagnostic(self, name: str) -> DiagnosticStatus:
        """Say whether the yaw is published, and whether the field is believed."""
        status = diagnostic(name, "Fused")
        status.message = self._silence()
        if status.message:
            if self._fused is not None:
                status.level = DiagnosticStatus.WARN
            return status
        assert self._fused is not None
        detector, heading = self._fused.detector, self._fused.heading()
        departure = f"{detector.departure:.1f} sigma"
        values = {"field": detector.trust.value, "field departure": departure}
        status.message = "the compass corrects the gyro"
        if detector.last is not None:
            values["last disturbance"] = detector.last.in_words
        if detector.trust is not Trust.GOOD:
            status.level = DiagnosticStatus.WARN
            status.message = f"the field is not the calibrated one and {detector.trust.value}"
            if detector.trust is Trust.IGNORED and detector.last is not None:
                status.message += f": {detector.last.in_words}; the gyro alone propagates the yaw"
        if heading is not None:
            values["yaw"] = f"{math.degrees(heading.yaw):.1f}° (ENU, magnetic)"
            values["yaw sigma"] = f"{math.degrees(math.sqrt(heading.yaw_variance)):.2f}°"
        status.values = key_values(values)
        return status

    def _silence(self) -> str:
        """Say why nothing is published; empty if something is."""
        if self._calibration is None:
            return "no fused yaw before a calibration is in force"
        if self._fused is None or not self._out.get_subscription_count():
            return f"nobody listens to {TOPIC}"
        if not self._follower.gyro_is_believed:
            return (
                f"nothing on {TOPIC}: the gyro turns against the accelerometer; "
                "its axes or its sign are wrong in the driver"
            )
        if not self._follower.gyro_is_whole:
            return (
                f"nothing on {TOPIC}: axes of the gyro never change; the driver does not read them"
            )
        if not self._follower.is_propagated:
            return f"nothing on {TOPIC}: the IMU has no gyro"
        if self._fused.heading() is None:
            return f"nothing on {TOPIC} yet: no field has come"
        return ""
