"""The publishers of corrected fields, headings and markers."""

from __future__ import annotations

import contextlib
from functools import lru_cache, partial
from typing import Any

import numpy as np
from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import Point
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile
from sensor_msgs.msg import Imu, MagneticField
from std_msgs.msg import ColorRGBA, Float64
from visualization_msgs.msg import Marker, MarkerArray

from magcal_ros.core.calibration.calibration import Calibration, Estimate
from magcal_ros.core.calibration.correction import Correction
from magcal_ros.core.errors import Refusal
from magcal_ros.core.geometry.arrays import FloatArray
from magcal_ros.core.geometry.attitude import true_yaw, unit
from magcal_ros.core.geometry.shapes import Circle, fit_circle_in_space
from magcal_ros.core.geometry.vec3 import Triple
from magcal_ros.core.heading.compass import Compass, CompassReading, Heading
from magcal_ros.core.heading.disturbance import PATIENCE, FieldDeviation, FieldUse
from magcal_ros.core.heading.fused_yaw import FusedYaw
from magcal_ros.core.knowledge import ReferenceField
from magcal_ros.core.samples.coverage import Coverage
from magcal_ros.core.samples.samples_tuning import STREAMS
from magcal_ros.core.samples.window import Window
from magcal_ros.core.session.turn_machine import TurnMachine, TurnState
from magcal_ros.core.up.follower import UpFollower
from magcal_ros.files.disk import printable
from magcal_ros.files.wire import FieldArrival
from magcal_ros.ros import wire
from magcal_ros.ros.sensor_frames import LATCHED, SensorFrames

RELIABLE = QoSProfile(depth=10)


class FieldOutput:
    """Publishes the corrected field of one magnetometer, and its bias."""

    def __init__(self, node: Node, topic: str) -> None:
        self._field_out = node.create_publisher(MagneticField, f"{topic}_unbiased", RELIABLE)
        self._bias_out = node.create_publisher(MagneticField, f"{topic}_bias", LATCHED)
        self._field = wire.field_template()
        self._bias: MagneticField | None = None

    def put_in_force(self, compass: Compass | None, magnetometer_frame: str = "") -> None:
        """Use a compass from the next message on; None stops the outputs."""
        self._bias = None
        if compass is not None:
            correction = compass.calibration.correction
            # Cached, because drivers send the same covariance with every message.
            self._rotated = lru_cache(maxsize=1)(partial(_rotated, correction))
            self._bias = wire.bias_message(correction, magnetometer_frame)
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
            covariance = self._rotated(arrived.covariance)
            self._field_out.publish(self._field.fill(arrived.stamp, frame, field + covariance))


def _rotated(correction: Correction, covariance: bytes) -> tuple[float, ...]:
    """Return a message's covariance in body axes."""
    sigma = np.frombuffer(covariance, "<f8").reshape(3, 3)
    with np.errstate(over="ignore", invalid="ignore"):
        rotated = correction.covariance(sigma)
    # By convention, zeros mean an unknown covariance; some drivers send -1 for it.
    is_known = np.isfinite(rotated).all() and (np.diag(sigma) >= 0.0).all()
    return tuple(rotated.ravel().tolist()) if is_known else (0.0,) * 9


class AttitudeOutput:
    """Publishes the attitude of the base, and with a type `azimuth` its yaw in that type.

    Nothing is published on a topic without a subscription.
    """

    def __init__(self, node: Node, topic: str, azimuth: Any = None) -> None:
        self._out = node.create_publisher(Imu, f"{topic}/imu", RELIABLE)
        self._attitude = wire.attitude_template()
        self._azimuth, self._azimuth_out = azimuth, None
        if azimuth is not None:
            self._azimuth_out = node.create_publisher(azimuth, f"{topic}/rad", RELIABLE)

    @property
    def is_wanted(self) -> bool:
        """Whether something subscribes to the attitude."""
        return _is_wanted(self._out)

    def publish(
        self, stamp: bytes, frame: str, heading: Heading, reference: ReferenceField | None = None
    ) -> None:
        """Publish a heading; it refers to true north if a reference field is given."""
        if self.is_wanted:
            declination, variance = 0.0, 0.0
            if reference is not None and reference.declination is not None:
                declination, variance = reference.declination, reference.declination_sigma**2
            numbers = heading.quaternion(declination) + heading.covariance(variance)
            self._out.publish(self._attitude.fill(stamp, frame, numbers))
        if self._azimuth_out is not None and _is_wanted(self._azimuth_out):
            message = wire.azimuth_message(self._azimuth, stamp, frame, heading, reference)
            self._azimuth_out.publish(message)


