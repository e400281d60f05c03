"""The calibrator node."""

from __future__ import annotations

from functools import partial
from time import monotonic
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from sensor_msgs.msg import Imu
from std_msgs.msg import String

from magcal_ros.core.samples.streams import DropReason, FieldSample
from magcal_ros.core.session.self_turn import SelfTurn, TurnConditions
from magcal_ros.core.session.turn_machine import Conclusion
from magcal_ros.ros import status
from magcal_ros.ros.announcer import Announcer, CallbackErrors
from magcal_ros.ros.calibration_store import Tell
from magcal_ros.ros.guard import PERIOD, Rotator
from magcal_ros.ros.heading_pipeline import FIRST, HeadingPipeline
from magcal_ros.ros.known_headings import KnownHeadings
from magcal_ros.ros.magnetometer import Magnetometer, topic_of
from magcal_ros.ros.magnetometers import Ask, Magnetometers, at_once, offer_services
from magcal_ros.ros.outputs import RELIABLE, TurnMarkers
from magcal_ros.ros.parameters import Parameters, given_names
from magcal_ros.ros.self_calibration_runner import SelfCalibrationRunner
from magcal_ros.ros.sensor_frames import LATCHED
from magcal_ros.ros.threads import SensorGroup, Spinner
from magcal_ros.ros.wire import Unreadable, read_imu, unreadable_topics

NAME = "calibrator"
TICK = 0.1  # seconds between checks of a turn under way; without a turn this timer is stopped
HEARTBEAT = 1.0  # seconds between diagnostics, and between repetitions of the bias


