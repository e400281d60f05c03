"""Speeds and fixes straight from the bytes of their messages, plain CDR, as far as they are needed.

What is returned has the attributes of the message that `core.messages` reads.
"""

from __future__ import annotations

from struct import Struct
from types import SimpleNamespace

from magcal_ros.files.wire import CDR_START

HEADER = Struct("<iII")
"""Stamp and length of the frame, from where CDR counts its alignment."""

PLACE = Struct("<3d")
TWIST, NUMBER, COVARIANCE = Struct("<3d"), Struct("<d"), Struct("<36d")
POSE_SIZE = 8 * (7 + 36)
"""Bytes of an Odometry's pose with its covariance; of the twist the covariance follows six."""


def fix_from(data: bytes) -> SimpleNamespace:
    """Return what a sensor_msgs/NavSatFix says of its place.

    Raises
    ------
    struct.error
        Where the bytes are not laid out like that.
    """
    header, at = _header(data)
    status = int.from_bytes(data[at : at + 1], "little", signed=True)
    service = _aligned(at + 1, 2)
    latitude, longitude, altitude = PLACE.unpack_from(data, _aligned(service + 2, 8))
    return SimpleNamespace(
        header=header,
        status=SimpleNamespace(status=status),
        latitude=latitude,
        longitude=longitude,
        altitude=altitude,
    )


def twist_from(data: bytes, *, has_covariance: bool) -> SimpleNamespace:
    """Return the velocity of a TwistStamped, or of a TwistWithCovarianceStamped.

    Raises
    ------
    struct.error
        Where the bytes are not laid out like that.
    """
    header, at = _header(data)
    at = _aligned(at, 8)
    x, y, z = TWIST.unpack_from(data, at)
    twist = SimpleNamespace(linear=SimpleNamespace(x=x, y=y, z=z))
    if has_covariance:
        covariance = COVARIANCE.unpack_from(data, at + 6 * 8)
        twist = SimpleNamespace(covariance=covariance, twist=twist)
    return SimpleNamespace(header=header, twist=twist)


def odometry_from(data: bytes) -> SimpleNamespace:
    """Return the frames of a nav_msgs/Odometry, its speed, and the first of that one's covariance.

    Raises
    ------
    struct.error
        Where the bytes are not laid out like that.
    """
    header, at = _header(data)
    at = _aligned(at, 4)
    size = int.from_bytes(data[at : at + 4], "little")
    child = data[at + 4 : at + 4 + size - 1].decode("utf-8", "replace")
    at = _aligned(at + 4 + size, 8) + POSE_SIZE
    x, y, z = TWIST.unpack_from(data, at)
    (first,) = NUMBER.unpack_from(data, at + 6 * 8)
    return SimpleNamespace(
        header=header,
        child_frame_id=child,
        twist=SimpleNamespace(
            covariance=[first], twist=SimpleNamespace(linear=SimpleNamespace(x=x, y=y, z=z))
        ),
    )


def _header(data: bytes) -> tuple[SimpleNamespace, int]:
    """Return stamp and frame of a message, and the place after them."""
    sec, nanosec, length = HEADER.unpack_from(data, CDR_START)
    at = CDR_START + HEADER.size
    frame = data[at : at + length - 1].decode("utf-8", "replace")
    stamp = SimpleNamespace(sec=sec, nanosec=nanosec)
    return SimpleNamespace(stamp=stamp, frame_id=frame), at + length


def _aligned(at: int, size: int) -> int:
    """Return the next place at which CDR puts a number of so many bytes."""
    return at + (CDR_START - at) % size