NO_DECLINATION = (
    "compass/true/enu/imu has a subscriber, but nothing is published there: the declination is "
    "not known. Give reference.latitude_deg and reference.longitude_deg, or a fix on gps/fix"
)


class HeadingOutput:
    """Publishes the heading of each field message on the topics that have a subscription."""

    def __init__(self, node: Node, frames: SensorFrames) -> None:
        self._node, self._frames = node, frames
        self._yaw_out = node.create_publisher(Float64, "compass/yaw", RELIABLE)
        norths = "compass/mag/enu", "compass/true/enu"
        azimuth = wire.optional_type("compass_interfaces", "Azimuth")
        self._magnetic, self._true = (AttitudeOutput(node, north, azimuth) for north in norths)
        self._deviation: FieldDeviation | None = None
        self.reading: CompassReading | None = None
        """Result of the newest field message with the calibration in force, None before it."""

    @property
    def field_is_good(self) -> bool:
        """Whether strength and inclination of the newest field are the calibrated ones."""
        return self._deviation is not None and self._deviation.use is FieldUse.GOOD

    def complaints(self, reference: ReferenceField) -> list[str]:
        """Return warnings for subscribers of the heading."""
        found = []
        is_silent = self.reading is not None and reference.declination is None
        if is_silent and self._true.is_wanted:
            found.append(NO_DECLINATION)
        if self._node.count_publishers(self._yaw_out.topic_name) > 1:
            found.append(self._other_publishers())
        return found

    def _other_publishers(self) -> str:
        topic = self._yaw_out.topic_name
        infos = self._node.get_publishers_info_by_topic(topic)
        names = [f"{info.node_namespace.rstrip('/')}/{info.node_name}" for info in infos]
        own = self._node.get_fully_qualified_name()
        others = {printable(name) for name in names if name != own} or {"a node of the same name"}
        return (
            f"{topic} is also published by {' and '.join(sorted(others))}, so two headings are "
            "mixed there. For two magnetometers start one node and remap imu/mag_2 to the second "
            "(-r imu/mag_2:=...); for two robots give each a namespace (-r __ns:=/robot2)"
        )

    def begin_anew(self, calibration: Calibration | None) -> None:
        """Start again with another calibration, or with none."""
        self._deviation = None if calibration is None else FieldDeviation(calibration)
        self.reading = None

    def publish(
        self, reading: CompassReading, stamp: bytes, frame: str, reference: ReferenceField
    ) -> None:
        """Publish the heading of one field message on all its topics."""
        reading, declination = self._with_uncertainty(reading), reference.declination
        self.reading = reading
        view = self._frames.view
        if reading.heading is None or view is None:
            return
        frame, heading = self._frames.frame(frame), view.heading(reading.heading)
        if _is_wanted(self._yaw_out):
            self._yaw_out.publish(Float64(data=true_yaw(heading.yaw, declination or 0.0)))
        self._magnetic.publish(stamp, frame, heading)
        if declination is not None:
            self._true.publish(stamp, frame, heading, reference)

    def _with_uncertainty(self, reading: CompassReading) -> CompassReading:
        """Return the reading with a larger yaw variance if its field is disturbed."""
        heading, up = reading.heading, reading.up
        if heading is None or up is None or self._deviation is None:
            return reading
        more = self._deviation.add(reading.stamp, reading.field, up.direction, up.variance)
        variance = heading.yaw_variance + more
        return reading._replace(heading=heading._replace(yaw_variance=variance))