class Calibrator(Node):
    """Calibrates magnetometers from one turn, and publishes corrected fields and the heading."""

    def __init__(self, **kwargs: Any) -> None:
        given = given_names(NAME, kwargs)
        super().__init__(NAME, **kwargs)
        self._status = ""
        self.callback_errors = CallbackErrors(self.get_logger().error)
        self._announcer = Announcer(self)
        self._table = Parameters(self, given)
        # The messages of the IMU come first, because the others refer to up.
        self._sensor_group = SensorGroup()
        self._sensor_group.subscribe(self, Imu, "imu/data_raw", self._on_imu)
        self._pipeline = pipeline = HeadingPipeline(self, self._table, self._sensor_group)
        self._up, self._travel, self._frames = pipeline.up, pipeline.travel, pipeline.frames
        self._reference = pipeline.reference
        self.rotator = Rotator(self)
        field, commands = map(self.resolve_topic_name, (topic_of(FIRST), "cmd_vel"))
        self._robot = SelfTurn(pipeline.imu.topic, field, commands)
        self._first = first = Magnetometer(self, pipeline, FIRST, self._robot)
        self._inputs = first.inputs
        self._control, self._store = first.control, first.store
        self._self_calibration = SelfCalibrationRunner(first)
        self._known = KnownHeadings(first)
        self._magnetometers = Magnetometers(first)
        self._status_out = self.create_publisher(String, "~/status", LATCHED)
        self._diagnostics_out = self.create_publisher(DiagnosticArray, "/diagnostics", RELIABLE)
        self._markers = TurnMarkers(self)
        self._offer_services()
        for number in range(FIRST + 1, self._table.settings.magnetometers + 1):
            Magnetometer(self, pipeline, number)
        # Timers use the steady clock, because simulated time may be paused.
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self._tick = self.create_timer(TICK, self._on_tick, clock=steady)
        self._look = self.create_timer(PERIOD, self._on_look, clock=steady)
        for timer in (self._tick, self._look):
            timer.cancel()
        self.create_timer(HEARTBEAT, self._on_heartbeat, clock=steady)
        self._store.begin()
        self._publish_status()

    def _offer_services(self) -> None:
        magnetometers, found = self._magnetometers, self._self_calibration
        services: dict[str, Ask] = {
            "calibrate": self._calibrate,
            "start": at_once(self._start),
            "finish": magnetometers.finish,
            "cancel": at_once(magnetometers.cancel),
            "reset": at_once(self._reset),
            "accept": lambda tell: magnetometers.accept(found.proposal, tell),
            "save": magnetometers.save,
            "load": magnetometers.load,
            "calibrate_at_heading": partial(self._known.calibrate, magnetometers),
        }
        offer_services(self, services, self._on_callback_error)

    def close(self) -> None:
        """Discard a turn under way; an accepted calibration is on disk already."""
        self.rotator.halt()
        self._magnetometers.shut_down()
        self._self_calibration.worker.end()
        self._known.worker.end()

    def spinner(self) -> Spinner:
        """Return the executor of this node, with an efficient thread for the sensors."""
        return Spinner(self, self._sensor_group, self._on_callback_error)

    def _on_callback_error(self, error: Exception) -> None:
        # The failed callback may be the one that supervises the robot.
        reason, stop = self.callback_errors.note(error), self._control.turn.stop_robot
        self._control.tell(stop, reason, monotonic())

    def _on_imu(self, data: bytes) -> None:
        streams = self._inputs.streams
        try:
            frame, sample, stamp = read_imu(data)
        except Unreadable:
            streams.imu_drops[DropReason.UNREADABLE] += 1
            return
        if self._inputs.imu.note_message(frame):
            for each in self._magnetometers.active:
                each.look_at_sensors()
        if sample is None:
            streams.imu_drops[DropReason.ABSENT] += 1
        elif streams.add_imu(sample):
            own = self._travel.estimator.add_imu(sample, self._up.gyro_bias.rate)
            self._up.add(sample, own)
            if self._robot.is_under_way:
                self._robot.add_rate(sample.rate, monotonic())
            for each in self._magnetometers.others:
                each.inputs.streams.add_imu(sample)
            self._known.on_imu(sample.stamp)
            frame, field = self._pipeline.body_frame(), self._reference.field
            self._pipeline.fused.on_imu(sample.stamp, stamp, frame, field)

    def sample_came(self, magnetometer: Magnetometer, sample: FieldSample) -> None:
        """Take a field sample before its heading is computed."""
        if magnetometer is self._first:
            self._up.add_field(sample.stamp, sample.field)
            at_rest = self._pipeline.motors.take(magnetometer.compass, sample)
            self._self_calibration.on_field(at_rest)
            self._known.on_field(at_rest)

    def sensors_changed(self, magnetometer: Magnetometer) -> None:
        """Note the first message of a sensor, or a new frame."""
        self._magnetometers.add(magnetometer)
        frames = self._inputs.imu.frame, self._inputs.field.frame
        if magnetometer is self._first and self._frames.note_sensors(*frames):
            # Samples of other sensors are not used.
            self._self_calibration.machine.forget()
            self._known.forget()

    def _start(self) -> Conclusion:
        opened = self._magnetometers.start()
        if opened.success:
            self.get_logger().info("a turn begins")
            self._tick.reset()
            rotation = self._table.settings.rotation
            if rotation.enabled:
                self._pipeline.motors.commands.leave()
                self.rotator.prepare(rotation)
                self._look.reset()
            self._publish_status()
        return opened

    def _calibrate(self, tell: Tell) -> None:
        opened = self._start()
        if opened.success:
            self._magnetometers.when_done(tell)
        else:
            tell(opened)

    def calibration_changed(self, magnetometer: Magnetometer) -> None:
        """Use the new calibration in force for the heading."""
        if magnetometer is self._first:
            self._self_calibration.machine.put_in_force(self._store.calibration)
        self._pipeline.use({each.number: each.store for each in self._magnetometers.active})
        self._publish_status()

    def _reset(self) -> Conclusion:
        self._known.forget()
        were_in_force = [each.store.calibration for each in self._magnetometers.active]
        for each in self._magnetometers.active:
            each.reset()
        if not any(were_in_force):
            return Conclusion(True, "there was no calibration in force")
        return Conclusion(
            True,
            "no calibration is in force any more; the next start loads the stored one, if any",
        )

    def turn_ended(self, magnetometer: Magnetometer) -> None:
        """Publish the result of a turn, before the waiting callers are answered."""
        conclusion, subject = magnetometer.control.turn.last_conclusion, magnetometer.topic
        assert conclusion is not None
        if magnetometer is self._first:
            subject = "the turn is over"
            self._publish_status()
            self._draw()
        self.get_logger().info(f"{subject}: {conclusion.message}")

    def _on_look(self) -> None:
        base, is_allowed = self.rotator, self._table.settings.rotation.enabled
        ages = self._inputs.imu.age(), self._inputs.field.age()
        if not self._control.look(
            TurnConditions(*ages, base.listeners, is_allowed, base.is_guarded)
        ):
            self.rotator.rest()
            self._look.cancel()

    def _on_tick(self) -> None:
        if not self._magnetometers.tick():
            self._tick.cancel()
        self._publish_status()
        self._draw()

    def _draw(self) -> None:
        to_body, frame = self._frames.mounting().to_body, self._pipeline.body_frame()
        self._markers.draw(self._control.turn, to_body, frame)

    def _on_heartbeat(self) -> None:
        self._magnetometers.look()
        self._pipeline.follow(self._store, self._control.turn.state, self._announcer)
        self._known.look()
        self._self_calibration.follow()
        outcome = self._control.turn.last_outcome
        complaints = [
            *self._inputs.complaints(),
            *self._pipeline.gyro_complaints(),
            *self._frames.follow(self._up, outcome, self._travel.yaw),
            *self._travel.complaints,
            *self._known.antenna.complaints,
            *self._pipeline.headings.complaints(self._reference.field),
        ]
        others = self._magnetometers.complaints() + self._pipeline.complaints()
        # In the log alone: an optional topic may have the name of something else on this robot.
        sensors = self._inputs.imu.topic, self._inputs.field.topic
        others += unreadable_topics(self, sensors)
        self._announcer.complain(dict.fromkeys(complaints + others))
        now = self.get_clock().now().to_msg()
        for each in self._magnetometers.active:
            if each.out is not None:
                each.out.repeat_bias(now)
        statuses = [
            status.calibration_diagnostic(self._first),
            status.field_diagnostic(self._pipeline),
            self._pipeline.fused.diagnostic(),
            status.watch_diagnostic(self._self_calibration),
            *self._travel.diagnostics(),
            *self._magnetometers.diagnostics(),
            status.inputs_diagnostic(
                self._inputs, complaints + self._table.complaints, self.callback_errors.total
            ),
        ]
        name, frame = self.get_fully_qualified_name().lstrip("/"), self._inputs.field.frame
        self._diagnostics_out.publish(status.diagnostic_array(name, statuses, frame, now))
        self._publish_status()

    def _publish_status(self) -> None:
        text = status.status_json(self._magnetometers, self._self_calibration, self._known)
        if text != self._status:
            self._status = text
            self._status_out.publish(String(data=text))
