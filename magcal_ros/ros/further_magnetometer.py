"""A magnetometer beside the first: its messages, its calibration and file, its turns."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

from rclpy.node import Node
from sensor_msgs.msg import MagneticField

from magcal_ros.core.calibrate import Outcome
from magcal_ros.core.calibration.calibration import Calibration
from magcal_ros.core.heading.compass import Compass
from magcal_ros.core.samples.gyro_at_rest import GyroAtRest
from magcal_ros.core.samples.streams import Drop, ImuSample, Streams
from magcal_ros.core.samples.window import Window
from magcal_ros.core.session.self_turn import Around, SelfTurn
from magcal_ros.core.session.turn_events import Conclusion, TurnState
from magcal_ros.files.default_paths import known_as
from magcal_ros.ros.background_thread import BackgroundThread
from magcal_ros.ros.calibration_loader import CalibrationLoader
from magcal_ros.ros.control import Control
from magcal_ros.ros.heading_pipeline import HeadingPipeline
from magcal_ros.ros.inputs import Inputs, Sensor
from magcal_ros.ros.keeper import CalibrationStore, Keeper
from magcal_ros.ros.outputs import FieldOutput
from magcal_ros.ros.reporter import Reporter
from magcal_ros.ros.sensor_loop import SENSOR_DATA
from magcal_ros.ros.services import Tell
from magcal_ros.ros.settings import Settings
from magcal_ros.ros.wire.incoming import Unreadable, read_field


class Listeners(NamedTuple):
    """What a further magnetometer calls when something happens to it.

    Parameters
    ----------
    meet : callable
        Called with it when its first message arrives.
    changed : callable
        Called when another calibration is in force.
    note_error : callable
        Called with an error that ends a turn.
    """

    meet: Callable[[FurtherMagnetometer], None]
    changed: Callable[[], None]
    note_error: Callable[[Exception], None]


class FurtherMagnetometer:
    """A magnetometer beside the one on `imu/mag`: its messages, calibration, file and turns.

    It is nothing but a subscription until its first message comes.
    """

    def __init__(
        self,
        node: Node,
        pipeline: HeadingPipeline,
        number: int,
        beside: Inputs,
        chosen: Callable[[], str],
        fits: BackgroundThread,
        files: BackgroundThread,
        listeners: Listeners,
    ) -> None:
        self.number, self._node, self._pipeline, self._listeners = number, node, pipeline, listeners
        self._name, self._chosen = f"imu/mag_{number}", chosen
        sensor = Sensor(node.resolve_topic_name(self._name))
        streams = Streams(beside.streams.max_gap)
        self.inputs = Inputs(beside.imu, sensor, streams)
        namespace, name = node.get_namespace(), node.get_name()
        self.keeper = Keeper(namespace, name, self._apply, chosen(), number)
        log = node.get_logger()
        self._loader = CalibrationLoader(self.keeper, files, chosen, log.info, log.error)
        self.store = CalibrationStore(self.keeper, files, self._path, self._sensor_file)
        self.control = Control(streams, self, SelfTurn(), fits, files)
        self._reporter, self._files, self._say = Reporter(log.error), files, log.info
        self._compass: Compass | None = None
        self._out: FieldOutput | None = None
        node.create_subscription(MagneticField, self._name, self._on_field, SENSOR_DATA, raw=True)

    @property
    def topic(self) -> str:
        """Where its field comes from."""
        return self.inputs.field.topic

    def on_imu(self, sample: ImuSample) -> None:
        """Take what its field is paired with."""
        self.inputs.streams.add_imu(sample)

    def start(self, gyro: GyroAtRest | None) -> None:
        """Collect the turn that begins; the robot is turned by whoever turns the first."""
        self._note_sensors()
        settings = self._pipeline.settled(self.number, self.inputs.field.frame)
        self.control.start(
            replace(settings, rotation=replace(settings.rotation, enabled=False)), gyro
        )

    @property
    def has_something_to_accept(self) -> bool:
        """Whether its last turn fitted a calibration that is not in force."""
        outcome = self.control.turn.last_outcome
        return (
            outcome is not None
            and outcome.calibration is not None
            and not outcome.verdict.accepted
            and not self.control.turn.outcome_is_of_others
            and self.control.state is TurnState.IDLE
        )

    def accept(self, tell: Tell) -> None:
        """Put what the last turn fitted in force."""
        outcome = self.control.turn.last_outcome
        assert outcome is not None
        assert outcome.calibration is not None
        self._reporter.put_in_force()
        self._files.run(
            self.put_in_force(outcome.calibration.on_users_word()),
            lambda words: tell(Conclusion(not self.keeper.trouble, words)),
            lambda error: tell(Conclusion(False, f"In force, but not saved: {error!r}")),
        )

    def reset(self) -> None:
        """Use no calibration any more."""
        self.control.forget_turns()
        self._loader.forget()
        if self.keeper.calibration is not None:
            self.keeper.reset()

    def repeat_bias(self, stamp: Any) -> None:
        """Publish the bias once more."""
        if self._out is not None:
            self._out.repeat_bias(stamp)

    def put_in_force(self, calibration: Calibration) -> Callable[[], str]:
        """Apply a calibration at once; returns the work of storing it, which says what it did."""
        origin = self._pipeline.origin_of(self.inputs.field.frame)
        self.keeper.put_in_force(calibration, origin)
        return self.keeper.store(self._path)

    def begin_report(self, window: Window, settings: Settings, outcome: Outcome) -> str:
        """Begin the report on a turn; returns where it will lie, in words."""
        sensor, by = self.inputs.field, self._reporter
        return self._pipeline.report(sensor, by, window, settings, outcome)

    def describe_silence(self) -> str:
        """Say what is missing, and what to look at."""
        complaints = self.inputs.complaints()
        return "; ".join(complaints) or "no new field sample with an acceleration has come"

    def move(self, rate: float) -> None:
        """Leave the base alone."""

    def look_around(self) -> Around:
        """Return what is around a robot that turns itself; this one has no part in it."""
        return Around(self.inputs.imu.age(), self.inputs.field.age(), 0, False, False)

    def turn_ended(self) -> None:
        """Say how its turn ended; those who called are told with all others."""
        conclusion = self.control.turn.last_conclusion
        assert conclusion is not None
        self._say(f"{self.topic}: {conclusion.message}")

    def _apply(self, calibration: Calibration | None, magnetometer_frame: str) -> None:
        self._compass = None if calibration is None else Compass(calibration)
        if self._out is not None:
            self._out.put_in_force(self._compass, magnetometer_frame)
        self._listeners.changed()

    def note_error(self, error: Exception) -> None:
        """Take note of an error that ends a turn."""
        self._listeners.note_error(error)

    def _note_sensors(self) -> None:
        frames = self.inputs.field.frame, self.inputs.imu.frame
        self.control.sensors_met(*map(known_as, frames))

    def _sensor_file(self) -> tuple[str, str]:
        return self._chosen(), self.inputs.field.frame

    def _path(self) -> Path:
        return self.keeper.path(*self._sensor_file())

    def _on_field(self, data: bytes) -> None:
        streams, sensor = self.inputs.streams, self.inputs.field
        try:
            arrived = read_field(data)
        except Unreadable:
            streams.field_drops[Drop.UNREADABLE] += 1
            return
        if sensor.heard(arrived.frame):
            if self._out is None:
                self._out = FieldOutput(self._node, self._name)
                self._listeners.meet(self)
            self._note_sensors()
            self._loader.meet(arrived.frame)
        if not streams.add_field(arrived.sample):
            return
        if self._compass is not None and self._out is not None:
            moment = self._pipeline.moment_of(self._compass, arrived.sample)
            self._out.publish(moment.field, arrived, self._pipeline.body_frame())
            self._pipeline.take(self.number, moment, arrived)
        if not streams.is_repeated:
            self.control.add(arrived.sample)
