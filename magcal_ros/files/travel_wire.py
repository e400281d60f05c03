"""Speeds and fixes straight from the bytes of their messages, plain CDR.

All raise `struct.error` where the bytes are not laid out like that.
"""

from __future__ import annotations

from struct import Struct

from magcal_ros.core.earth_field.position import Fix
from magcal_ros.core.messages import fix_from, speed_from, velocity_from
from magcal_ros.core.samples.travel_samples import SpeedSample, VelocitySample
from magcal_ros.files.wire import CDR, frame_of

LENGTH = Struct("<I")
PLACE = Struct("<3d")
LINEAR, NUMBER = Struct("<2d"), Struct("<d")
TWIST_SIZE = 8 * 6
NORTH_VARIANCE = 8 * 7
"""Where it stands in the covariance of a twist, after that of east."""
POSE_SIZE = 8 * (7 + 36)
"""Bytes of an Odometry's pose with its covariance."""


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
    east, north = LINEAR.unpack_from(data, _aligned(at, 8))
    return velocity_from(stamp, east, north)


def sure_velocity_in(data: bytes) -> VelocitySample | str:
    """Return the velocity of a geometry_msgs/TwistWithCovarianceStamped, or why it has none."""
    stamp, _, at = _header(data)
    at = _aligned(at, 8)
    east, north = LINEAR.unpack_from(data, at)
    (of_east,) = NUMBER.unpack_from(data, at + TWIST_SIZE)
    (of_north,) = NUMBER.unpack_from(data, at + TWIST_SIZE + NORTH_VARIANCE)
    return velocity_from(stamp, east, north, of_east, of_north)


def speed_in(data: bytes) -> SpeedSample | str:
    """Return the signed speed of a nav_msgs/Odometry, or why it has none."""
    stamp, world, at = _header(data)
    at = _aligned(at, 4)
    (size,) = LENGTH.unpack_from(data, at)
    at += LENGTH.size
    child = data[at : at + size - 1]
    at = _aligned(at + size, 8) + POSE_SIZE
    x, y = LINEAR.unpack_from(data, at)
    (mark,) = NUMBER.unpack_from(data, at + TWIST_SIZE)
    return speed_from(stamp, frame_of(world), frame_of(child), mark, x, y)


def _header(data: bytes) -> tuple[float, bytes, int]:
    """Return stamp (s) and frame of a message, and the place after them."""
    sec, nanosec, length = CDR.head.unpack_from(data, CDR.start)
    at = CDR.start + CDR.head.size
    return sec + nanosec * 1e-9, data[at : at + length - 1], at + length


def _aligned(at: int, size: int) -> int:
    """Return the next place at which CDR puts a number of so many bytes."""
    return at + (CDR.start - at) % size