def _is_wanted(publisher: Publisher) -> bool:
    return bool(publisher.get_subscription_count())


TOPIC = "compass/fused/enu"


class FusedOutput:
    """Publishes the fused yaw while a calibration is in force and something subscribes."""

    def __init__(self, node: Node, follower: UpFollower, frames: SensorFrames) -> None:
        self._frames = frames
        self.patience = PATIENCE
        self.is_needed = False
        """Whether the yaw is propagated even without a subscription."""
        self._out = AttitudeOutput(node, TOPIC)
        self._follower = follower
        self._calibration: Calibration | None = None
        self.yaw: FusedYaw | None = None
        """The yaw filter; None while it does not run."""

    def begin_anew(self, calibration: Calibration | None) -> None:
        """Start again with another calibration, or with none.

        A yaw that is measured by another device is kept.
        """
        self._calibration = calibration
        if calibration is not None and self.yaw is not None and self.yaw.has_external_yaw:
            self.yaw.use(calibration, self.patience)
        else:
            self.forget()

    def forget(self) -> None:
        """Start again from the compass."""
        self.yaw = None

    def on_imu(self, seconds: float, stamp: bytes, frame: str, reference: ReferenceField) -> None:
        """Propagate the yaw to an IMU message, and publish it."""
        if self._calibration is None:
            return
        if not (self._out.is_wanted or self.is_needed):
            self.yaw = None
            return
        if self.yaw is None:
            self.yaw = FusedYaw(self._calibration, self.patience)
        self.yaw.propagate_by(seconds, self._follower)
        heading, view = self.yaw.heading(), self._frames.view
        if heading is not None and view is not None:
            seen, frame = view.heading(heading), self._frames.frame(frame)
            self._out.publish(stamp, frame, seen, reference)

    def on_field(self, reading: CompassReading) -> None:
        """Correct the yaw by a field message."""
        if self.yaw is not None and self._follower.is_propagated:
            self.yaw.detector.patience = self.patience
            self.yaw.correct(reading)

    def diagnostic(self) -> DiagnosticStatus:
        """Return the diagnostic of the fused yaw: its output and the state of the field."""
        silence, level = self._silence(), DiagnosticStatus.OK
        if silence:
            level = level if self.yaw is None else DiagnosticStatus.WARN
            return wire.diagnostic("Fused", silence, level=level)
        assert self.yaw is not None
        detector, heading = self.yaw.detector, self.yaw.heading()
        deviation = f"{detector.deviation:.1f} sigma"
        values = {"field": detector.use.value, "field departure": deviation}
        message = "the compass corrects the gyro"
        if detector.last is not None:
            values["last disturbance"] = detector.last.in_words
        if detector.use is not FieldUse.GOOD:
            level = DiagnosticStatus.WARN
            message = f"the field differs from the calibrated one and {detector.use.value}"
            if detector.use is FieldUse.IGNORED and detector.last is not None:
                message += f": {detector.last.in_words}; the gyro alone propagates the yaw"
        elif self.yaw.field_jump is not None and self.yaw.is_ambiguous:
            level = DiagnosticStatus.WARN
            message = self.yaw.field_jump.in_words
        values |= wire.yaw_values(heading)
        return wire.diagnostic("Fused", message, values, level)

    def _silence(self) -> str:
        """Return why nothing is published; empty if the yaw is published."""
        if self._calibration is None:
            return "no fused yaw before a calibration is in force"
        if self.yaw is None or not self._out.is_wanted:
            return f"nothing subscribes to {TOPIC}/imu"
        if not self._follower.gyro_is_consistent:
            why = (
                ": gyro and accelerometer contradict each other; correct the gyro's axes or signs "
                "in the driver"
            )
        elif self._follower.is_propagated:
            longest = STREAMS.longest_gyro_step
            why = f" yet: no field has come with a stamp within {longest:g} s of the IMU's"
            if self._frames.view is None:
                why = ": the pose of the IMU in base_frame is not known"
            elif self.yaw.heading() is not None:
                why = ""
        elif self._follower.gyro_is_whole:
            why = ": the IMU has no gyro"
        else:
            why = ": some axes of the gyro never change; the driver does not read them"
        return f"nothing on {TOPIC}/imu{why}" if why else ""


