"""Bags, read message by message: rosbag2 (mcap, sqlite3), with or without ROS, and ROS 1."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Iterable, Iterator
from datetime import timedelta
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, NoReturn, TypeVar

import numpy as np

from magcal_ros.core.earth_field.wmm import Place
from magcal_ros.core.errors import UsageError
from magcal_ros.core.samples.streams import HeadingSample, TravelSample
from magcal_ros.core.session.external_heading import wrong_clock
from magcal_ros.core.session.recorded import Reading
from magcal_ros.files.disk import FileError, damage_in_words, printable
from magcal_ros.files.recording import travel_of
from magcal_ros.files.wire import CDR, FIELD_TYPE, IMU_TYPE, ROS1, Format, is_plain_cdr, seconds

if TYPE_CHECKING:
    from rosbags.highlevel import AnyReader
    from rosbags.interfaces import Connection

T = TypeVar("T")

FIX_TYPE = "sensor_msgs/msg/NavSatFix"
BATTERY_TYPE = "sensor_msgs/msg/BatteryState"
ODOM_TYPE = "nav_msgs/msg/Odometry"
TWIST_TYPE = "geometry_msgs/msg/TwistStamped"
TWIST_COVARIANCE_TYPE = "geometry_msgs/msg/TwistWithCovarianceStamped"
TRAVEL: dict[str, Callable[[Format, bytes], Any]] = {
    FIX_TYPE: Format.fix,
    ODOM_TYPE: Format.speed,
    TWIST_TYPE: Format.velocity,
    TWIST_COVARIANCE_TYPE: Format.velocity_with_covariance,
}
USED_OF_SEVERAL = {ODOM_TYPE: "odom", FIX_TYPE: "fix"}
"""Last part of the topic that is used of several with one type, the node's name for it. Filters
publish these types, too, and a navsat_transform publishes zeros as the speed."""
RECEIVER_TOPICS = ("vel", "fix_velocity")
"""Last part of the topics with a receiver's velocity over ground in ENU. Other twists are commands
or in body axes. A bag without fixes has no receiver."""

LATEST = 2**63 - 1  # nanoseconds: after every message

REMEDIES = {
    ".mcap": "`mcap recover IN -o OUT` saves the intact part",
    ".db3": "`sqlite3 IN .recover | sqlite3 OUT` with `ros2 bag reindex` saves the intact part",
    ".bag": "`rosbag reindex` saves the intact part",
}

STORAGES = {".mcap": "mcap", ".db3": "sqlite3"}

LATE = 5_000_000_000
"""Nanoseconds after the end of a span within which its messages may still be recorded."""


class Bag:
    """The two sensor topics of an open bag; FileError if the bag is damaged.

    An empty topic means the only topic of the right type. `start` and `stop` are seconds from the
    bag's beginning, by the time of recording. The frames are the newest `frame_id` of each topic,
    empty while unknown.
    """

    imu_frame = field_frame = ""
    yaw = np.empty((0, 2))
    """Empty: only logs have the yaws of an autopilot."""

    def __init__(
        self, path: Path, reader: Any, imu: str, field: str, start: float, stop: float
    ) -> None:
        self._path, self._reader = path, reader
        self._format = CDR if reader.is2 else ROS1
        if not reader.message_count:
            raise FileError.of(path, "holds no messages: record again")
        self._imu = self._find(IMU_TYPE, imu, "--imu")
        self._field = self._find(FIELD_TYPE, field, "--mag")
        self.imu_topic = printable(self._imu[0].topic)
        self.field_topic = printable(self._field[0].topic)
        self._first: int = reader.start_time + _nanoseconds(max(start, 0.0))
        self._end: int = min(reader.end_time, reader.start_time + _nanoseconds(stop))
        share = (self._end - self._first) / max(reader.end_time - reader.start_time, 1)
        self.count = round(share * sum(c.msgcount for c in (*self._imu, *self._field)))
        """Approximate number of messages of both sensors in the span."""
        self.notes = tuple(filter(None, map(self._choice, USED_OF_SEVERAL)))

    def readings(self) -> Iterator[Reading]:
        """Yield the samples of both topics in the order in which they were recorded."""
        of_imu, of_field = self._format.imu, self._format.field
        field_topic = self._field[0].topic

        def take(connection: Connection, _at: int, data: bytes) -> Reading:
            if connection.topic == field_topic:
                self.field_frame, sample, *_ = of_field(data)
                return sample
            self.imu_frame, reading, _ = of_imu(data)
            return reading

        return self._read([*self._imu, *self._field], take)

    @property
    def first_stamp(self) -> float:
        """Time of recording at which the span begins, seconds."""
        return self._first * 1e-9

    @property
    def place(self) -> Place | None:
        """The place of the first good fix of the span; None if there is none."""
        return self._journey[1]

    @property
    def travel(self) -> tuple[TravelSample, ...]:
        """The samples of receiver and wheels, by stamp; empty if there are none."""
        return self._journey[0]

    @cached_property
    def _journey(self) -> tuple[tuple[TravelSample, ...], Place | None]:
        fixes = self._one_of(FIX_TYPE)
        chosen = [*fixes, *self._one_of(ODOM_TYPE)]
        if fixes:
            twists = self._of(TWIST_TYPE, TWIST_COVARIANCE_TYPE)
            chosen += [c for c in twists if c.topic.rpartition("/")[2] in RECEIVER_TOPICS]

        def take(connection: Connection, _: int, data: bytes) -> Any:
            return TRAVEL[connection.msgtype](self._format, data)

        # A message without a fix, speed or velocity gives the reason as text instead.
        found = self._read(chosen, take)
        return travel_of(each for each in found if not isinstance(each, str))

    @cached_property
    def currents(self) -> list[tuple[float, float]]:
        """Stamps, seconds, and currents of the battery, A; empty if there is none."""
        chosen = self._of(BATTERY_TYPE)
        # With several batteries, the total current is not known.
        if len({c.topic for c in chosen}) != 1:
            return []

        def take(connection: Connection, received: int, data: bytes) -> tuple[float, float]:
            if self._reader.is2:
                stamp, current = CDR.current(data)
            else:  # in some distributions of ROS 1, no temperature precedes the current
                message: Any = self._reader.deserialize(data, connection.msgtype)
                stamp, current = seconds(message.header.stamp), float(message.current)
            # Drivers of batteries often leave the stamp at zero.
            return stamp or received * 1e-9, current

        return sorted(self._read(chosen, take))

    def headings(self, topic: str) -> list[HeadingSample]:
        """Return the yaws of a topic's orientations, sorted by stamp.

        FileError if there is no such topic of IMU messages, or none of them gives a heading.
        """
        chosen, header = self._named(IMU_TYPE, topic), self._format.header
        found, late, imu_late, why = list[HeadingSample](), list[float](), math.inf, "it is empty"

        def take(connection: Connection, received: int, data: bytes) -> None:
            nonlocal imu_late, why
            if connection.topic != topic:
                imu_late = received * 1e-9 - header(data)[0]
            elif isinstance(sample := self._format.heading(data), str):
                why = sample
            else:
                found.append(sample)
                # The clock of the recorder may be slower or faster, as beside a simulator.
                late.append(received * 1e-9 - sample.stamp - imu_late)

        list(self._read([c for c in self._imu if c not in chosen] + chosen, take))
        if found:
            why = wrong_clock(float(np.median(late)), self.imu_topic)
        if why:
            raise FileError(f"{printable(topic)} gives no heading: {why}")
        return sorted(found, key=lambda sample: sample.stamp)

    def _find(self, msgtype: str, wanted: str, option: str) -> list[Connection]:
        """Return the connections of the wanted topic, or of the only one of this type."""
        if wanted:
            return self._named(msgtype, wanted)
        fitting = self._of(msgtype)
        topics = sorted({connection.topic for connection in fitting})
        kind = msgtype.replace("/msg/", "/")
        if not topics:
            words = f"has no {kind} messages; it has: {self._listed()}"
            raise FileError.of(
                self._path, f"{words}. Record the IMU's and the magnetometer's topics"
            )
        if len(topics) > 1:
            names = f"{len(topics)} topics of {kind}: {', '.join(map(printable, topics))}"
            bag = printable(str(self._path))
            raise UsageError(f"{bag} has {names}; choose one with {option}")
        return fitting

    def _named(self, msgtype: str, wanted: str) -> list[Connection]:
        found = [c for c in self._reader.connections if c.topic == wanted]
        wrong = [f"{printable(c.msgtype)}, not {msgtype}" for c in found if c.msgtype != msgtype]
        if wrong:
            raise FileError(f"{printable(wanted)} is {wrong[0]}; the bag has: {self._listed()}")
        if not found:
            words = f"has no topic {printable(wanted)}; it has: {self._listed()}"
            raise FileError.of(self._path, words)
        return found

    def _listed(self) -> str:
        every = self._reader.connections
        names = {f"{printable(c.topic)} ({printable(c.msgtype)})" for c in every}
        return ", ".join(sorted(names)) or "nothing"

    def _of(self, *kinds: str) -> list[Connection]:
        """Return the connections of some types that hold messages."""
        return [c for c in self._reader.connections if c.msgtype in kinds and c.msgcount]

    def _one_of(self, kind: str) -> list[Connection]:
        """Return the connections of the topic that is used of a type; empty without any."""
        found = self._of(kind)
        last = USED_OF_SEVERAL[kind]
        named = [c for c in found if c.topic.rpartition("/")[2] == last] or found
        used = min((c.topic for c in named), default="")
        return [c for c in found if c.topic == used]

    def _choice(self, kind: str) -> str:
        """Say which of several topics of a type is used; empty if there are not several."""
        topics = sorted({printable(c.topic) for c in self._of(kind)})
        if len(topics) < 2:
            return ""
        used = printable(self._one_of(kind)[0].topic)
        return f"{', '.join(topics)} are all {kind.replace('/msg/', '/')}: only {used} is used"

    def _read(
        self, chosen: list[Connection], take: Callable[[Connection, int, bytes], T]
    ) -> Iterator[T]:
        """Yield `take(connection, time of recording in ns, bytes)` of each message in the span."""
        reader = self._reader
        if not chosen:
            return  # the library rosbags would read all connections
        with _damage_in_words(self._path):
            for connection, received, data in reader.messages(chosen, self._first, self._end):
                if reader.is2 and not is_plain_cdr(data):
                    # The library converts big-endian messages.
                    kind, store = connection.msgtype, reader.typestore
                    message = reader.deserialize(data, kind)
                    data = bytes(store.serialize_cdr(message, kind, little_endian=True))
                yield take(connection, received, data)


@contextlib.contextmanager
def open_bag(path: Path, imu: str, field: str, start: float, stop: float) -> Iterator[Bag]:
    """Open a bag; arguments and errors are those of `open_recording`."""
    _refuse_other_files(path)
    with contextlib.ExitStack() as stack:
        with _damage_in_words(path):
            reader = _ros_reader(path) or stack.enter_context(_library_reader(path))
        yield Bag(path, reader, imu, field, start, stop)


class Channel(NamedTuple):
    """A topic of the bag."""

    topic: str
    msgtype: str
    msgcount: int


class RosReader:
    """An open rosbag2: a folder with metadata.yaml, or a single .mcap or .db3.

    `library` is the module `rosbag2_py`, which every robot with ROS 2 has. It raises RuntimeError
    if it cannot read a bag. The attributes have the names of the library rosbags. From Humble to
    Rolling, rosbag2_py differs in two points: the metadata's duration is a `timedelta` before Jazzy
    and an `rclpy` Duration since then, and Humble needs the name of the storage.
    """

    is2 = True

    def __init__(self, path: Path, library: Any) -> None:
        self._path, self._library = path, library
        self._metadata = library.Info().read_metadata(str(path), _storage_of(path))
        self.message_count = int(self._metadata.message_count)
        self.connections = [
            Channel(about.name, about.type, int(topic.message_count))
            for topic in self._metadata.topics_with_message_count
            for about in (topic.topic_metadata,)
        ]
        # Before Jazzy, the start in the metadata is rounded to microseconds.
        first = next(self._everything(self.connections), None)
        self.start_time = 0 if first is None else first[2]
        duration = self._metadata.duration
        if isinstance(duration, timedelta):
            length = round(duration.total_seconds() * 1e9)
        else:
            length = int(duration.nanoseconds)
        self.end_time = self.start_time + length + 1

    def messages(
        self, connections: Iterable[Channel], start: int, stop: int
    ) -> Iterator[tuple[Channel, int, bytes]]:
        """Yield channel, time of recording in ns and bytes from `start` to before `stop`."""
        channels = {channel.topic: channel for channel in connections}
        for topic, data, stamp in self._everything(channels.values()):
            if stamp >= stop:
                # Messages are written in the order of arrival, not exactly that of their times.
                if stamp >= stop + LATE:
                    return
            elif stamp >= start and topic in channels:
                yield channels[topic], stamp, data

    def deserialize(self, _: bytes, msgtype: str) -> NoReturn:
        """Raise a FileError: this reader does not convert big-endian messages."""
        raise FileError(
            f"{self._path} has {msgtype} messages in big-endian byte order: read it where the "
            "Python library rosbags is installed and ROS is not"
        )

    def _everything(self, channels: Iterable[Channel]) -> Iterator[tuple[str, bytes, int]]:
        library = self._library
        storage = self._metadata.storage_identifier or _storage_of(self._path)
        is_packed = bool(self._metadata.compression_mode or self._metadata.compression_format)
        kind = library.SequentialCompressionReader if is_packed else library.SequentialReader
        reader = kind()
        reader.open(
            library.StorageOptions(uri=str(self._path), storage_id=storage),
            library.ConverterOptions("cdr", "cdr"),
        )
        reader.set_filter(library.StorageFilter(topics=[channel.topic for channel in channels]))
        while reader.has_next():
            yield reader.read_next()


def _storage_of(path: Path) -> str:
    """Return the storage by the file's suffix; empty for a folder, whose metadata names it."""
    return STORAGES.get(path.suffix, "") if path.is_file() else ""


