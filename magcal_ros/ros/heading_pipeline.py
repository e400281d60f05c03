"""From a field message to the published heading; the state of the inputs; the reference field."""

from __future__ import annotations

import math
import time
from collections import Counter, deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from dataclasses import field as member

from rclpy.node import Node

from magcal_ros.core.calibration.calibration import Calibration
from magcal_ros.core.earth_field.reference import Fixes, Reference, made_elsewhere, resolve
from magcal_ros.core.earth_field.wmm import year_of
from magcal_ros.core.heading.compass import CompassReading
from magcal_ros.core.heading.several_compasses import SeveralCompasses
from magcal_ros.core.knowledge import ReferenceField
from magcal_ros.core.samples.samples_tuning import COMPLAINTS
from magcal_ros.core.samples.streams import Streams
from magcal_ros.core.samples.units import InputCounts, complaints
from magcal_ros.core.session.turn_machine import TurnState
from magcal_ros.core.up.follower import UpFollower
from magcal_ros.files.calibration_file import Origin
from magcal_ros.files.default_paths import identifier
from magcal_ros.files.wire import IMU_TYPE, FieldArrival
from magcal_ros.ros.announcer import Announcer
from magcal_ros.ros.calibration_store import CalibrationStore
from magcal_ros.ros.outputs import FusedOutput, HeadingOutput
from magcal_ros.ros.parameters import Parameters, Settings
from magcal_ros.ros.sensor_frames import SensorFrames
from magcal_ros.ros.threads import BackgroundThread, SensorGroup
from magcal_ros.ros.vehicle import Motors, Travel
from magcal_ros.ros.wire import published_instead

SILENT_AFTER = 2.0  # seconds without a message after which a sensor counts as silent

DROP_WINDOW = 60
"""Seconds over which dropped samples are counted for the complaints, so that complaints are about
the present state."""

RATE_LOOKS = 6  # newest seconds over which the rate of messages is computed


@dataclass
class Sensor:
    """One sensor topic: its messages, frame and publishers, and the time of the last message."""

    topic: str
    clock: Callable[[], float] = time.monotonic
    frame: str = ""
    last_received: float = -math.inf  # by `clock`; -inf before the first message
    messages: int = 0
    changes: int = 0
    kind: str = ""  # the message type of the subscription
    published: Sequence[str] = ()  # the message types of all publishers
    _frame_before: str = ""
    _looks: deque[tuple[float, int, int]] = member(default_factory=lambda: deque(maxlen=RATE_LOOKS))
    """Time, messages and changes of the frame at the last looks."""

    @property
    def rate(self) -> float:
        """Rate of the messages over the last seconds, Hz."""
        if len(self._looks) < 2:
            return 0.0
        (then, before, _), (now, after, _) = self._looks[0], self._looks[-1]
        return (after - before) / max(now - then, 1e-9)

    def note_message(self, frame: str) -> bool:
        """Note a message; returns whether it is the first, or its frame has changed."""
        is_first = not self.messages
        self.messages += 1
        self.last_received = self.clock()
        if frame == self.frame:
            return is_first
        if not is_first:
            self.changes += 1
            self._frame_before = self.frame
        self.frame = frame
        return True

    def look(self, published: Sequence[str] = ("",)) -> None:
        """Note messages, changes of the frame and all publishers' message types, once a second."""
        self.published = published
        self._looks.append((self.clock(), self.messages, self.changes))

    def age(self) -> float:
        """Return seconds since the last message; infinite if none came."""
        return self.clock() - self.last_received

    def complaint(self) -> str:
        """Return what is wrong with the topic and what to check; empty if nothing is."""
        if not self.messages:
            why = "check that the driver runs and the topic is remapped to it"
            instead = published_instead(self.kind, self.published)
            if instead:
                why = f"{instead}; remap it to the sensor's topic"
            return f"nothing has arrived on {self.topic}: {why}"
        silent = self.age()
        if silent > SILENT_AFTER:
            return f"{self.topic} has been silent for {silent:.0f} s: check its driver and cable"
        if len(self.published) > 1:
            return f"{len(self.published)} publishers on {self.topic}: only one can be the sensor"
        changes_before = self._looks[-2][2] if len(self._looks) > 1 else 0
        if self.changes - changes_before > 1:
            frames = map(identifier, sorted((self._frame_before, self.frame)))
            names = " and ".join(map(repr, frames))
            return f"the frame of {self.topic} changes between {names}: only one can be the sensor"
        return ""


