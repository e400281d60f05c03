"""One magnetometer of the node: messages, calibration, file and turns."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable
from functools import partial
from time import monotonic as now
from typing import Any, Protocol, TypeVar

from sensor_msgs.msg import MagneticField

from magcal_ros.core.calibrate import Outcome, add_turn, predicted_sigma
from magcal_ros.core.calibration.calibration import Calibration
from magcal_ros.core.errors import in_words
from magcal_ros.core.heading.compass import Compass
from magcal_ros.core.samples.streams import DropReason, FieldSample, Pairer, Streams
from magcal_ros.core.samples.window import Window
from magcal_ros.core.session import turn_machine as tm
from magcal_ros.core.session.self_turn import SelfTurn, TurnConditions
from magcal_ros.core.session.session import TurnRequest
from magcal_ros.files.default_paths import identifier
from magcal_ros.files.wire import FIELD_TYPE
from magcal_ros.ros.announcer import CallbackErrors
from magcal_ros.ros.calibration_store import CalibrationStore, Tell
from magcal_ros.ros.guard import Rotator
from magcal_ros.ros.heading_pipeline import FIRST, HeadingPipeline, Inputs, Sensor
from magcal_ros.ros.outputs import FieldOutput
from magcal_ros.ros.parameters import Settings
from magcal_ros.ros.reporter import Reporter
from magcal_ros.ros.threads import SENSOR_DATA
from magcal_ros.ros.wire import Unreadable, read_field
from magcal_ros.ros.worker_process import WorkerProcess


class MagnetometerOwner(Protocol):
    """The callbacks of the node for events of a magnetometer."""

    rotator: Rotator
    callback_errors: CallbackErrors

    def sensors_changed(self, magnetometer: Magnetometer) -> None:
        """Note the first message of a sensor, or a new frame."""

    def sample_came(self, magnetometer: Magnetometer, sample: FieldSample) -> None:
        """Take a field sample before its heading is computed."""

    def calibration_changed(self, magnetometer: Magnetometer) -> None:
        """Use the new calibration in force."""

    def turn_ended(self, magnetometer: Magnetometer) -> None:
        """Publish the result of a turn, before the waiting callers are answered."""


class Magnetometer:
    """A magnetometer's messages, calibration, file and turns.

    A further magnetometer has only a subscription until its first message arrives.
    """

    def __init__(
        self,
        owner: MagnetometerOwner,
        pipeline: HeadingPipeline,
        number: int,
        robot: SelfTurn | None = None,
    ) -> None:
        node = self._node = pipeline.node
        self.owner, self.pipeline = owner, pipeline
        self.number, self._topic = number, topic_of(number)
        self.topic = node.resolve_topic_name(self._topic)
        streams = Streams(pipeline.settings.max_gap)
        self.inputs = inputs = Inputs(pipeline.imu, Sensor(self.topic, kind=FIELD_TYPE), streams)
        self.store = CalibrationStore(
            node, pipeline.files, self._apply, lambda: pipeline.settings.calibration_file, number
        )
        self.control = Control(self, robot)
        self.reporter = Reporter(node, inputs, pipeline.travel)
        self.compass: Compass | None = None
        is_first = number == FIRST
        self.out = FieldOutput(node, self._topic) if is_first else None
        if is_first:
            pipeline.sensor_group.subscribe(node, MagneticField, self._topic, self._on_field)
        else:
            node.create_subscription(
                MagneticField, self._topic, self._on_field, SENSOR_DATA, raw=True
            )

    def look_at_sensors(self) -> None:
        """Note the first message of a sensor, or a new frame."""
        frames = self.inputs.field.frame, self.inputs.imu.frame
        self.control.tell(self.control.turn.note_sensors, *map(identifier, frames))
        self.owner.sensors_changed(self)
        if self.inputs.field.messages:
            self.store.note_sensor(self.inputs.field.frame)

    def start(self) -> tm.Conclusion:
        """Start to collect a turn."""
        settings = self.pipeline.current_settings(self.number, self.inputs.field.frame)
        return self.control.start(settings)

    @property
    def acceptable(self) -> Calibration | str | None:
        """The last fit, or why it must not be put in force; None if there is none to accept."""
        turn, outcome = self.control.turn, self.control.turn.last_outcome
        if outcome is None or outcome.calibration is None:
            return None
        if self.number != FIRST and (outcome.verdict.accepted or turn.outcome_is_of_others):
            return None
        if turn.outcome_is_of_others:
            return "the last fit is of sensors other than the present ones"
        return outcome.calibration

    def use(self, calibration: Calibration, tell: Tell, with_backup: bool = True) -> None:
        """Put a calibration in force and save it; a success only if it is saved."""
        self.store.put_in_force(calibration, self.pipeline.origin_of(self.inputs.field.frame))
        self.store.save(tell, with_backup)

    def reset(self) -> None:
        """Put no calibration in force, and discard all that was read or collected."""
        self.control.turn.forget()
        self.store.forget()
        if self.store.calibration is not None:
            self.store.reset()

    def _apply(self, calibration: Calibration | None, magnetometer_frame: str) -> None:
        self.compass = None if calibration is None else Compass(calibration)
        if self.out is not None:
            self.out.put_in_force(self.compass, magnetometer_frame)
        self.owner.calibration_changed(self)

    def _on_field(self, data: bytes) -> None:
        streams = self.inputs.streams
        try:
            arrived = read_field(data)
        except Unreadable:
            streams.field_drops[DropReason.UNREADABLE] += 1
            return
        if self.inputs.field.note_message(arrived.frame):
            if self.out is None:
                self.out = FieldOutput(self._node, self._topic)
            self.look_at_sensors()
        sample = arrived.sample
        if not streams.add_field(sample, self.pipeline.up.turned):
            return
        self.owner.sample_came(self, sample)
        if self.compass is not None and self.out is not None:
            age = streams.max_gap, streams.turned_unchanged
            reading = self.pipeline.motors.reader.read(self.compass, sample, *age)
            self.out.publish(reading.measured, arrived, self.pipeline.body_frame())
            self.pipeline.take(self.number, reading, arrived)
        if not streams.is_repeated:
            self.control.add(sample)


def topic_of(number: int) -> str:
    """Return the topic of a magnetometer by its number, before remapping."""
    return "imu/mag" if number == FIRST else f"imu/mag_{number}"


SAVING_PATIENCE = 1.5
"""Seconds that a disk may take to store a calibration while the node shuts down."""

T = TypeVar("T")


def _broken_off(error: Exception) -> str:
    return f"the turn was stopped by an error ({error}); see the node's log"


class Control:
    """Reports events to the state machine of a turn, and carries out its commands.

    Samples are collected in the executor's thread, a few microseconds each. Fits run in a worker
    process and files are written in a thread, so that the outputs are not interrupted. `turn` is
    the state machine. Without a `robot`, no base is commanded.
    """

    def __init__(self, magnetometer: Magnetometer, robot: SelfTurn | None) -> None:
        self._commands_robot = robot is not None
        self._magnetometer, self._streams = magnetometer, magnetometer.inputs.streams
        self._owner, self._pipeline = magnetometer.owner, magnetometer.pipeline
        self._pairer = Pairer(self._streams)
        self._worker = WorkerProcess()
        store = magnetometer.store
        self.turn = tm.TurnMachine(robot, self._report, lambda: store.calibration is not None)
        self._settings: Settings | None = None
        self._listeners: list[Tell] = []
        self._unreported: tm.Conclusion | None = None

    def when_done(self, listener: Tell) -> None:
        """Call `listener` once with the conclusion of the present turn."""
        self._listeners.append(listener)

    def start(self, settings: Settings) -> tm.Conclusion:
        """Begin a turn; refused during another turn."""
        turns_itself = settings.rotation.enabled and self._commands_robot
        speed = settings.rotation.speed if turns_itself else None
        gyro = self._pipeline.up.gyro_at_rest
        asked = settings.knowledge, settings.method, settings.accumulate
        answer = self.tell(self.turn.open, TurnRequest(settings.limits, *asked, speed, gyro), now())
        if answer.success:
            self._settings, self._pairer = settings, Pairer(self._streams)
            self._unreported = None
        return answer

    def add(self, sample: FieldSample) -> None:
        """Take a field sample if a turn is being collected."""
        if self.turn.state is tm.TurnState.COLLECTING:
            self._pairer.offer(sample)
            self._collect()

    def finish(self) -> tm.Conclusion | None:
        """End the collection and fit the samples so far; None if the fit is running.

        The verdict on a turn that ended automatically without a waiting caller is returned once.
        """
        self._collect()
        unreported, self._unreported = self._unreported, None
        if unreported is not None:
            return unreported
        return self.tell(self.turn.finish, now())

    def tick(self) -> bool:
        """Check the progress of a turn; returns whether one is under way."""
        if self.turn.state is tm.TurnState.COLLECTING:
            self._collect()
            missing = "; ".join(self._magnetometer.inputs.complaints())
            missing = missing or "no new pair of field and acceleration samples has come"
            self.tell(self.turn.tick, missing, now())
        return self.turn.state is not tm.TurnState.IDLE

    def look(self, conditions: TurnConditions) -> bool:
        """Make a control step of a robot that turns itself; returns whether there are more."""
        self._collect()
        if self.turn.progress is not None:
            self.tell(self.turn.look, conditions, now())
        return not self.turn.robot.is_quiet

    def shut_down(self) -> None:
        """Discard a turn under way; a calibration in force is saved before this returns."""
        if self.turn.state is tm.TurnState.SAVING:
            self._pipeline.files.finish_within(SAVING_PATIENCE)
        self._worker.end()

    def _collect(self) -> None:
        if self.turn.state is tm.TurnState.COLLECTING:
            for pair in self._pairer.take():
                speed = self._pipeline.travel.estimator.wheel_speed(pair.field.stamp)
                self.tell(self.turn.take, pair, now(), speed, self._pipeline.motors.currents)

    def tell(self, happened: Callable[..., T], *facts: Any) -> T:
        """Report an event to the turn, carry out the commands, and return the turn's answer."""
        before = self.turn.state
        try:
            answer = happened(*facts)
            commands = self.turn.commands()
        except Exception as error:  # e.g. an import without free file descriptors
            if happened != self.turn.abort:
                was_under_way = {before, self.turn.state} != {tm.TurnState.IDLE}
                self.tell(self.turn.abort, _broken_off(error), was_under_way)
            raise
        for command in commands:
            self._do(command)
        return answer

    def _do(self, command: tm.Command) -> None:
        try:
            match command:
                case tm.MoveBase(rate):
                    self._owner.rotator.move(rate)
                case tm.Preview():
                    self._preview(command)
                case tm.FitTurn():
                    self._fit(command)
                case tm.PutInForce(calibration, gyro):
                    if gyro is not None:
                        self._pipeline.up.take_bias(gyro)
                    self._magnetometer.use(calibration, partial(self.tell, self.turn.note_saved))
                case tm.Conclusion():
                    self._conclude(command)
        except Exception as error:  # any error: all waiting callers must be answered
            self._owner.callback_errors.note(error)
            self.tell(self.turn.abort, _broken_off(error))

    def _preview(self, asked: tm.Preview) -> None:
        known, method = asked.request.knowledge, asked.request.method
        self._pipeline.fits.run(
            lambda: self._worker.run(predicted_sigma, asked.window, known, method),
            lambda sigma: self.tell(self.turn.note_preview, asked, sigma, now()),
            # After a failed preview the sigma is unknown; the fit will report the error.
            lambda _: self.tell(self.turn.note_preview, asked, math.inf, now()),
        )

    def _fit(self, asked: tm.FitTurn) -> None:
        request = asked.request
        turn = (asked.kept, asked.window, request.knowledge, request.method, request.accumulate)
        self._pipeline.fits.run(
            lambda: self._worker.run(add_turn, *turn),
            lambda found: self.tell(self.turn.note_fit, asked, *found),
            lambda error: self.tell(self.turn.note_failed_fit, asked, in_words(error)),
        )

    def _report(self, window: Window, outcome: Outcome) -> str:
        assert self._settings is not None
        try:
            return self._magnetometer.reporter.report(window, self._settings, outcome)
        except Exception as error:  # a failed report must not prevent the calibration
            self._owner.callback_errors.note(error)
            return f"No report: {error}."

    def _conclude(self, conclusion: tm.Conclusion) -> None:
        listeners, self._listeners = self._listeners, []
        self._unreported = None if listeners else conclusion
        # All waiting callers are answered, even if one of these calls fails.
        with contextlib.ExitStack() as at_last:
            for listener in listeners:
                at_last.callback(listener, conclusion)
            self._worker.stop()
            self._owner.turn_ended(self._magnetometer)
