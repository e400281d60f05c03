"""Messages of sensors and of travel from their bytes, several times faster than any library.

Both types have never changed, so their places in CDR (ROS 2) and in ROS 1's format are fixed:
a header with stamp and frame, and doubles after it.

`rosbag2_py` reads bags on a robot that has no other library, with the names that the library
rosbags gives. Checked against its published source from Humble to Rolling: before Jazzy the
metadata's duration is a `timedelta`, since then an `rclpy` Duration; Humble wants the storage
named.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from datetime import timedelta
from pathlib import Path
from struct import Struct, error
from typing import Any, NamedTuple, NoReturn

from magcal_ros.core.earth_field.reference import Fix
from magcal_ros.core.messages import fix_from, heading_from, imu_of, speed_from, velocity_from
from magcal_ros.core.samples.streams import (
    FieldSample,
    HeadingSample,
    ImuSample,
    SpeedSample,
    VelocitySample,
)
from magcal_ros.files.disk import FileTrouble

LITTLE_ENDIAN_CDR = b"\x00\x01"
CDR_START = 4
"""Bytes of encapsulation, from which CDR counts its alignment."""


class Layout(NamedTuple):
    """Where a format keeps the stamp, and how it aligns doubles.

    `head` is stamp seconds, nanoseconds and the frame's length; `start` its place in the bytes.
    """

    start: int
    head: Struct
    alignment: int
    ends_in_zero: bool


CDR = Layout(CDR_START, Struct("<iII"), 8, True)
ROS1 = Layout(4, Struct("<III"), 1, False)
"""ROS 1 puts a sequence number of four bytes before the stamp."""

# Orientation, rate and force, each with the first of its covariance.
IMU_BODY = Struct("<5d64x4d64x4d64x")
# Field and its covariance.
FIELD_BODY = Struct("<3d72s")


def imu_parser(layout: Layout) -> Callable[[bytes], tuple[bytes, ImuSample | None]]:
    """Return what turns the bytes of a sensor_msgs/Imu into the frame's bytes and the numbers.

    It raises `struct.error` if the bytes are laid out in another way.
    """
    head, body = _reader(layout), IMU_BODY.unpack_from

    def parse(data: bytes) -> tuple[bytes, ImuSample | None]:
        stamp, frame, place = head(data)
        x, y, z, w, no_yaw, wx, wy, wz, no_rate, fx, fy, fz, no_force = body(data, place)
        force, rate, orientation = (fx, fy, fz), (wx, wy, wz), (x, y, z, w)
        return frame, imu_of(stamp, force, no_force, rate, no_rate, orientation, no_yaw)

    return parse


def field_parser(layout: Layout) -> Callable[[bytes], tuple[bytes, FieldSample, bytes]]:
    """Return what turns the bytes of a MagneticField into frame, numbers and covariance.

    The covariance stays nine little-endian doubles: hardly any reader needs its numbers. It raises
    `struct.error` if the bytes are laid out in another way.
    """
    head, body = _reader(layout), FIELD_BODY.unpack_from

    def parse(data: bytes) -> tuple[bytes, FieldSample, bytes]:
        stamp, frame, place = head(data)
        x, y, z, covariance = body(data, place)
        return frame, FieldSample(stamp, (x, y, z)), covariance

    return parse


def is_plain_cdr(data: bytes) -> bool:
    """Whether a ROS 2 message is little-endian CDR, as all recorders on usual machines write."""
    return data[:2] == LITTLE_ENDIAN_CDR


def frame_of(text: bytes) -> str:
    """Return a frame as ROS reads it: to its first zero, and what is no text replaced."""
    return bytes(text).partition(b"\0")[0].decode("utf-8", "replace")


def _reader(layout: Layout) -> Callable[[bytes], tuple[float, bytes, int]]:
    """Return what reads stamp, frame and the place of the first double."""
    start, unpack, size = layout.start, layout.head.unpack_from, layout.head.size
    alignment, zero = layout.alignment, int(layout.ends_in_zero)
    first = start + size

    def read(data: bytes) -> tuple[float, bytes, int]:
        sec, nanosec, length = unpack(data, start)
        end = first + length
        place = end + (start - end) % alignment
        if zero and (not length or data[end - 1 : end] != b"\0"):
            raise error("the frame does not end in a zero")
        return sec + nanosec * 1e-9, data[first : end - zero], place

    return read


LENGTH = Struct("<I")
PLACE = Struct("<3d")
VELOCITY = Struct("<2d")
# After the other four numbers of a twist come the variances: of east first, of north as the eighth.
SURE_VELOCITY = Struct("<2d32xd48xd")
# An Odometry's pose with its covariance, then the twist with the first of its covariance.
ODOMETRY_BODY = Struct("<344x2d32xd")
# An Imu's orientation, and the first and the last of its covariance.
HEADING_BODY = Struct("<5d56xd")
# The current of a BatteryState stands after voltage and temperature.
CURRENT = Struct("<8xf")


def stamp_in(data: bytes) -> float:
    """Return the stamp of a message with a header, seconds."""
    stamp, _, _ = _header(data)
    return stamp


def fix_in(data: bytes) -> Fix:
    """Return what a sensor_msgs/NavSatFix says of its place."""
    stamp, _, at = _header(data)
    status = int.from_bytes(data[at : at + 1], "little", signed=True)
    service = _aligned(at + 1, 2)
    latitude, longitude, altitude = PLACE.unpack_from(data, _aligned(service + 2, 8))
    return fix_from(stamp, status, latitude, longitude, altitude)


def velocity_in(data: bytes) -> VelocitySample | str:
    """Return the velocity of a geometry_msgs/TwistStamped, or why it has none."""
    stamp, _, at = _header(data)
    return velocity_from(stamp, *VELOCITY.unpack_from(data, _aligned(at, 8)))


def sure_velocity_in(data: bytes) -> VelocitySample | str:
    """Return the velocity of a geometry_msgs/TwistWithCovarianceStamped, or why it has none."""
    stamp, _, at = _header(data)
    return velocity_from(stamp, *SURE_VELOCITY.unpack_from(data, _aligned(at, 8)))


def speed_in(data: bytes) -> SpeedSample | str:
    """Return the signed speed of a nav_msgs/Odometry, or why it has none."""
    stamp, world, at = _header(data)
    at = _aligned(at, 4)
    (size,) = LENGTH.unpack_from(data, at)
    at += LENGTH.size
    child = data[at : at + size - 1]
    x, y, mark = ODOMETRY_BODY.unpack_from(data, _aligned(at + size, 8))
    return speed_from(stamp, frame_of(world), frame_of(child), mark, x, y)


def heading_in(data: bytes) -> HeadingSample | str:
    """Return the yaw of a sensor_msgs/Imu's orientation, or why it has none."""
    stamp, _, at = _header(data)
    *orientation, mark, variance = HEADING_BODY.unpack_from(data, _aligned(at, 8))
    return heading_from(stamp, orientation, mark, variance)


