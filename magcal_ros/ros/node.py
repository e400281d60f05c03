"""The calibrator node: topics in, one turn, a compass out."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.executors import Executor
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import Imu, MagneticField
from std_msgs.msg import String
from visualization_msgs.msg import MarkerArray

from magcal_ros.core.calibrate import Outcome
from magcal_ros.core.calibration import Calibration
from magcal_ros.core.streams import Drop, Streams
from magcal_ros.core.up import Up, UpFollower
from magcal_ros.core.watch import Watch
from magcal_ros.core.window import Window
from magcal_ros.files.atomic import FileTrouble
from magcal_ros.files.calibration_file import Origin
from magcal_ros.files.places import is_missing, known_as
from magcal_ros.ros.control import Conclusion, Control, State
from magcal_ros.ros.fused import FusedOutput
from magcal_ros.ros.inputs import Inputs, Sensor
from magcal_ros.ros.keeper import Keeper, require_sensor
from magcal_ros.ros.markers import turn_markers
from magcal_ros.ros.outputs import LATCHED, RELIABLE, Outputs
from magcal_ros.ros.parameters import Parameters
from magcal_ros.ros.reporter import Reporter, now
from magcal_ros.ros.rotator import Rotator
from magcal_ros.ros.services import Services
from magcal_ros.ros.settings import Settings
from magcal_ros.ros.status import (
    calibration_diagnostic,
    field_diagnostic,
    inputs_diagnostic,
    status_json,
    watch_diagnostic,
)
from magcal_ros.ros.straight import executor_for
from magcal_ros.ros.whereabouts import Whereabouts
from magcal_ros.ros.wire.incoming import Unreadable, read_field, read_imu

TICK = 0.1
"""Seconds between looks at a turn under way; at rest nothing ticks."""

SENSOR_DATA = QoSProfile(depth=100, reliability=ReliabilityPolicy.BEST_EFFORT)
"""Matches every publisher. The usual depth of 5 loses messages of a fast IMU whenever the machine
is busy for some milliseconds, and the gyro's path with them."""

HEARTBEAT = 1.0
"""Seconds between diagnostics, and between repetitions of the bias."""


