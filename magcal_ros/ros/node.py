"""The calibrator node."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from sensor_msgs.msg import Imu, MagneticField
from std_msgs.msg import String

from magcal_ros.core.calibrate import Outcome
from magcal_ros.core.calibration.calibration import Calibration
from magcal_ros.core.heading.compass import Compass
from magcal_ros.core.knowledge import Knowledge
from magcal_ros.core.monitoring.watch import Watch
from magcal_ros.core.samples.streams import Drop, Streams
from magcal_ros.core.samples.window import Window
from magcal_ros.core.session.self_turn import Around, SelfTurn, Topics
from magcal_ros.core.session.turn_events import Conclusion, TurnState
from magcal_ros.core.up import UpFollower
from magcal_ros.files.default_paths import known_as
from magcal_ros.ros.announcer import Announcer
from magcal_ros.ros.background_thread import BackgroundThread
from magcal_ros.ros.calibration_loader import CalibrationLoader
from magcal_ros.ros.control import Control
from magcal_ros.ros.further_magnetometer import FurtherMagnetometer, Listeners
from magcal_ros.ros.heading_pipeline import FIRST, HeadingPipeline
from magcal_ros.ros.inputs import Inputs, Sensor
from magcal_ros.ros.keeper import CalibrationStore, Keeper
from magcal_ros.ros.known_headings import KnownHeadings
from magcal_ros.ros.magnetometers import Magnetometers
from magcal_ros.ros.markers import TurnMarkers
from magcal_ros.ros.outputs import LATCHED, RELIABLE, FieldOutput
from magcal_ros.ros.parameters import Parameters
from magcal_ros.ros.reference_source import ReferenceSource
from magcal_ros.ros.reporter import Reporter
from magcal_ros.ros.rotator import PERIOD, Rotator
from magcal_ros.ros.self_keeping import SelfKeeping
from magcal_ros.ros.sensor_frames import SensorFrames
from magcal_ros.ros.sensor_loop import SENSOR_DATA, SensorGroup
from magcal_ros.ros.services import Services, Tell
from magcal_ros.ros.settings import Settings
from magcal_ros.ros.spinner import CallbackErrors, Spinner
from magcal_ros.ros.status import (
    calibration_diagnostic,
    diagnostic_array,
    diagnostic_name,
    field_diagnostic,
    inputs_diagnostic,
    status_json,
    watch_diagnostic,
)
from magcal_ros.ros.travel import Travel
from magcal_ros.ros.wire.incoming import Unreadable, read_field, read_imu

TICK = 0.1
"""Seconds between looks at a turn under way; at rest nothing ticks."""

HEARTBEAT = 1.0
"""Seconds between diagnostics, and between repetitions of the bias."""


class Calibrator(Node):
    """Calibrates a magnetometer from one turn and publishes what it measures from then on."""

    def __init__(self, **kwargs: Any) -> None:
        super().__init__("calibrator", **kwargs)
        self._status = ""
        self._callback_errors = CallbackErrors(self.get_logger().error)
        self._announcer = Announcer(self.get_logger())
        self._up = UpFollower()
        self._compass: Compass | None = None
        self._watch: Watch | None = None
        self._table = Parameters(self)
        self._reference = ReferenceSource(self, self._table)
        self._frames = SensorFrames(self, lambda: self._table.settings)
        self._outputs = FieldOutput(self, "imu/mag")
        self._fits, self._files = (BackgroundThread(self, f"magcal-{n}") for n in ("fit", "files"))
        self._sensor_group = SensorGroup()
        self._travel = Travel(self, self._fits, self._sensor_group, self._reference.on_fix)
        self._keeper = Keeper(self.get_namespace(), self.get_name(), self._apply, self._chosen())
        log = self.get_logger()
        disk = self._keeper, self._files
        self._loader = CalibrationLoader(*disk, self._chosen, log.info, log.error)
        self._store = CalibrationStore(*disk, self._path, self._sensor_file)
        self._keeping = SelfKeeping(self, self, self._keeper, self._files, log.info)
        streams = Streams(self._table.settings.max_gap)
        imu, field = (Sensor(self.resolve_topic_name(t)) for t in ("imu/data_raw", "imu/mag"))
        self._inputs = Inputs(imu, field, streams)
        where = self._frames, self._reference, self._travel
        self._pipeline = HeadingPipeline(self, self._up, self._inputs, *where)
        told = self, self._keeping, self._keeper, partial(self._pipeline.settled, FIRST, "")
        heard = *told, self._frames, self._up, streams, self._pipeline.fused
        self._known = self._pipeline.known = KnownHeadings(*heard, self._fits, self._sensor_group)
        self._reporter = Reporter(log.error)
        self._rotator = Rotator(self)
        topics = Topics(imu.topic, field.topic, self.resolve_topic_name("cmd_vel"))
        self._control = Control(streams, self, SelfTurn(topics), self._fits, self._files)
        own = self._control, topics.field, self._keeper
        self._magnetometers = Magnetometers(*own, self._pipeline.several)
        self._status_out = self.create_publisher(String, "~/status", LATCHED)
        self._diagnostics_out = self.create_publisher(DiagnosticArray, "/diagnostics", RELIABLE)
        self._markers = TurnMarkers(self)
        self._offer_services()
        self._sensor_subscriptions = [
            self.create_subscription(
                kind, topic, callback, SENSOR_DATA, raw=True, callback_group=self._sensor_group
            )
            for kind, topic, callback in (
                (Imu, "imu/data_raw", self._on_imu),
                (MagneticField, "imu/mag", self._on_field),
            )
        ]
        self._listen_to_further()
        # Deadlines and heartbeats go on while simulated time stands still.
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self._tick = self.create_timer(TICK, self._on_tick, clock=steady)
        self._look = self.create_timer(PERIOD, self._on_look, clock=steady)
        for timer in (self._tick, self._look):
            timer.cancel()
        self.create_timer(HEARTBEAT, self._on_heartbeat, clock=steady)
        self._loader.begin()
        self._publish_status()

    def _offer_services(self) -> None:
        slow: dict[str, Callable[[Tell], None]] = {
            "accept": self._accept,
            "save": partial(self._magnetometers.save, self._store),
            "load": partial(self._magnetometers.load, self._store),
            "calibrate_at_heading": partial(self._known.calibrate, self._magnetometers),
        }
        cancel = self._magnetometers.cancel
        quick = {"start": self._start, "cancel": cancel, "reset": self._reset}
        Services(self, self._magnetometers, quick, slow, self._on_callback_error)

    def _listen_to_further(self) -> None:
        for number in range(FIRST + 1, self._table.settings.magnetometers + 1):
            listeners = Listeners(self._magnetometers.meet, self._follow, self.note_error)
            shared = self._inputs, self._chosen, self._fits, self._files
            FurtherMagnetometer(self, self._pipeline, number, *shared, listeners)

    def close(self) -> None:
        """Drop a turn under way; a calibration is on disk since the moment it was accepted."""
        self.stop_robot()
        self._magnetometers.shut_down()
        self._keeping.end()
        self._known.end()

    def stop_robot(self) -> None:
        """Stop a robot that turns itself, from any thread; it will not move again."""
        self._rotator.halt()

    def spinner(self) -> Spinner:
        """Return what serves this node, its sensors with the least effort; one at a time."""
        # Wheels are of no use without the IMU, and need not wake the node between its messages.
        wheels, *receiver = self._travel.subscriptions
        subscriptions = [*self._sensor_subscriptions, *receiver, self._known.antenna.subscription]
        return Spinner(self, subscriptions, self._sensor_group, self._on_callback_error, [wheels])

    def _on_callback_error(self, error: Exception) -> None:
        # What failed may be what watches the turn.
        self._control.give_up(self._callback_errors.note(error))

    def note_error(self, error: Exception) -> None:
        """Take note of an error that ends a turn."""
        self._callback_errors.note(error)

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
            if self._magnetometers.heard:
                self._magnetometers.on_imu(sample)
            self._pipeline.on_imu(sample.stamp, stamp)

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
        at_rest = self._pipeline.motors.take(self._compass, sample)
        self._keeping.on_field(at_rest, streams.newest_imu, self._travel)
        self._known.on_field(at_rest)
        if self._compass is not None:
            moment = self._pipeline.moment_of(self._compass, sample)
            self._outputs.publish(moment.field, arrived, self._pipeline.body_frame())
            self._pipeline.take(FIRST, moment, arrived)
            if self._watch is not None:
                self._watch.take(moment)
        if not streams.is_repeated:
            self._control.add(sample)

    def _chosen(self) -> str:
        return self._table.settings.calibration_file

    def _meet(self) -> None:
        """Take note of sensors that send for the first time, or under another name."""
        imu, field = self._inputs.imu, self._inputs.field
        self._control.sensors_met(known_as(field.frame), known_as(imu.frame))
        self._keeping.meet(f"{field.frame} {imu.frame}")
        self._known.meet(f"{field.frame} {imu.frame}")
        self._frames.meet(imu.frame, field.frame)
        if field.last_heard is not None:
            self._loader.meet(field.frame)

    def _start(self) -> Conclusion:
        settings, state = self._pipeline.settled(FIRST, ""), self._magnetometers.state
        if state is not TurnState.IDLE and self._control.state is TurnState.IDLE:
            return Conclusion(False, f"already {state.value} another magnetometer's turn: wait")
        opened = self._control.start(settings, self._up.gyro_at_rest)
        if opened.success:
            self._magnetometers.start(self._up.gyro_at_rest)
            self._tick.reset()
            if settings.rotation.enabled:
                self._pipeline.motors.commands.leave()
                self._rotator.prepare(settings.rotation)
                self._look.reset()
            self._publish_status()
        return opened

    def _apply(self, calibration: Calibration | None, magnetometer_frame: str) -> None:
        self._compass = None if calibration is None else Compass(calibration)
        self._outputs.put_in_force(self._compass, magnetometer_frame)
        self._watch = None if calibration is None else Watch(calibration)
        self._keeping.use(calibration)
        self._follow()

    def _follow(self) -> None:
        """Let the heading follow what is in force."""
        self._pipeline.use(self._magnetometers.keepers)
        self._publish_status()

    def put_in_force(self, calibration: Calibration, with_backup: bool = True) -> Callable[[], str]:
        """Apply a calibration at once; returns the work of storing it, which says what it did."""
        self._keeper.put_in_force(calibration, self._pipeline.origin_of(self._inputs.field.frame))
        return self._keeper.store(self._path, with_backup)

    def _sensor_file(self) -> tuple[str, str]:
        return self._chosen(), self._inputs.field.frame

    def _path(self) -> Path:
        return self._keeper.path(*self._sensor_file())

    def _accept(self, tell: Tell) -> None:
        outcome = self._control.turn.last_outcome
        first: Callable[[Tell], None] | None = None
        if self._keeping.proposal is not None:
            first = self._keeping.accept
        elif outcome is not None and outcome.calibration is not None:
            first = partial(self._accept_turn, outcome.calibration)
        self._magnetometers.accept(first, tell)

    def _accept_turn(self, calibration: Calibration, tell: Tell) -> None:
        if self._control.turn.outcome_is_of_others:
            tell(Conclusion(False, "the last fit is of other sensors than the present ones"))
            return
        self._reporter.put_in_force()
        self._keeping.put_in_force(calibration.on_users_word(), tell)

    def drive_knowledge(self) -> Knowledge | None:
        """Return what is known beforehand of a drive; None while a turn is under way."""
        is_idle = self._control.state is TurnState.IDLE
        return self._pipeline.settled(FIRST, "").knowledge if is_idle else None

    def _reset(self) -> Conclusion:
        self._known.forget()
        self._control.forget_turns()
        self._loader.forget()
        were_several = self._magnetometers.reset()
        if self._keeper.calibration is None and not were_several:
            return Conclusion(True, "there was no calibration in force")
        self._keeper.reset()
        return Conclusion(
            True, "no calibration is in force any more; its file stays and is used at next start"
        )

    def begin_report(self, window: Window, settings: Settings, outcome: Outcome) -> str:
        """Begin the report on a turn; returns where it will lie, in words."""
        sensor, by = self._inputs.field, self._reporter
        return self._pipeline.report(sensor, by, window, settings, outcome)

    def describe_silence(self) -> str:
        """Say which sensor is missing, and what to look at."""
        nothing = "no new field sample with an acceleration has come"
        return "; ".join(self._inputs.complaints()) or nothing

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
        self._frames.note_outcome(self._control.turn.last_outcome)
        self._publish_status()
        self._draw()

    def _on_look(self) -> None:
        if not self._control.look():
            self._rotator.rest()
            self._look.cancel()

    def _on_tick(self) -> None:
        self._fits.deliver()
        self._files.deliver()
        if not self._magnetometers.tick():
            self._tick.cancel()
        self._publish_status()
        self._draw()

    def _draw(self) -> None:
        to_body = self._frames.settled(self._table.settings).knowledge.mounting.to_body
        self._markers.draw(self._control, to_body, self._pipeline.body_frame())

    def _on_heartbeat(self) -> None:
        self._fits.deliver()
        self._files.deliver()
        self._inputs.streams.max_gap = self._table.settings.max_gap
        self._inputs.look(self.count_publishers)
        self._magnetometers.look(self.count_publishers, self._table.settings)
        if not self._table.settings.accumulate:
            self._control.forget_turns()
        settings, swing = self._table.settings, self._travel.swing
        self._pipeline.follow(settings, self._keeper, self._store, self._control.state)
        self._reference.refresh()
        self._frames.note_up(self._up)
        self._keeping.follow(settings.self_calibration, settings.report_folder, swing)
        news = self._travel.follow(self._reference.reference.field, self._frames, self._announcer)
        if news is not None and self._keeper.keep_vehicle_yaw(news):
            self._store.save(lambda _: None)
        complaints = self._inputs.complaints() + self._frames.complaints + self._travel.complaints
        complaints += [*self._known.complaints, *filter(None, [self._pipeline.headings.rivals()])]
        self._announcer.complain(dict.fromkeys(complaints + self._magnetometers.complaints()))
        now = self.get_clock().now().to_msg()
        self._outputs.repeat_bias(now)
        self._magnetometers.repeat_bias(now)
        name = diagnostic_name(self.get_fully_qualified_name())
        statuses = [
            calibration_diagnostic(name, self._control, self._keeper, self._inputs.field.frame),
            field_diagnostic(
                name, self._pipeline.headings.moment, self._pipeline.lead, self._reference.reference
            ),
            self._pipeline.fused.diagnostic(name),
            watch_diagnostic(name, self._watch, self._keeping),
            *self._travel.diagnostics(name),
            *self._magnetometers.diagnostics(name),
            inputs_diagnostic(
                name, self._inputs, complaints + self._table.complaints, self._callback_errors.total
            ),
        ]
        self._diagnostics_out.publish(diagnostic_array(statuses, self._inputs.field.frame, now))
        self._publish_status()

    def _publish_status(self) -> None:
        answer, state = self._control.turn.last_conclusion, self._magnetometers.state
        words = "" if answer is None else answer.message
        self._announcer.follow_turn(state is not TurnState.IDLE, answer, words)
        turn = self._control, self._keeper, self._inputs, self._reference.reference, self._watch
        turns, motors = self._table.settings.rotation.enabled, self._pipeline.motors
        drive = self._travel, self._keeping, self._magnetometers, motors.facts(self._compass)
        status = status_json(*turn, turns, *drive, self._known)
        if status != self._status:
            self._status = status
            self._status_out.publish(String(data=status))