def current_in(data: bytes) -> tuple[float, float]:
    """Return stamp (s) and current (A) of a sensor_msgs/BatteryState."""
    stamp, _, at = _header(data)
    return stamp, *CURRENT.unpack_from(data, _aligned(at, 4))


def _header(data: bytes) -> tuple[float, bytes, int]:
    """Return stamp (s) and frame of a message, and the place after them."""
    sec, nanosec, length = CDR.head.unpack_from(data, CDR.start)
    at = CDR.start + CDR.head.size
    return sec + nanosec * 1e-9, data[at : at + length - 1], at + length


def _aligned(at: int, size: int) -> int:
    """Return the next place at which CDR puts a number of so many bytes."""
    return at + (CDR.start - at) % size


STORAGES = {".mcap": "mcap", ".db3": "sqlite3"}


class Channel(NamedTuple):
    """A topic of the bag."""

    id: str
    topic: str
    msgtype: str
    msgcount: int


class RosReader:
    """An open rosbag2: a folder with metadata.yaml, or a single .mcap or .db3.

    `library` is the module `rosbag2_py`; it raises RuntimeError for what it cannot read.
    """

    is2 = True

    def __init__(self, path: Path, library: Any) -> None:
        self._path, self._library = path, library
        self._metadata = library.Info().read_metadata(str(path), _storage_of(path))
        self.message_count = int(self._metadata.message_count)
        self.connections = [
            Channel(about.name, about.name, about.type, int(topic.message_count))
            for topic in self._metadata.topics_with_message_count
            for about in (topic.topic_metadata,)
        ]
        # The metadata's own start is rounded to microseconds before Jazzy.
        first = next(self._everything(self.connections), None)
        self.start_time = 0 if first is None else first[2]
        self.end_time = self.start_time + _nanoseconds(self._metadata.duration) + 1

    def messages(
        self, connections: Iterable[Channel], start: int, stop: int
    ) -> Iterator[tuple[Channel, int, bytes]]:
        """Yield channel, time of recording in ns and bytes from `start` to before `stop`."""
        channels = {channel.topic: channel for channel in connections}
        for topic, data, stamp in self._everything(channels.values()):
            if stamp >= stop:
                # Messages are written as they come: a later one may be a little older.
                if stamp >= stop + LATE:
                    return
            elif stamp >= start and topic in channels:
                yield channels[topic], stamp, data

    def deserialize(self, _: bytes, msgtype: str) -> NoReturn:
        """Refuse what is not in the usual byte order, with a FileTrouble."""
        raise FileTrouble(
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


LATE = 5_000_000_000
"""Nanoseconds after the end of a span within which a message of the span may still come."""


def _storage_of(path: Path) -> str:
    """Return the storage by the file's name; a folder's metadata names it."""
    return STORAGES.get(path.suffix, "") if path.is_file() else ""


def _nanoseconds(duration: Any) -> int:
    if isinstance(duration, timedelta):
        return round(duration.total_seconds() * 1e9)
    return int(duration.nanoseconds)
