"""A magnetometer: its messages, its calibration and file, its turns."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Protocol

from rclpy.callback_groups import CallbackGroup
from rclpy.node import Node
from sensor_msgs.msg import MagneticField

from magcal_ros.core.calibrate import Outcome
from magcal_ros.core.calibration.calibration import Calibration
from magcal_ros.core.heading.compass import Compass
from magcal_ros.core.knowledge import Knowledge
from magcal_ros.core.monitoring.watch import Watch
from magcal_ros.core.samples import Drop, FieldSample, Window
from magcal_ros.core.samples.rest import GyroAtRest
from magcal_ros.core.session.self_turn import SelfTurn
from magcal_ros.core.session.turn_events import Conclusion, TurnState
from magcal_ros.files.default_paths import known_as
from magcal_ros.ros.control import Control, Robot
from magcal_ros.ros.heading_pipeline import FIRST, HeadingPipeline, Inputs
from magcal_ros.ros.keeper import Keeper, Tell
from magcal_ros.ros.outputs import FieldOutput
from magcal_ros.ros.parameters import Settings
from magcal_ros.ros.reporter import Reporter
from magcal_ros.ros.threads import SENSOR_DATA, BackgroundThread
from magcal_ros.ros.wire import Unreadable, read_field


class Owner(Robot, Protocol):
    """What happens in the node when something happens to a magnetometer."""

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
        self._topic = topic_of(number)
        name, log = (node.get_namespace(), node.get_name()), node.get_logger()
        self.keeper = Keeper(name, files, log, self._apply, chosen, number)
        self.control = Control(inputs.streams, self, owner, robot, fits, files)
        self._reporter = Reporter(BackgroundThread(node, "magcal-report"), log.error)
        self.compass: Compass | None = None
        self.watch: Watch | None = None
        """Watches the calibration of the first magnetometer."""
        self._out = FieldOutput(node, self._topic) if number == FIRST else None
        self.subscription = node.create_subscription(
            MagneticField, self._topic, self._on_field, SENSOR_DATA, raw=True, callback_group=group
        )

    @property
    def topic(self) -> str:
        """The full name of its topic."""
        return self.inputs.field.topic

    def look_at_sensors(self) -> None:
        """Take note of sensors that send for the first time, or under another name."""
        self._note_sensors()
        self._owner.sensors_changed(self)
        if self.inputs.field.last_heard is not None:
            self.keeper.note_sensor(self.inputs.field.frame)

    def start(self, gyro: GyroAtRest | None) -> Conclusion:
        """Collect the turn that begins."""
        self._note_sensors()
        settings = self._pipeline.settled(self.number, self.inputs.field.frame)
        if self.number != FIRST:
            # The first magnetometer's turn commands the robot.
            settings = replace(settings, rotation=replace(settings.rotation, enabled=False))
        return self.control.start(settings, gyro)

    @property
    def has_something_to_accept(self) -> bool:
        """Whether its last turn fitted a calibration that a person may accept."""
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
            tell(Conclusion(False, "the last fit is of other sensors than the present ones"))
            return
        self._reporter.put_in_force()
        self.use(outcome.calibration.on_users_word(), tell)

    def use(self, calibration: Calibration, tell: Tell, with_backup: bool = True) -> None:
        """Apply a calibration and store it; only what is stored as well is a success."""
        origin = self._pipeline.origin_of(self.inputs.field.frame)
        self.keeper.put_in_force_and_store(calibration, origin, tell, with_backup)

    def reset(self) -> None:
        """Use no calibration any more."""
        self.control.forget_turns()
        self.keeper.forget()
        if self.keeper.calibration is not None:
            self.keeper.reset()

    def repeat_bias(self, stamp: object) -> None:
        """Publish the bias once more."""
        if self._out is not None:
            self._out.repeat_bias(stamp)

    def drive_knowledge(self) -> Knowledge | None:
        """Return what is known beforehand of a drive; None while a turn is under way."""
        is_idle = self.control.state is TurnState.IDLE
        frame = self.inputs.field.frame
        return self._pipeline.settled(self.number, frame).knowledge if is_idle else None

    def begin_report(self, window: Window, settings: Settings, outcome: Outcome) -> str:
        """Begin the report on a turn; returns where it will lie, in words."""
        yaw = self._pipeline.travel.yaw
        words = "" if yaw is None else yaw.words
        return self._reporter.report(window, settings, outcome, self.inputs, words)

    def describe_silence(self) -> str:
        """Say which sensor is missing, and what to look at."""
        complaints = self.inputs.complaints()
        return "; ".join(complaints) or "no new field sample with an acceleration has come"

    def turn_ended(self) -> None:
        """Publish how a turn ended, before those who wait for it are answered."""
        self._owner.turn_ended(self)

    def _apply(self, calibration: Calibration | None, magnetometer_frame: str) -> None:
        self.compass = None if calibration is None else Compass(calibration)
        if self._out is not None:
            self._out.put_in_force(self.compass, magnetometer_frame)
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
            if self._out is None:
                self._out = FieldOutput(self._node, self._topic)
            self.look_at_sensors()
        sample = arrived.sample
        if not streams.add_field(sample):
            return
        self._owner.sample_came(self, sample)
        if self.compass is not None and self._out is not None:
            moment = self._pipeline.moment_of(self.compass, sample)
            self._out.publish(moment.field, arrived, self._pipeline.body_frame())
            self._pipeline.take(self.number, moment, arrived)
            if self.watch is not None:
                self.watch.take(moment)
        if not streams.is_repeated:
            self.control.add(sample)


def topic_of(number: int) -> str:
    """Return the topic of a magnetometer by its number, as it is before remapping."""
    return "imu/mag" if number == FIRST else f"imu/mag_{number}"
