"""Bags read lazily: rosbag2 (mcap, sqlite3) with ROS's own reader, or without ROS, and ROS 1."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Iterator
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from magcal_ros.core.earth_field.reference import Fix, LocalPlane, place_of
from magcal_ros.core.earth_field.wmm import Place
from magcal_ros.core.errors import Misuse
from magcal_ros.core.geometry.arrays import FloatArray
from magcal_ros.core.messages import (
    current_of,
    field_sample,
    fix_of,
    heading_of,
    imu_sample,
    speed_of,
    velocity_of,
)
from magcal_ros.core.samples.streams import HeadingSample, TravelSample
from magcal_ros.core.session.recorded import Reading
from magcal_ros.files import wire
from magcal_ros.files.disk import FileTrouble, damage_in_words, plain
from magcal_ros.files.wire import (
    RosReader,
    current_in,
    fix_in,
    heading_in,
    speed_in,
    sure_velocity_in,
    velocity_in,
)

if TYPE_CHECKING:
    from rosbags.highlevel import AnyReader
    from rosbags.interfaces import Connection

T = TypeVar("T")

IMU_TYPE = "sensor_msgs/msg/Imu"
FIELD_TYPE = "sensor_msgs/msg/MagneticField"
FIX_TYPE = "sensor_msgs/msg/NavSatFix"
BATTERY_TYPE = "sensor_msgs/msg/BatteryState"
ODOM_TYPE = "nav_msgs/msg/Odometry"
TWIST_TYPE = "geometry_msgs/msg/TwistStamped"
SURE_TWIST_TYPE = "geometry_msgs/msg/TwistWithCovarianceStamped"
NUMBERS: dict[str, tuple[Callable[[bytes], Any], Callable[[Any], Any]]] = {
    IMU_TYPE: (heading_in, heading_of),
    BATTERY_TYPE: (current_in, current_of),
    FIX_TYPE: (fix_in, fix_of),
    ODOM_TYPE: (speed_in, speed_of),
    TWIST_TYPE: (velocity_in, velocity_of),
    SURE_TWIST_TYPE: (sure_velocity_in, velocity_of),
}
"""How each type's numbers are read beside those of the sensors: from plain CDR, and from a
message."""
RECEIVERS_SAY = ("vel", "fix_velocity")
"""How topics of a receiver's velocity end, over ground in ENU; other twists are commands or the
body's. A bag without fixes has no receiver."""
MOST_FIXES = 10_000
"""Messages without a fix after which none is looked for any more."""

LATEST = 2**63 - 1
"""Nanoseconds: after every message."""

REMEDIES = {
    ".mcap": "`mcap recover IN -o OUT` saves what is whole",
    ".db3": "`sqlite3 IN .recover | sqlite3 OUT` with `ros2 bag reindex` saves what is whole",
    ".bag": "`rosbag reindex` saves what is whole",
}