class Calibrator(Node):
    """Calibrates a magnetometer from one turn and publishes what it measures from then on.

    Parameters
    ----------
    **kwargs
        Passed on to `rclpy.node.Node`.
    """

    def __init__(self, **kwargs: Any) -> None:
        super().__init__("calibrator", **kwargs)
        self._status = ""
        self._up = UpFollower()
        self._watch: Watch | None = None
        self._table = Parameters(self)
        self._whereabouts = Whereabouts(self, self._table)
        self._outputs = Outputs(self)
        self._fused = FusedOutput(self, self._up, self._outputs)
        self._keeper = Keeper(self.get_namespace(), self._apply)
        streams = Streams(self._table.settings.max_gap)
        self._inputs = Inputs(self._sensor("imu/data_raw"), self._sensor("imu/mag"), streams)
        self._reporter = Reporter(self.get_logger().error)
        self._control = Control(
            streams,
            self._put_in_force,
            self._describe_silence,
            self._begin_report,
            self._sensors,
        )
        self._rotator = Rotator(
            self,
            self._control,
            (self._inputs.imu, self._inputs.field),
            lambda: self._table.settings,
        )
        self._status_out = self.create_publisher(String, "~/status", LATCHED)
        self._diagnostics_out = self.create_publisher(DiagnosticArray, "/diagnostics", RELIABLE)
        self._markers_out = self.create_publisher(MarkerArray, "~/markers", LATCHED)
        self._drawn: Window | None = None
        short = {"accept": self._accept, "save": self._save, "load": self._load}
        Services(self, self._control, self._start, {**short, "reset": self._reset})
        self._sensor_subscriptions = (
            self.create_subscription(Imu, "imu/data_raw", self._on_imu, SENSOR_DATA, raw=True),
            self.create_subscription(
                MagneticField, "imu/mag", self._on_field, SENSOR_DATA, raw=True
            ),
        )
        # Deadlines and heartbeats go on while simulated time stands still.
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self._tick = self.create_timer(TICK, self._on_tick, clock=steady, autostart=False)
        self.create_timer(HEARTBEAT, self._on_heartbeat, clock=steady)
        if self._table.settings.calibration_file:
            self._load_at_start()
        self._publish_status()

    def close(self) -> None:
        """Drop a turn under way; a calibration is on disk since the moment it was accepted."""
        self.stop_robot()
        self._control.shut_down()

    def stop_robot(self) -> None:
        """Stop a robot that turns itself, from any thread; it will not move again."""
        self._rotator.halt()

    def executor_of_its_own(self) -> Executor:
        """Return an executor that serves this node, its sensors before all."""
        return executor_for(self, self._sensor_subscriptions)

    def _on_imu(self, data: bytes) -> None:
        streams = self._inputs.streams
        try:
            frame, sample, stamp = read_imu(data)
        except Unreadable:
            streams.imu_drops[Drop.UNREADABLE] += 1
            return
        self._inputs.imu.heard(frame)
        if sample is None:
            streams.imu_drops[Drop.ABSENT] += 1
        elif streams.add_imu(sample):
            self._up.add(sample)
            reference = self._whereabouts.reference.field
            self._fused.on_imu(sample.stamp, stamp, self._body_frame(), reference)

    def _on_field(self, data: bytes) -> None:
        streams = self._inputs.streams
        try:
            arrived = read_field(data)
        except Unreadable:
            streams.field_drops[Drop.UNREADABLE] += 1
            return
        # A driver may leave out the frame at first: the sensor is known when it has a name.
        before = self._inputs.field.frame if self._inputs.field.messages else None
        self._inputs.field.heard(arrived.frame)
        if not before and before != arrived.frame:
            self._meet_sensor()
        sample = arrived.sample
        if not streams.add_field(sample):
            return
        if self._outputs.compass is not None:
            reference = self._whereabouts.reference.field
            up = self._up.at(sample.stamp, streams.max_gap)
            self._outputs.publish(arrived, up, self._body_frame(), reference)
            self._fused.on_field(sample.stamp, up)
            self._look_on(sample.stamp, up)
        if not streams.is_repeated:
            self._control.add(sample)

    def _look_on(self, stamp: float, up: Up | None) -> None:
        field, heading = self._outputs.last_field, self._outputs.last_heading
        if self._watch is not None and up is not None and field is not None:
            rate = self._inputs.streams.newest_rate
            if heading is not None and rate is not None:
                self._watch.add(stamp, field, up.direction, heading.yaw, rate)

    def _sensor(self, topic: str) -> Sensor:
        return Sensor(self.resolve_topic_name(topic))

    def _sensors(self) -> str:
        return f"{self._inputs.field.frame} {self._inputs.imu.frame}"

    def _body_frame(self) -> str:
        heard = self._inputs.imu.frame
        return heard or (self._keeper.origin.imu_frame if self._keeper.origin else "")

    def _meet_sensor(self) -> None:
        """Load the sensor's own file, or check that the loaded one is its own."""
        frame = self._inputs.field.frame
        if self._keeper.calibration is None:
            self._load_at_start()
            return
        try:
            assert self._keeper.origin is not None
            path = self._keeper.path(self._table.settings.calibration_file, frame)
            assert path is not None
            require_sensor(path, self._keeper.origin, frame)
        except FileTrouble as error:
            self._keeper.reset()
            self._keeper.trouble = str(error)
            self.get_logger().error(str(error))

    def _load_at_start(self) -> None:
        frame = self._inputs.field.frame
        try:
            path = self._keeper.path(self._table.settings.calibration_file, frame)
            if path is None or is_missing(path):
                return
            self.get_logger().info(self._keeper.load(path, frame))
        except FileTrouble as error:
            self.get_logger().error(f"{error} Running uncalibrated.")

    def _start(self) -> Conclusion:
        opened = self._rotator.begin(self._whereabouts.settings)
        if opened.success:
            self._tick.reset()
            self._publish_status()
        return opened

    def _apply(self, calibration: Calibration | None, magnetometer_frame: str) -> None:
        self._outputs.put_in_force(calibration, magnetometer_frame)
        self._fused.begin_anew()
        self._watch = None if calibration is None else Watch(calibration)
        self._whereabouts.use(calibration)
        self._publish_status()

    def _put_in_force(self, calibration: Calibration) -> Callable[[], str]:
        origin = Origin.now(self._inputs.field.frame, self._inputs.imu.frame)
        self._keeper.put_in_force(calibration, origin)
        return self._keeper.store(self._path)

    def _path(self) -> Path:
        chosen = self._table.settings.calibration_file
        path = self._keeper.path(chosen, self._inputs.field.frame or "magnetometer")
        assert path is not None
        return path

    def _accept(self) -> Conclusion:
        outcome = self._control.last_outcome
        if self._control.state is not State.IDLE:
            return Conclusion(False, "a turn is under way: wait for its verdict first")
        if outcome is None or outcome.calibration is None:
            return Conclusion(False, "there is no fitted calibration to accept")
        return Conclusion(True, self._put_in_force(outcome.calibration.on_users_word())())

    def _save(self) -> Conclusion:
        try:
            words = self._keeper.store(self._path)()
        except FileTrouble as error:
            return Conclusion(False, str(error))
        return Conclusion(not self._keeper.trouble, words)

    def _load(self) -> Conclusion:
        try:
            return Conclusion(True, self._keeper.load(self._path(), self._inputs.field.frame))
        except FileTrouble as error:
            return Conclusion(False, str(error))

    def _reset(self) -> Conclusion:
        self._control.forget_turns()
        if self._keeper.calibration is None:
            return Conclusion(True, "there was no calibration in force")
        self._keeper.reset()
        return Conclusion(
            True, "no calibration is in force any more; its file stays and is used at next start"
        )

    def _begin_report(self, window: Window, settings: Settings, outcome: Outcome) -> str:
        # A node that never calibrates should not load what draws reports.
        from magcal_ros.report import Subject

        imu, field = self._inputs.imu, self._inputs.field
        subject = Subject(
            window,
            settings.knowledge,
            outcome,
            source=f"{field.topic} and {imu.topic}",
            created=now(),
            method=settings.method,
            magnetometer_frame=known_as(field.frame),
            imu_frame=known_as(imu.frame),
        )
        return self._reporter.begin(settings.report_folder, subject)

    def _describe_silence(self) -> str:
        complaints = self._inputs.complaints()
        return "; ".join(complaints) or "no new field sample with an acceleration has come"

    def _on_tick(self) -> None:
        if not self._control.tick():
            self._tick.cancel()
        self._publish_status()
        self._draw()

    def _draw(self) -> None:
        """Draw the window of the moment once; a turn under way has a new one with each preview."""
        window = self._control.last_window
        if window is None or window is self._drawn:
            return
        idle, outcome = self._control.state is State.IDLE, self._control.last_outcome
        if not idle and not self._markers_out.get_subscription_count():
            return
        if idle or self._control.state is State.COLLECTING:
            estimate = outcome.estimate if idle and outcome is not None else None
            to_body = self._table.settings.knowledge.mounting.to_body
            markers = turn_markers(window, to_body, estimate, self._body_frame())
            self._markers_out.publish(markers)
            self._drawn = window

    def _on_heartbeat(self) -> None:
        self._inputs.streams.max_gap = self._table.settings.max_gap
        self._inputs.look(self.count_publishers)
        if not self._table.settings.accumulate:
            self._control.forget_turns()
        self._fused.patience = self._table.settings.patience
        self._whereabouts.refresh()
        now = self.get_clock().now().to_msg()
        self._outputs.repeat_bias(now)
        name = self.get_name()
        report = DiagnosticArray()
        report.header.stamp = now
        report.status = [
            calibration_diagnostic(name, self._control, self._keeper, self._inputs.field.frame),
            field_diagnostic(name, self._outputs, self._keeper, self._whereabouts.reference),
            self._fused.diagnostic(name),
            watch_diagnostic(name, self._watch),
            inputs_diagnostic(name, self._inputs, self._table.complaints),
        ]
        self._diagnostics_out.publish(report)
        self._publish_status()

    def _publish_status(self) -> None:
        reference, rotation = self._whereabouts.reference, self._table.settings.rotation
        status = status_json(
            self._control, self._keeper, self._inputs, reference, self._watch, rotation.enabled
        )
        if status != self._status:
            self._status = status
            self._status_out.publish(String(data=status))
