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
    sec, nanosec, length = HEADER.unpack_from(data, CDR_START)
    end = CDR_START + HEADER.size + length
    status = int.from_bytes(data[end : end + 1], "little", signed=True)
    # The service after the status is aligned to two bytes, the doubles after it to eight.
    after = end + 1 + (CDR_START - end - 1) % 2 + 2
    latitude, longitude, altitude = PLACE.unpack_from(data, after + (CDR_START - after) % 8)
    return SimpleNamespace(
        header=SimpleNamespace(stamp=SimpleNamespace(sec=sec, nanosec=nanosec)),
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
    sec, nanosec, length = HEADER.unpack_from(data, CDR_START)
    at = CDR_START + HEADER.size + length
    at += (CDR_START - at) % 8
    x, y, z = TWIST.unpack_from(data, at)
    twist = SimpleNamespace(linear=SimpleNamespace(x=x, y=y, z=z))
    if has_covariance:
        covariance = COVARIANCE.unpack_from(data, at + 6 * 8)
        twist = SimpleNamespace(covariance=covariance, twist=twist)
    return SimpleNamespace(
        header=SimpleNamespace(stamp=SimpleNamespace(sec=sec, nanosec=nanosec)), twist=twist
    )


def odometry_from(data: bytes) -> SimpleNamespace:
    """Return the frames of a nav_msgs/Odometry, its speed, and the first of that one's covariance.

    Raises
    ------
    struct.error
        Where the bytes are not laid out like that.
    """
    sec, nanosec, length = HEADER.unpack_from(data, CDR_START)
    at = CDR_START + HEADER.size
    frame = data[at : at + length - 1].decode("utf-8", "replace")
    at += length
    # Lengths are aligned to four bytes, numbers to eight.
    at += (CDR_START - at) % 4
    size = int.from_bytes(data[at : at + 4], "little")
    child = data[at + 4 : at + 4 + size - 1].decode("utf-8", "replace")
    at += 4 + size
    at += (CDR_START - at) % 8 + POSE_SIZE
    x, y, z = TWIST.unpack_from(data, at)
    (first,) = NUMBER.unpack_from(data, at + 6 * 8)
    return SimpleNamespace(
        header=SimpleNamespace(stamp=SimpleNamespace(sec=sec, nanosec=nanosec), frame_id=frame),
        child_frame_id=child,
        twist=SimpleNamespace(
            covariance=[first], twist=SimpleNamespace(linear=SimpleNamespace(x=x, y=y, z=z))
        ),
    )