class Bag:
    """The two sensor topics of an open bag, to be read once; a damaged one is a FileTrouble.

    Empty topics stand for the only one of the right type. `start` and `stop` are seconds from the
    bag's beginning, by its own clock. The frames are the newest `frame_id` of each topic, empty
    while unknown.
    """

    imu_frame = field_frame = ""
    notes: tuple[str, ...] = ()

    def __init__(
        self, path: Path, reader: Any, imu: str, field: str, start: float, stop: float
    ) -> None:
        self._path, self._reader = path, reader
        if not reader.message_count:
            raise FileTrouble(f"{plain(str(path))} holds no messages: record again")
        self._imu = _find(path, reader, IMU_TYPE, imu, "--imu")
        self._field = _find(path, reader, FIELD_TYPE, field, "--mag")
        self.imu_topic, self.field_topic = plain(self._imu[0].topic), plain(self._field[0].topic)
        self._first: int = reader.start_time + _nanoseconds(max(start, 0.0))
        self._end: int = min(reader.end_time, reader.start_time + _nanoseconds(stop))
        self._reached: int = self._first

    @property
    def share(self) -> float:
        """How much of the span has been read, 0 to 1."""
        return min(1.0, (self._reached - self._first) / max(self._end - self._first, 1))

    def readings(self) -> Iterator[Reading]:
        """Yield what the two topics say, in the order in which it was recorded."""
        layout = wire.CDR if self._reader.is2 else wire.ROS1
        of_imu, of_field = wire.imu_parser(layout), wire.field_parser(layout)
        fields = {connection.id for connection in self._field}
        imu_frame = field_frame = b""

        def take(connection: Connection, received: int, data: bytes) -> Reading:
            nonlocal imu_frame, field_frame
            self._reached, is_field = received, connection.id in fields
            if self._reader.is2 and not wire.is_plain_cdr(data):
                return self._slowly(connection, data, is_field)
            if is_field:
                frame, sample, _ = of_field(data)
                if frame != field_frame:
                    field_frame, self.field_frame = frame, wire.frame_of(frame)
                return sample
            frame, reading = of_imu(data)
            if frame != imu_frame:
                imu_frame, self.imu_frame = frame, wire.frame_of(frame)
            return reading

        return self._read([*self._imu, *self._field], take)

    def place(self) -> Place | None:
        """Return the place of the first good fix of the span; None if there is none."""
        fixes = islice(self._read(self._of(FIX_TYPE), self._numbers), MOST_FIXES)
        return next((each for each in map(place_of, fixes) if isinstance(each, Place)), None)

    def begun(self) -> float:
        """Return when the span begins by the bag's own clock, seconds."""
        return self._first * 1e-9

    def travel(self) -> list[TravelSample]:
        """Return what receiver and wheels said, by stamp; empty if nothing."""
        plane, found = LocalPlane(), list[TravelSample]()
        heard = self._of(FIX_TYPE, ODOM_TYPE)
        if self._of(FIX_TYPE):
            twists = self._of(TWIST_TYPE, SURE_TWIST_TYPE)
            heard += [c for c in twists if c.topic.rpartition("/")[2] in RECEIVERS_SAY]
        for sample in self._read(heard, self._numbers):
            if isinstance(sample, Fix):
                sample = plane.position(sample)
            if sample is not None and not isinstance(sample, str):
                found.append(sample)
        return sorted(found, key=lambda sample: sample.stamp)

    def yaw(self) -> FloatArray:
        """Return the yaws of an autopilot, (0, 2): only logs have them."""
        return np.empty((0, 2))

    def currents(self) -> list[tuple[float, float]]:
        """Return stamps, seconds, and currents of the battery, A; empty if there is none."""
        heard = self._of(BATTERY_TYPE)
        # Several batteries are no one current.
        if len({c.topic for c in heard}) != 1:
            return []

        def take(connection: Connection, received: int, data: bytes) -> tuple[float, float]:
            stamp, current = self._numbers(connection, received, data)
            # Zero stamps are usual in drivers of batteries.
            return stamp or received * 1e-9, current

        return sorted(self._read(heard, take))

    def headings(self, topic: str) -> list[HeadingSample]:
        """Return the yaws of a topic's orientations, by stamp.

        Misuse if there is no such topic, FileTrouble if it gives no heading.
        """
        heard = _named(self._path, self._reader, IMU_TYPE, topic)
        read = list(self._read(heard, self._numbers))
        found = [each for each in read if not isinstance(each, str)]
        if not found:
            why = read[-1] if read else "it is empty"
            raise FileTrouble(f"{plain(topic)} gives no heading: {why}")
        return sorted(found, key=lambda sample: sample.stamp)

    def _numbers(self, connection: Connection, _: int, data: bytes) -> Any:
        """Return what `NUMBERS` reads in a message."""
        from_bytes, from_message = NUMBERS[connection.msgtype]
        if self._reader.is2 and wire.is_plain_cdr(data):
            return from_bytes(data)
        return from_message(self._reader.deserialize(data, connection.msgtype))

    def _of(self, *kinds: str) -> list[Connection]:
        """Return the connections of some types that hold messages."""
        return [c for c in self._reader.connections if c.msgtype in kinds and c.msgcount]

    def _read(
        self, heard: list[Connection], take: Callable[[Connection, int, bytes], T]
    ) -> Iterator[T]:
        """Yield what `take` makes of connection, time of recording (ns) and bytes of the span."""
        # The library rosbags takes no connections for all of them.
        if heard:
            with _damage_in_words(self._path):
                for connection, received, data in self._reader.messages(
                    heard, self._first, self._end
                ):
                    yield take(connection, received, data)

    def _slowly(self, connection: Connection, data: bytes, is_field: bool) -> Reading:
        """Let the library take apart what is not in the usual byte order."""
        message: Any = self._reader.deserialize(data, connection.msgtype)
        if is_field:
            self.field_frame = message.header.frame_id
            return field_sample(message)
        self.imu_frame = message.header.frame_id
        return imu_sample(message)