METRES_PER_TESLA = 1.0 / 50e-6
MOST_POINTS = 400
SMALLEST_GAP = np.radians(12.0)
POINT_SIZE = 0.02
LINE_WIDTH = 0.01

RAW = (0.90, 0.38, 0.0)
CORRECTED = (0.0, 0.45, 0.70)
CIRCLE = (0.35, 0.70, 0.90)
MISSING = (0.80, 0.10, 0.10)
AXIS = (0.3, 0.3, 0.3)


class TurnMarkers:
    """Publishes the markers of a turn, once for each window of samples."""

    def __init__(self, node: Node) -> None:
        self._out = node.create_publisher(MarkerArray, "~/markers", LATCHED)
        self._drawn: Window | None = None

    def draw(self, turn: TurnMachine, to_body: FloatArray, frame: str) -> None:
        """Draw the newest window; during a turn each preview has a new window."""
        window = turn.last_window
        if window is None or window is self._drawn:
            return
        idle, outcome = turn.state is TurnState.IDLE, turn.last_outcome
        if not idle and not self._out.get_subscription_count():
            return
        if idle or turn.state is TurnState.COLLECTING:
            estimate = outcome.estimate if idle and outcome is not None else None
            self._out.publish(turn_markers(window, to_body, estimate, frame))
            self._drawn = window


def turn_markers(
    window: Window, to_body: FloatArray, estimate: Estimate | None, frame: str
) -> MarkerArray:
    """Return the markers of a turn, fitted if there is an estimate; they replace earlier ones.

    `to_body` (3, 3) rotates the magnetometer's axes to nominal body axes. `frame` is the IMU's.
    """
    every = max(1, len(window) // MOST_POINTS)
    shown = window.field @ to_body.T
    up, size = unit(window.specific_force.mean(axis=0)), (POINT_SIZE, POINT_SIZE)
    drawn = [_marker("raw", Marker.POINTS, RAW, shown[::every], *size)]
    if estimate is not None:
        shown, up = estimate.correction.apply(window.field), estimate.axis
        drawn.append(_marker("corrected", Marker.POINTS, CORRECTED, shown[::every], *size))
    # There is no circle before the robot has turned.
    with contextlib.suppress(Refusal):
        drawn += _circle(fit_circle_in_space(shown, up), shown)
    ends = np.stack([np.zeros(3), up]) / METRES_PER_TESLA
    drawn.append(_marker("axis", Marker.ARROW, AXIS, ends, 0.02, 0.05))
    array = MarkerArray(markers=[Marker(action=Marker.DELETEALL), *drawn])
    for marker in array.markers:
        marker.header.frame_id = frame
    return array


def _circle(circle: Circle, points: FloatArray) -> list[Marker]:
    around = np.linspace(0.0, 2.0 * np.pi, 73)
    drawn = [_marker("circle", Marker.LINE_STRIP, CIRCLE, circle.at(around), LINE_WIDTH)]
    seen = Coverage.of(circle.phase(points))
    if seen.gap > SMALLEST_GAP:
        hole = seen.gap_centre + seen.gap * np.linspace(-0.5, 0.5, 37)
        width = 3.0 * LINE_WIDTH
        drawn.append(_marker("missing", Marker.LINE_STRIP, MISSING, circle.at(hole), width))
    return drawn


def _marker(name: str, kind: int, colour: Triple, field: FloatArray, *scale: float) -> Marker:
    """Return a marker with points of the field; the meaning of `scale` depends on the kind."""
    marker = Marker(ns=name, type=kind, action=Marker.ADD)
    marker.pose.orientation.w = 1.0
    marker.scale.x, marker.scale.y = (*scale, 0.0)[:2]
    red, green, blue = colour
    marker.color = ColorRGBA(r=red, g=green, b=blue, a=1.0)
    marker.points = [Point(x=x, y=y, z=z) for x, y, z in (field * METRES_PER_TESLA).tolist()]
    return marker
