"""The calibrator node: topics in, one turn, a compass out."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from sensor_msgs.msg import Imu, MagneticField
from std_msgs.msg import String
from visualization_msgs.msg import MarkerArray

from magcal_ros.core.calibrate import Outcome
from magcal_ros.core.calibration.calibration import Calibration
from magcal_ros.core.heading.compass import Compass
from magcal_ros.core.heading.moment import Moment
from magcal_ros.core.knowledge import Knowledge
from magcal_ros.core.monitoring.watch import Watch
from magcal_ros.core.samples.streams import Drop, Streams
from magcal_ros.core.samples.window import Window
from magcal_ros.core.session.self_turn import Around, SelfTurn, Topics
from magcal_ros.core.session.turn_events import Conclusion
from magcal_ros.core.session.turn_states import TurnState
from magcal_ros.core.up import UpFollower
from magcal_ros.files.calibration_file import Origin
from magcal_ros.files.places import known_as
from magcal_ros.ros.announcer import Announcer
from magcal_ros.ros.control import Control
from magcal_ros.ros.errands import Errands
from magcal_ros.ros.fused import FusedOutput
from magcal_ros.ros.inputs import Inputs, Sensor
from magcal_ros.ros.keeper import Keeper
from magcal_ros.ros.markers import turn_markers
from magcal_ros.ros.meetings import Meetings
from magcal_ros.ros.mishaps import Mishaps
from magcal_ros.ros.outputs import LATCHED, RELIABLE, Outputs
from magcal_ros.ros.parameters import Parameters
from magcal_ros.ros.reporter import Reporter
from magcal_ros.ros.rotator import PERIOD, Rotator
from magcal_ros.ros.seat import Seat
from magcal_ros.ros.self_keeping import SelfKeeping
from magcal_ros.ros.services import Services, Tell
from magcal_ros.ros.settings import Settings
from magcal_ros.ros.shelf import Shelf
from magcal_ros.ros.spinner import Spinner
from magcal_ros.ros.status import (
    calibration_diagnostic,
    diagnostic_array,
    diagnostic_name,
    field_diagnostic,
    inputs_diagnostic,
    status_json,
    watch_diagnostic,
)
from magcal_ros.ros.straight import SENSOR_DATA, StraightGroup
from magcal_ros.ros.travel import Travel
from magcal_ros.ros.whereabouts import Whereabouts
from magcal_ros.ros.wire.incoming import Unreadable, read_field, read_imu

TICK = 0.1
"""Seconds between looks at a turn under way; at rest nothing ticks."""

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
        self._mishaps = Mishaps(self.get_logger().error)
        self._announcer = Announcer(self.get_logger())
        self._up = UpFollower()
        self._compass: Compass | None = None
        self._watch: Watch | None = None
        self._table = Parameters(self)
        self._whereabouts = Whereabouts(self, self._table)
        self._seat = Seat(self, lambda: self._table.settings)
        self._outputs = Outputs(self, self._seat)
        self._fused = FusedOutput(self, self._up, self._seat)
        self._fits, self._files = Errands(self, "magcal-fit"), Errands(self, "magcal-files")
        self._sensor_group = StraightGroup()
        fixes = self._whereabouts.on_fix
        self._travel = Travel(self, self._fits, self._sensor_group, fixes)
        self._keeper = Keeper(self.get_namespace(), self.get_name(), self._apply)
        log = self.get_logger()
        self._meetings = Meetings(self._keeper, self._files, self._chosen, log.info, log.error)
        self._shelf = Shelf(self._keeper, self._files, self._path, self._sensor_file)
        self._keeping = SelfKeeping(self, self, self._keeper, self._files, self._path, log.info)
        streams = Streams(self._table.settings.max_gap)
        self._inputs = Inputs(self._sensor("imu/data_raw"), self._sensor("imu/mag"), streams)
        self._reporter = Reporter(log.error)
        self._rotator = Rotator(self)
        topics = Topics(
            self._inputs.imu.topic, self._inputs.field.topic, self.resolve_topic_name("cmd_vel")
        )
        self._control = Control(streams, self, SelfTurn(topics), self._fits, self._files)
        self._status_out = self.create_publisher(String, "~/status", LATCHED)
        self._diagnostics_out = self.create_publisher(DiagnosticArray, "/diagnostics", RELIABLE)
        self._markers_out = self.create_publisher(MarkerArray, "~/markers", LATCHED)
        self._drawn: Window | None = None
        slow = {"accept": self._accept, "save": self._shelf.save, "load": self._shelf.load}
        Services(self, self._control, self._start, {"reset": self._reset}, slow)
        self._sensor_subscriptions = [
            self.create_subscription(
                kind, topic, callback, SENSOR_DATA, raw=True, callback_group=self._sensor_group
            )
            for kind, topic, callback in (
                (Imu, "imu/data_raw", self._on_imu),
                (MagneticField, "imu/mag", self._on_field),
            )
        ]
        # Deadlines and heartbeats go on while simulated time stands still.
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self._tick = self.create_timer(TICK, self._on_tick, clock=steady)
        self._look = self.create_timer(PERIOD, self._on_look, clock=steady)
        for timer in (self._tick, self._look):
            timer.cancel()
        self.create_timer(HEARTBEAT, self._on_heartbeat, clock=steady)
        self._meetings.begin()
        self._publish_status()

    def close(self) -> None:
        """Drop a turn under way; a calibration is on disk since the moment it was accepted."""
        self.stop_robot()
        self._control.shut_down()
        self._keeping.end()

    def stop_robot(self) -> None:
        """Stop a robot that turns itself, from any thread; it will not move again."""
        self._rotator.halt()

    def spinner(self) -> Spinner:
        """Return what serves this node, its sensors with the least effort; one at a time."""
        # Wheels tell nothing without the IMU, and need not wake the node between its messages.
        wheels, *receiver = self._travel.subscriptions
        subscriptions = [*self._sensor_subscriptions, *receiver]
        return Spinner(self, subscriptions, self._sensor_group, self._on_mishap, [wheels])

    def _on_mishap(self, error: Exception) -> None:
        self._mishaps.note(error)
        # What failed may be what watches the turn.
        self._control.give_up("an error in a callback of the node; its log says which")

    def _on_imu(self, data: bytes) -> None:
        streams = self._inputs.streams
        try:
            frame, sample, stamp = read_imu(data)
        except Unreadable:
            streams.imu_drops[Drop.UNREADABLE] += 1
            return
        if self._inputs.imu.heard(frame):
            self._meet()
        if sample is None:
            streams.imu_drops[Drop.ABSENT] += 1
        elif streams.add_imu(sample):
            self._up.add(sample, self._travel.on_imu(sample, self._up))
            self._control.hear(sample)
            reference = self._whereabouts.reference.field
            self._fused.on_imu(sample.stamp, stamp, self._body_frame(), reference)

    def _on_field(self, data: bytes) -> None:
        streams = self._inputs.streams
        try:
            arrived = read_field(data)
        except Unreadable:
            streams.field_drops[Drop.UNREADABLE] += 1
            return
        if self._inputs.field.heard(arrived.frame):
            self._meet()
        sample = arrived.sample
        if not streams.add_field(sample):
            return
        self._up.add_field(sample.stamp, sample.field)
        self._keeping.on_field(sample, streams.newest_imu, self._travel)
        if self._compass is not None:
            up = self._up.at(sample.stamp, streams.max_gap)
            moment = Moment.of(self._compass, sample, up, streams.newest_rate)
            reference = self._whereabouts.reference.field
            self._outputs.publish(moment, arrived, self._body_frame(), reference)
            self._fused.on_field(moment)
            self._travel.on_moment(moment)
            if self._watch is not None:
                self._watch.take(moment)
        if not streams.is_repeated:
            self._control.add(sample, self._travel.own_acceleration, self._travel.speed)

    def _sensor(self, topic: str) -> Sensor:
        return Sensor(self.resolve_topic_name(topic))

    def _body_frame(self) -> str:
        heard = self._inputs.imu.frame
        return heard or (self._keeper.origin.imu_frame if self._keeper.origin else "")

    def _chosen(self) -> str:
        return self._table.settings.calibration_file

    def _meet(self) -> None:
        """Take note of sensors that are heard for the first time, or under another name."""
        imu, field = self._inputs.imu, self._inputs.field
        self._control.sensors_met(f"{field.frame} {imu.frame}")
        self._keeping.meet(f"{field.frame} {imu.frame}")
        self._seat.meet(imu.frame, field.frame)
        if field.last_heard is not None:
            self._meetings.meet(field.frame)

    def _start(self) -> Conclusion:
        settings = self._seat.settled(self._whereabouts.settings)
        opened = self._control.start(settings, self._up.gyro_at_rest)
        if opened.success:
            self._tick.reset()
            if settings.rotation.enabled:
                self._rotator.prepare(settings.rotation)
                self._look.reset()
            self._publish_status()
        return opened

    def _apply(self, calibration: Calibration | None, magnetometer_frame: str) -> None:
        self._compass = None if calibration is None else Compass(calibration)
        self._outputs.put_in_force(self._compass, magnetometer_frame)
        self._fused.begin_anew(calibration)
        self._watch = None if calibration is None else Watch(calibration)
        self._whereabouts.use(calibration)
        self._keeping.use(calibration)
        self._travel.use(self._keeper.origin.vehicle_yaw if self._keeper.origin else None)
        self._publish_status()

    def put_in_force(self, calibration: Calibration) -> Callable[[], str]:
        """Apply a calibration at once; returns the work of storing it, which says what it did."""
        frames = (self._inputs.field.frame, self._inputs.imu.frame)
        origin = Origin.now(*frames, self.get_fully_qualified_name(), self._travel.yaw)
        self._keeper.put_in_force(calibration, origin)
        return self._keeper.store(self._path)

    def _sensor_file(self) -> tuple[str, str]:
        return self._chosen(), self._inputs.field.frame

    def _path(self) -> Path:
        return self._keeper.path(*self._sensor_file())

    def _accept(self, tell: Tell) -> None:
        outcome = self._control.turn.last_outcome
        if self._control.state is not TurnState.IDLE:
            tell(Conclusion(False, "a turn is under way: wait for its verdict first"))
        elif self._keeping.proposal is not None:
            self._keeping.accept(tell)
        elif outcome is None or outcome.calibration is None:
            tell(Conclusion(False, "there is no fitted calibration to accept"))
        else:
            self._reporter.put_in_force()
            self._keeping.put_in_force(outcome.calibration.on_users_word(), tell)

    def drive_knowledge(self) -> Knowledge | None:
        """Return what is known beforehand of a drive; None while a turn is under way."""
        if self._control.state is not TurnState.IDLE:
            return None
        return self._seat.settled(self._whereabouts.settings).knowledge

    def _reset(self) -> Conclusion:
        self._control.forget_turns()
        self._meetings.forget()
        if self._keeper.calibration is None:
            return Conclusion(True, "there was no calibration in force")
        self._keeper.reset()
        return Conclusion(
            True, "no calibration is in force any more; its file stays and is used at next start"
        )

    def begin_report(self, window: Window, settings: Settings, outcome: Outcome) -> str:
        """Begin the report on a turn; returns where it will lie, in words."""
        # A node that never calibrates should not load what draws reports.
        from magcal_ros.report import Subject

        imu, field = self._inputs.imu, self._inputs.field
        subject = Subject(
            window,
            settings.knowledge,
            outcome,
            source=f"{field.topic} and {imu.topic}",
            method=settings.method,
            magnetometer_frame=known_as(field.frame),
            imu_frame=known_as(imu.frame),
            vehicle=self._travel.words,
        )
        return self._reporter.begin(settings.report_folder, subject, settings.reports_kept)

    def describe_silence(self) -> str:
        """Say which sensor is missing, and what to look at."""
        complaints = self._inputs.complaints()
        return "; ".join(complaints) or "no new field sample with an acceleration has come"

    def move(self, rate: float) -> None:
        """Tell the base to turn at a rate, rad/s."""
        self._rotator.move(rate)

    def look_around(self) -> Around:
        """Return what is around a robot that turns itself."""
        ages = self._inputs.imu.age(), self._inputs.field.age()
        is_allowed = self._table.settings.rotation.enabled
        return Around(*ages, self._rotator.listeners, is_allowed, self._rotator.is_guarded)

    def turn_ended(self) -> None:
        """Tell the world how a turn ended, before those who wait for it are told."""
        self._seat.note_outcome(self._control.turn.last_outcome)
        self._publish_status()
        self._draw()

    def _on_look(self) -> None:
        if not self._control.look():
            self._rotator.rest()
            self._look.cancel()

    def _on_tick(self) -> None:
        self._fits.deliver()
        self._files.deliver()
        if not self._control.tick():
            self._tick.cancel()
        self._publish_status()
        self._draw()

    def _draw(self) -> None:
        """Draw the window of the moment once; a turn under way has a new one with each preview."""
        window = self._control.turn.last_window
        if window is None or window is self._drawn:
            return
        idle, outcome = self._control.state is TurnState.IDLE, self._control.turn.last_outcome
        if not idle and not self._markers_out.get_subscription_count():
            return
        if idle or self._control.state is TurnState.COLLECTING:
            estimate = outcome.estimate if idle and outcome is not None else None
            to_body = self._seat.settled(self._table.settings).knowledge.mounting.to_body
            markers = turn_markers(window, to_body, estimate, self._body_frame())
            self._markers_out.publish(markers)
            self._drawn = window

    def _on_heartbeat(self) -> None:
        self._fits.deliver()
        self._files.deliver()
        self._inputs.streams.max_gap = self._table.settings.max_gap
        self._inputs.look(self.count_publishers)
        if not self._table.settings.accumulate:
            self._control.forget_turns()
        self._fused.patience = self._table.settings.patience
        self._whereabouts.refresh()
        self._seat.note_up(self._up)
        settings = self._table.settings
        wanted = settings.self_calibration, settings.report_folder
        self._keeping.follow(*wanted, self._travel.swing)
        news = self._travel.follow(self._whereabouts.reference.field, self._seat, self._announcer)
        if news is not None and self._keeper.keep_vehicle_yaw(news):
            self._shelf.save(lambda _: None)
        complaints = self._inputs.complaints() + self._seat.complaints + self._travel.complaints
        self._announcer.complain(complaints)
        now = self.get_clock().now().to_msg()
        self._outputs.repeat_bias(now)
        name = diagnostic_name(self.get_fully_qualified_name())
        statuses = [
            calibration_diagnostic(name, self._control, self._keeper, self._inputs.field.frame),
            field_diagnostic(name, self._outputs, self._keeper, self._whereabouts.reference),
            self._fused.diagnostic(name),
            watch_diagnostic(name, self._watch),
            *self._travel.diagnostics(name),
            inputs_diagnostic(
                name, self._inputs, complaints + self._table.complaints, self._mishaps.total
            ),
        ]
        array = diagnostic_array(statuses, self._inputs.field.frame, now)
        self._diagnostics_out.publish(array)
        self._publish_status()

    def _publish_status(self) -> None:
        answer = self._control.turn.last_conclusion
        words = "" if answer is None else answer.message
        self._announcer.follow_turn(self._control.state is not TurnState.IDLE, answer, words)
        reference, turns = self._whereabouts.reference, self._table.settings.rotation.enabled
        told = self._control, self._keeper, self._inputs, reference, self._watch, turns
        status = status_json(*told, self._travel, self._keeping)
        if status != self._status:
            self._status = status
            self._status_out.publish(String(data=status))