def _ros_reader(path: Path) -> Any:
    """Return a reader that uses rosbag2_py; None without ROS 2, and for bags of ROS 1."""
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
        raise FileError(
            f"reading {printable(str(path))} needs ROS 2 (source its setup file) or the Python "
            "library rosbags (in a virtual environment: pip install rosbags)"
        ) from error
    # Bags of old distributions lack type definitions. The types of sensor messages never changed.
    return AnyReader([path], default_typestore=get_typestore(Stores.ROS2_HUMBLE))


def _refuse_other_files(path: Path) -> None:
    if path.is_dir():
        if not (path / "metadata.yaml").exists():
            raise FileError.of(
                path,
                "is not a recording: a CSV folder has imu.csv and mag.csv, a phone's folder "
                "accelerometer, gyroscope and magnetometer as CSV, a bag has metadata.yaml (`ros2 "
                "bag reindex` writes it; a single .mcap or .db3 may be named itself)",
            )
    elif path.suffix not in REMEDIES:
        raise FileError.of(
            path,
            "is not a recording: name a bag (folder, .mcap, .db3, .bag), a folder with imu.csv and "
            "mag.csv, a log of ArduPilot (.BIN, .log, .tlog) or PX4 (.ulg), or the unpacked folder "
            "of a phone's Sensor Logger or phyphox",
        )
    for file in path.rglob("*") if path.is_dir() else [path]:
        # Opening a pipe would block.
        if file.exists() and not (file.is_file() or file.is_dir()):
            raise FileError(f"cannot read {printable(str(file))}: it is not a regular file")


def _damage_in_words(path: Path) -> contextlib.AbstractContextManager[None]:
    files = sorted(path.iterdir()) if path.is_dir() else [path]
    found = [REMEDIES[file.suffix] for file in files if file.suffix in REMEDIES]
    remedy = f"Record again; {found[0]}." if found else "Record again."
    return damage_in_words(path, "cut short", remedy)


def _nanoseconds(seconds: float) -> int:
    return round(min(seconds * 1e9, LATEST))
