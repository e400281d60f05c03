"""A magnetometer: its messages, its calibration and file, its turns."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable
from dataclasses import replace
from time import monotonic as now
from typing import Any, Protocol, TypeVar

from rclpy.callback_groups import CallbackGroup
from rclpy.node import Node
from sensor_msgs.msg import MagneticField

from magcal_ros.core.calibrate import Outcome, predicted_sigma, take_turn
from magcal_ros.core.calibration.calibration import Calibration
from magcal_ros.core.errors import in_words
from magcal_ros.core.heading.compass import Compass
from magcal_ros.core.knowledge import Knowledge
from magcal_ros.core.monitoring.watch import Watch
from magcal_ros.core.samples.rest import GyroAtRest
from magcal_ros.core.samples.streams import Drop, FieldSample, ImuSample, Pairer, Streams
from magcal_ros.core.samples.window import Window
from magcal_ros.core.session import turn_events as ev
from magcal_ros.core.session.self_turn import Around, Order, SelfTurn
from magcal_ros.core.session.turn_machine import TurnMachine
from magcal_ros.files.default_paths import known_as
from magcal_ros.ros.heading_pipeline import FIRST, HeadingPipeline, Inputs
from magcal_ros.ros.keeper import Keeper, Tell
from magcal_ros.ros.outputs import FieldOutput
from magcal_ros.ros.parameters import Settings
from magcal_ros.ros.reporter import Reporter
from magcal_ros.ros.rotator import Rotator
from magcal_ros.ros.threads import SENSOR_DATA, BackgroundThread
from magcal_ros.ros.wire import Unreadable, read_field
from magcal_ros.ros.worker_process import WorkerProcess


class Owner(Protocol):
    """What the node does when something happens to a magnetometer."""

    rotator: Rotator

    def look_around(self) -> Around:
        """Return the state of sensors, base and guard."""

    def note_error(self, error: Exception) -> None:
        """Note an error that ends a turn."""

    def sensors_changed(self, magnetometer: Magnetometer) -> None:
        """Take note of a sensor that sends for the first time, or under another name."""

    def sample_came(self, magnetometer: Magnetometer, sample: FieldSample) -> None:
        """Take a field sample, before the heading that follows from it."""

    def calibration_changed(self, magnetometer: Magnetometer) -> None:
        """Use the calibration that is in force from now on."""

    def turn_ended(self, magnetometer: Magnetometer) -> None:
        """Publish how a turn ended, before those who wait for it are answered."""


class Magnetometer:
    """A magnetometer's messages, calibration, file and turns.

    One beside the first is nothing but a subscription until its first message comes.
    """

    def __init__(
        self,
        node: Node,
        owner: Owner,
        pipeline: HeadingPipeline,
        inputs: Inputs,
        chosen: Callable[[], str],
        fits: BackgroundThread,
        files: BackgroundThread,
        robot: SelfTurn,
        group: CallbackGroup | None = None,
        number: int = FIRST,
    ) -> None:
        self.number, self.inputs = number, inputs
        self._node, self._owner, self._pipeline = node, owner, pipeline
        self._topic, self.topic = topic_of(number), inputs.field.topic
        name, log = (node.get_namespace(), node.get_name()), node.get_logger()
        self.keeper = Keeper(name, files, log, self._apply, chosen, number)
        self.control = Control(inputs.streams, self, owner, robot, fits, files)
        self._reporter = Reporter(BackgroundThread(node, "magcal-report"), log.error)
        self.compass: Compass | None = None
        self.watch: Watch | None = None
        """Watches the calibration of the first magnetometer."""
        self.out = FieldOutput(node, self._topic) if number == FIRST else None
        self.subscription = node.create_subscription(
            MagneticField, self._topic, self._on_field, SENSOR_DATA, raw=True, callback_group=group
        )

    def look_at_sensors(self) -> None:
        """Take note of sensors that send for the first time, or under another name."""
        self._note_sensors()
        self._owner.sensors_changed(self)
        if self.inputs.field.last_heard is not None:
            self.keeper.note_sensor(self.inputs.field.frame)

    def start(self, gyro: GyroAtRest | None) -> ev.Conclusion:
        """Collect the turn that begins."""
        self._note_sensors()
        settings = self._pipeline.settled(self.number, self.inputs.field.frame)
        if self.number != FIRST:
            # The first magnetometer's turn commands the robot.
            settings = replace(settings, rotation=replace(settings.rotation, enabled=False))
        return self.control.start(settings, gyro)

    @property
    def has_something_to_accept(self) -> bool:
        """Whether its last turn gave a calibration that a person may accept."""
        turn, outcome = self.control.turn, self.control.turn.last_outcome
        if outcome is None or outcome.calibration is None:
            return False
        is_settled = outcome.verdict.accepted or turn.outcome_is_of_others
        return self.number == FIRST or not is_settled

    def accept(self, tell: Tell) -> None:
        """Put what the last turn fitted in force."""
        outcome = self.control.turn.last_outcome
        assert outcome is not None
        assert outcome.calibration is not None
        if self.control.turn.outcome_is_of_others:
            tell(ev.Conclusion(False, "the last fit is of other sensors than the present ones"))
            return
        self._reporter.put_in_force()
        self.use(outcome.calibration.accepted_by_person(), tell)

    def use(self, calibration: Calibration, tell: Tell, with_backup: bool = True) -> None:
        """Apply a calibration and store it; only what is stored as well is a success."""
        self.keeper.put_in_force(calibration, self._pipeline.origin_of(self.inputs.field.frame))
        self.keeper.save(tell, with_backup)

    def reset(self) -> None:
        """Use no calibration any more."""
        self.control.forget_turns()
        self.keeper.forget()
        if self.keeper.calibration is not None:
            self.keeper.reset()

    def drive_knowledge(self) -> Knowledge | None:
        """Return what is known beforehand of a drive; None while a turn is under way."""
        if self.control.state is not ev.TurnState.IDLE:
            return None
        return self._pipeline.settled(self.number, self.inputs.field.frame).knowledge

    def begin_report(self, window: Window, settings: Settings, outcome: Outcome) -> str:
        """Begin the report on a turn; returns where it will be written, in words."""
        yaw = self._pipeline.travel.yaw
        vehicle = yaw.words if yaw else ""
        return self._reporter.report(window, settings, outcome, self.inputs, vehicle)

    def describe_silence(self) -> str:
        """Say which sensor is missing, and what to look at."""
        complaints = self.inputs.complaints()
        return "; ".join(complaints) or "no new field sample with an acceleration has come"

    def _apply(self, calibration: Calibration | None, magnetometer_frame: str) -> None:
        self.compass = None if calibration is None else Compass(calibration)
        if self.out is not None:
            self.out.put_in_force(self.compass, magnetometer_frame)
        self.watch = Watch(calibration) if self.number == FIRST and calibration else None
        self._owner.calibration_changed(self)

    def _note_sensors(self) -> None:
        frames = self.inputs.field.frame, self.inputs.imu.frame
        self.control.note_sensors(*map(known_as, frames))

    def _on_field(self, data: bytes) -> None:
        streams = self.inputs.streams
        try:
            arrived = read_field(data)
        except Unreadable:
            streams.field_drops[Drop.UNREADABLE] += 1
            return
        if self.inputs.field.heard(arrived.frame):
            if self.out is None:
                self.out = FieldOutput(self._node, self._topic)
            self.look_at_sensors()
        sample = arrived.sample
        if not streams.add_field(sample):
            return
        self._owner.sample_came(self, sample)
        if self.compass is not None and self.out is not None:
            moment = self._pipeline.moment_of(self.compass, sample)
            self.out.publish(moment.field, arrived, self._pipeline.body_frame())
            self._pipeline.take(self.number, moment, arrived)
            if self.watch is not None:
                self.watch.take(moment)
        if not streams.is_repeated:
            self.control.add(sample)


def topic_of(number: int) -> str:
    """Return the topic of a magnetometer by its number, as it is before remapping."""
    return "imu/mag" if number == FIRST else f"imu/mag_{number}"


SAVING_PATIENCE = 1.5
"""Seconds that a disk may take to store a calibration while the node is being ended."""

T = TypeVar("T")


def _broken_off(error: Exception) -> str:
    return f"the turn was broken off by an error ({error}); the node's log says where"


class Control:
    """Runs one turn at a time: reports events to the state machine, carries out its commands.

    Collecting happens in the executor's thread, a few microseconds a sample. The fit has a process
    of its own and the disk a thread, so the corrected field and the yaw are not interrupted. `turn`
    is the state machine, to be read.
    """

    def __init__(
        self,
        streams: Streams,
        magnetometer: Magnetometer,
        owner: Owner,
        robot: SelfTurn,
        fits: BackgroundThread,
        files: BackgroundThread,
    ) -> None:
        self._magnetometer, self._owner, self._fits, self._files = magnetometer, owner, fits, files
        self._streams = streams
        self._pairer = Pairer(streams)
        self._worker = WorkerProcess()
        self.turn = TurnMachine(robot, self._report)
        self._settings: Settings | None = None
        self._listeners: list[Tell] = []
        self._unreported: ev.Conclusion | None = None

    @property
    def state(self) -> ev.TurnState:
        """What is going on."""
        return self.turn.state

    def when_done(self, listener: Tell) -> None:
        """Call back once with the conclusion of the turn that is under way."""
        self._listeners.append(listener)

    def forget_turns(self) -> None:
        """Let the next turn start afresh."""
        self._tell(self.turn.forget)

    def note_sensors(self, field: str, imu: str) -> None:
        """Note the frames of the sensors that are there; turns of others are not joined."""
        self._tell(self.turn.note_sensors, field, imu)

    def start(self, settings: Settings, gyro: GyroAtRest | None = None) -> ev.Conclusion:
        """Open a session; refused while another is under way."""
        rotation, limits = settings.rotation, settings.limits
        knowledge, method = settings.knowledge, settings.method
        order = Order(rotation.speed, limits.timeout, knowledge.mounting.to_body)
        asked = order if rotation.enabled else None
        brief = ev.Brief(limits, knowledge, method, settings.accumulate, asked, gyro)
        was_idle = self.state is ev.TurnState.IDLE
        answer = self._tell(self.turn.open, brief, now())
        if was_idle and answer.success:
            self._settings, self._pairer = settings, Pairer(self._streams)
            self._unreported = None
        return answer

    def add(self, sample: FieldSample) -> None:
        """Take a field sample of the stream, if a session wants it."""
        if self.state is ev.TurnState.COLLECTING:
            self._pairer.offer(sample)
            self._collect()

    def hear(self, sample: ImuSample) -> None:
        """Take an IMU sample, if the robot turns itself."""
        if self.turn.robot.is_under_way:
            self._tell(self.turn.hear, sample.rate, now())

    def finish(self) -> ev.Conclusion | None:
        """End the session now and fit what there is; None means the fit is under way.

        The verdict on a turn that ended by itself, and that nobody waited for, is returned once.
        """
        self._collect()
        unreported, self._unreported = self._unreported, None
        if unreported is not None:
            return unreported
        return self._tell(self.turn.finish, now())

    def cancel(self) -> ev.Conclusion:
        """Cancel the turn under way; the calibration in force stays."""
        return self._tell(self.turn.cancel)

    def tick(self) -> bool:
        """Let a turn see that time has passed; returns whether one is under way."""
        if self.state is ev.TurnState.COLLECTING:
            self._collect()
            self._tell(self.turn.tick, self._magnetometer.describe_silence(), now())
        return self.state is not ev.TurnState.IDLE

    def look(self) -> bool:
        """Look at a robot that turns itself; returns whether there is still one to look at."""
        self._collect()
        if self.turn.progress is not None:
            self._tell(self.turn.look, self._owner.look_around(), now())
        return not self.turn.robot.is_quiet

    def give_up(self, reason: str) -> None:
        """Stop a robot that turns itself and break off its turn."""
        self._tell(self.turn.stop_robot, reason, now())

    def shut_down(self) -> None:
        """Drop a turn under way; what is in force already is saved before this returns."""
        if self.state is ev.TurnState.SAVING:
            self._files.finish_within(SAVING_PATIENCE)
        self._worker.end()

    def _collect(self) -> None:
        if self.state is ev.TurnState.COLLECTING:
            for pair in self._pairer.take():
                self._tell(self.turn.take, pair, now())

    def _tell(self, happened: Callable[..., T], *facts: Any) -> T:
        """Report an event to the turn and carry out its commands; returns its answer."""
        before = self.state
        try:
            answer = happened(*facts)
            commands = self.turn.commands()
        except Exception as error:  # short of files even a median fails: its code must be read
            if happened != self.turn.break_off:
                was_under_way = {before, self.state} != {ev.TurnState.IDLE}
                self._tell(self.turn.break_off, _broken_off(error), was_under_way)
            raise
        for command in commands:
            self._do(command)
        return answer

    def _do(self, command: ev.Command) -> None:
        try:
            self._carry_out(command)
        except Exception as error:  # whatever has failed, all who wait are answered
            self._owner.note_error(error)
            self._tell(self.turn.break_off, _broken_off(error))

    def _carry_out(self, command: ev.Command) -> None:
        if isinstance(command, ev.MoveBase):
            self._owner.rotator.move(command.rate)
        elif isinstance(command, ev.Prepare):
            self._fits.run(self._worker.start, lambda _: None, lambda _: None)
        elif isinstance(command, ev.Preview):
            self._preview(command)
        elif isinstance(command, ev.FitTurn):
            self._fit(command)
        elif isinstance(command, ev.PutInForce):
            # The calibration is in force; a fault in storing it is only said.
            self._magnetometer.use(
                command.calibration, lambda done: self._tell(self.turn.note_saved, done.message)
            )
        elif isinstance(command, ev.Conclude):
            self._conclude(command.conclusion)

    def _preview(self, asked: ev.Preview) -> None:
        known, method = asked.brief.knowledge, asked.brief.method
        self._fits.run(
            lambda: self._worker.run(predicted_sigma, asked.window, known, method),
            lambda sigma: self._tell(self.turn.note_preview, asked.turn, sigma, now()),
            # A preview that failed predicts nothing; the fit will tell.
            lambda _: self._tell(self.turn.note_preview, asked.turn, math.inf, now()),
        )

    def _fit(self, asked: ev.FitTurn) -> None:
        brief = asked.brief
        turn = (asked.kept, asked.window, brief.knowledge, brief.method, brief.accumulate)
        self._fits.run(
            lambda: self._worker.run(take_turn, *turn),
            lambda found: self._tell(self.turn.note_fit, asked.turn, *found),
            lambda error: self._tell(self.turn.note_failed_fit, asked.turn, in_words(error)),
        )

    def _report(self, window: Window, outcome: Outcome) -> str:
        assert self._settings is not None
        try:
            return self._magnetometer.begin_report(window, self._settings, outcome)
        except Exception as error:  # the calibration matters more than a page about it
            self._owner.note_error(error)
            return f"No report: {error}."

    def _conclude(self, conclusion: ev.Conclusion) -> None:
        listeners, self._listeners = self._listeners, []
        self._unreported = None if listeners else conclusion
        # Whatever fails here, all who wait are answered.
        with contextlib.ExitStack() as at_last:
            for listener in listeners:
                at_last.callback(listener, conclusion)
            self._worker.stop()
            self._owner.turn_ended(self._magnetometer)