@dataclass
class Inputs:
    """Both sensors and their streams of usable samples."""

    imu: Sensor
    field: Sensor
    streams: Streams
    _earlier: deque[tuple[InputCounts, InputCounts]] = member(
        default_factory=lambda: deque(maxlen=DROP_WINDOW)
    )

    def look(self) -> None:
        """Note, once a second, the counts of messages and of dropped samples."""
        self._earlier.append(self._received())

    def complaints(self) -> list[str]:
        """Return all faults of the inputs, in words."""
        found = [text for text in (self.imu.complaint(), self.field.complaint()) if text]
        imu, mag = self._received()
        if len(self._earlier) == DROP_WINDOW:
            imu, mag = map(InputCounts.since, (imu, mag), self._earlier[0])
        return found + complaints(self.streams, imu, mag)

    def _received(self) -> tuple[InputCounts, InputCounts]:
        imu, field, streams = self.imu, self.field, self.streams
        return (
            InputCounts(imu.topic, imu.messages, Counter(streams.imu_drops)),
            InputCounts(field.topic, field.messages, Counter(streams.field_drops)),
        )


INCOMPLETE_PLACE = "give reference.latitude_deg and reference.longitude_deg both, or neither"


class ReferenceSource:
    """Keeps the reference field up to date; `fixes` takes those of a receiver."""

    def __init__(self, node: Node, table: Parameters) -> None:
        self._node, self._table = node, table
        self.fixes = Fixes()
        self._calibration: Calibration | None = None
        self._settings: Settings | None = None
        self._announcer = Announcer(node, lasting=0.0)
        self._reference = Reference(ReferenceField(), "unknown")
        self.refresh()

    @property
    def reference(self) -> Reference:
        """The reference field in use, by the present parameters."""
        if self._table.settings is not self._settings:
            self.refresh()
        return self._reference

    @property
    def field(self) -> ReferenceField:
        """The field of `reference`."""
        return self.reference.field

    def use(self, calibration: Calibration | None) -> None:
        """From now on, compare the present place with that of a calibration."""
        self._calibration = calibration
        self.refresh()

    def refresh(self) -> None:
        """Evaluate parameters, place and date again, and log changes; about once a second."""
        before, self._reference = self._reference, self._resolve()
        say = self._announcer
        say.complain(self._reference.complaints)
        north, was = self._reference.north, before.north
        if self._calibration is not None and north != was:
            words = f"compass/yaw refers to {north} north from now on, no longer to {was} north"
            say.tell("north", words, wrong=True)
        if before.source != self._reference.source:
            say.tell("reference", f"reference field: {self._reference.words}")

    def _resolve(self) -> Reference:
        settings = self._settings = self._table.settings
        given = settings.knowledge.reference
        place = settings.given.place or self.fixes.place
        clock = self._node.get_clock().now().nanoseconds * 1e-9
        # A tenth of a year: by the fix or the node's clock, else by the machine's.
        year = round(year_of((self.fixes.stamp, clock), time.time()), 1)
        found = resolve(given, settings.given.local, place, year)
        notes = list(found.complaints)
        if settings.given.place is not None or not given.is_known:
            notes += self.fixes.complaints(settings.given.place)
        if settings.given.half_place:
            notes.append(INCOMPLETE_PLACE)
        if self._calibration is not None:
            notes.append(made_elsewhere(self._calibration, found.field))
        return replace(found, complaints=tuple(note for note in notes if note))


FIRST = 1  # number of the magnetometer on `imu/mag`; the second is on `imu/mag_2`