@contextlib.contextmanager
def open_bag(path: Path, imu: str, field: str, start: float, stop: float) -> Iterator[Bag]:
    """Open a bag; arguments and errors as of `open_recording`."""
    _refuse_other_files(path)
    with contextlib.ExitStack() as stack:
        with _damage_in_words(path):
            reader = _ros_reader(path) or stack.enter_context(_library_reader(path))
        yield Bag(path, reader, imu, field, start, stop)


def _ros_reader(path: Path) -> Any:
    """Return a reader of ROS's own; None where there is no ROS, and for bags of ROS 1."""
    if path.suffix == ".bag":
        return None
    try:
        import rosbag2_py
    except ImportError:
        return None
    return RosReader(path, rosbag2_py)


def _library_reader(path: Path) -> AnyReader:
    try:
        from rosbags.highlevel import AnyReader
        from rosbags.typesys import Stores, get_typestore
    except ImportError as error:
        raise FileTrouble(
            f"reading {plain(str(path))} needs ROS 2 (source its setup file) or the Python library "
            "rosbags (in a virtual environment: pip install rosbags)"
        ) from error
    # Bags of old distributions do not carry their types: these two never changed.
    return AnyReader([path], default_typestore=get_typestore(Stores.ROS2_HUMBLE))


def _refuse_other_files(path: Path) -> None:
    if path.is_dir():
        if not (path / "metadata.yaml").exists():
            raise FileTrouble(
                f"{plain(str(path))} is no recording: a CSV folder has imu.csv and mag.csv, a "
                "phone's folder accelerometer, gyroscope and magnetometer as CSV, a bag "
                "has metadata.yaml (`ros2 bag reindex` writes it; a single .mcap or .db3 may be "
                "named itself)"
            )
    elif path.suffix not in REMEDIES:
        raise FileTrouble(
            f"{plain(str(path))} is no recording: name a bag (folder, .mcap, .db3, .bag), a "
            "folder with imu.csv and mag.csv, a log of ArduPilot (.BIN, .log, .tlog) or PX4 "
            "(.ulg), or the unpacked folder of a phone's Sensor Logger or phyphox"
        )
    for file in path.rglob("*") if path.is_dir() else [path]:
        # A pipe would be waited for.
        if file.exists() and not (file.is_file() or file.is_dir()):
            raise FileTrouble(f"cannot read {plain(str(file))}: it is not a regular file")


def _damage_in_words(path: Path) -> contextlib.AbstractContextManager[None]:
    return damage_in_words(path, "cut short", lambda: _remedy(path))


def _remedy(path: Path) -> str:
    files = sorted(path.iterdir()) if path.is_dir() else [path]
    kinds = [file.suffix for file in files if file.suffix in REMEDIES]
    remedy = REMEDIES.get(kinds[0], "") if kinds else ""
    return f"Record again; {remedy}." if remedy else "Record again."


def _find(path: Path, reader: Any, msgtype: str, wanted: str, option: str) -> list[Connection]:
    """Return the connections of the wanted topic, or of the only one of this type."""
    if wanted:
        return _named(path, reader, msgtype, wanted)
    fitting = [c for c in reader.connections if c.msgtype == msgtype and c.msgcount]
    topics = sorted({connection.topic for connection in fitting})
    kind = msgtype.replace("/msg/", "/")
    if not topics:
        raise FileTrouble(
            f"{plain(str(path))} has no {kind} messages; it has: {_listed(reader)}. "
            "Record the IMU's and the magnetometer's topics"
        )
    if len(topics) > 1:
        names = ", ".join(plain(topic) for topic in topics)
        raise Misuse(
            f"{plain(str(path))} has {len(topics)} topics of {kind}: {names}; "
            f"choose one with {option}"
        )
    return fitting


def _named(path: Path, reader: Any, msgtype: str, wanted: str) -> list[Connection]:
    found = [c for c in reader.connections if c.topic == wanted]
    if not found:
        raise FileTrouble(
            f"{plain(str(path))} has no topic {plain(wanted)}; it has: {_listed(reader)}"
        )
    wrong = next((c.msgtype for c in found if c.msgtype != msgtype), None)
    if wrong is not None:
        raise FileTrouble(
            f"{plain(wanted)} is {plain(wrong)}, not {msgtype}; the bag has: {_listed(reader)}"
        )
    return found


def _listed(reader: Any) -> str:
    names = sorted({f"{plain(c.topic)} ({plain(c.msgtype)})" for c in reader.connections})
    return ", ".join(names) or "nothing"


def _nanoseconds(seconds: float) -> int:
    return LATEST if math.isinf(seconds) else min(round(seconds * 1e9), LATEST)