class HeadingPipeline:
    """Computes and publishes the heading from the messages of all magnetometers."""

    def __init__(self, node: Node, table: Parameters, group: SensorGroup) -> None:
        self.node, self._table, self.sensor_group = node, table, group
        self.fits, self.files = (BackgroundThread(node, f"magcal-{n}") for n in ("fit", "files"))
        self.imu = Sensor(node.resolve_topic_name("imu/data_raw"), kind=IMU_TYPE)
        self.up = UpFollower()
        self.reference = ReferenceSource(node, table)
        self.frames = SensorFrames(node, lambda: table.settings)
        self.travel = Travel(node, self.fits, group, self.reference.fixes.add)
        self.motors = Motors(node, self.up, self.travel)
        self.headings = HeadingOutput(node, self.frames)
        self.fused = FusedOutput(node, self.up, self.frames)
        self.compasses = SeveralCompasses()
        self.leading: Calibration | None = None  # of the calibrated magnetometer of lowest number
        self._origin: Origin | None = None
        self._stores: Mapping[int, CalibrationStore] = {}

    @property
    def settings(self) -> Settings:
        """The present parameters."""
        return self._table.settings

    def use(self, stores: Mapping[int, CalibrationStore]) -> None:
        """Use the calibrations in force; the keys are the numbers of the magnetometers."""
        self._stores = stores
        for number, store in stores.items():
            self.compasses.put_in_force(number, store.calibration)
        in_force = [number for number, store in stores.items() if store.calibration is not None]
        self.fused.is_needed = any(number > FIRST for number in in_force)
        leader = stores[min(in_force)] if in_force else None
        leading = None if leader is None else leader.calibration
        self._origin = None if leader is None else leader.origin
        if leading is not self.leading:
            self.leading = leading
            self.headings.begin_anew(leading)
            self.fused.begin_anew(leading)
            self.reference.use(leading)
            self.travel.use(self._origin.vehicle_yaw if self._origin else None)

    def follow(self, store: CalibrationStore, turn: TurnState, announcer: Announcer) -> None:
        """Once a second, take the parameters, and use and store what was learnt while driving."""
        # Results that came while the node had no executor.
        for thread in (self.fits, self.files):
            thread.deliver()
        self.fused.patience = self.settings.patience
        kept = None if store.calibration is None else store.calibration.motors
        mode, is_turning = self.settings.self_calibration, turn is not TurnState.IDLE
        store.keep(self.motors.follow(mode, is_turning, kept))
        self.reference.refresh()
        store.keep(self.travel.follow(self.reference.field, announcer))

    def take(self, number: int, reading: CompassReading, arrived: FieldArrival) -> None:
        """Publish the heading computed from a magnetometer's message."""
        if self.fused.is_needed:  # a calibration of a further magnetometer is in force
            joined = self.compasses.add(number, reading, self.up.newest_stamp, self.fused.yaw)
            if joined is None:
                return
            reading = joined
        self.headings.publish(reading, arrived.stamp, self.body_frame(), self.reference.field)
        self.fused.on_field(reading)
        if reading.heading is not None:
            self.travel.estimator.add_yaw(reading.heading.yaw)
            if self.headings.field_is_good:
                self.up.add_yaw(reading.stamp, reading.heading.yaw)

    def body_frame(self) -> str:
        """Return the IMU's frame."""
        return self.imu.frame or (self._origin.imu_frame if self._origin else "")

    def complaints(self) -> list[str]:
        """Return why the calibrations in force may not fit the sensors, in words."""
        found = [
            self.frames.doubt(number, store.origin.magnetometer_frame, store.calibration)
            for number, store in self._stores.items()
            if store.calibration is not None and store.origin is not None
        ]
        return [each for each in [*found, self._against_imu()] if each]

    def gyro_complaints(self) -> list[str]:
        """Return that the gyro is frozen, with the remedy; empty if nothing shows it."""
        turned = self.up.turned_unmeasured
        words = (
            f"{self.imu.topic} repeats one turn rate although the compass has turned by "
            f"{math.degrees(turned):.0f}°: the gyro is frozen, and the yaw follows the compass "
            "alone. Restart the driver of the IMU"
        )
        return [words] if turned > COMPLAINTS.frozen_turn else []

    def _against_imu(self) -> str:
        """Say that the calibration in force is of an IMU with another frame; else empty."""
        made_for = self._origin.imu_frame if self._origin else ""
        there = identifier(self.imu.frame)
        if not made_for or not there or made_for == there:
            return ""
        return (
            f"the calibration in force gives the field in the axes of {made_for!r}, but the IMU's "
            f"frame is {there!r}: calibrate again or, if the axes are the same, correct "
            "frames.field_body in the file of the calibration"
        )

    def current_settings(self, number: int = FIRST, frame: str = "") -> Settings:
        """Return the parameters for a turn of one magnetometer.

        The reference field in use replaces the one given by the parameters.
        """
        settings, mounting = self.settings, self.frames.mounting(number, frame)
        known = replace(settings.knowledge, reference=self.reference.field, mounting=mounting)
        return replace(settings, knowledge=known)

    def origin_of(self, magnetometer_frame: str) -> Origin:
        """Return the origin of a calibration that is made now."""
        node = self.node.get_fully_qualified_name()
        return Origin.now(magnetometer_frame, self.imu.frame, node, self.travel.yaw)
