"""From the messages of sensors and of travel to samples, several times faster than any library.

The types of these messages have never changed. So the layout in CDR (ROS 2) and in ROS 1's format
is fixed: a header with stamp and frame, followed by numbers.
"""

from __future__ import annotations

import math
from functools import lru_cache
from struct import Struct, error
from typing import Any, NamedTuple

from magcal_ros.core.earth_field.reference import Fix
from magcal_ros.core.geometry.vec3 import Triple
from magcal_ros.core.samples.streams import (
    FieldSample,
    HeadingSample,
    ImuSample,
    SpeedSample,
    VelocitySample,
)

IMU_TYPE, FIELD_TYPE = "sensor_msgs/msg/Imu", "sensor_msgs/msg/MagneticField"

ABSENT = -1.0
"""First element of a covariance whose measurement is absent (sensor_msgs/Imu)."""
NO_RATE: Triple = (math.nan, math.nan, math.nan)

RECEIVER_SPEED_SIGMA = 0.1
"""m/s per axis of a receiver's velocity; a TwistStamped carries no covariance."""

HEADING_SIGMA = math.radians(1.0)
"""Sigma of a heading whose orientation covariance is zero, which means unknown."""
NO_HEADING = math.radians(30.0)  # sigma from which a heading counts as unknown

LITTLE_ENDIAN_CDR = b"\x00\x01"
CDR_START = 4
"""Bytes before the message: in CDR the encapsulation, after which alignment starts; in ROS 1 the
sequence number."""
STAMP = Struct("<iI")
STAMP_PLACE = slice(CDR_START, CDR_START + STAMP.size)

# Orientation, rate and force, each with the first element of its covariance.
IMU_BODY = Struct("<5d64x4d64x4d64x")
# The orientation, with the first and the last element of its covariance.
HEADING = Struct("<5d56xd")
# The field and its covariance.
FIELD_BODY = Struct("<3d72s")
LENGTH = Struct("<I")
STATUS = Struct("<b")
PLACE = Struct("<3d")
VELOCITY = Struct("<2d")
# The two velocities, four other numbers, then the covariance: elements 1 (east) and 8 (north).
VELOCITY_COVARIANCE = Struct("<2d32xd48xd")
# An Odometry's pose with covariance, then the twist with the first element of its covariance.
ODOMETRY_BODY = Struct("<344x2d32xd")
# The current of a BatteryState of ROS 2, after voltage and temperature.
BATTERY = Struct("<8xf")


class ImuArrival(NamedTuple):
    """The parts of a sensor_msgs/Imu that are used."""

    frame: str
    sample: ImuSample | None  # None if the message has no acceleration
    stamp: bytes
    """Seconds and nanoseconds, little-endian, for the outputs that belong to this message."""


class FieldArrival(NamedTuple):
    """The parts of a sensor_msgs/MagneticField that are used."""

    frame: str
    sample: FieldSample
    stamp: bytes
    """Seconds and nanoseconds, little-endian, for the outputs that belong to this message."""
    covariance: bytes
    """Nine little-endian doubles, row-major, T²: hardly any reader needs its numbers."""


class Format:
    """Parser of messages in one format; it raises `struct.error` for any other layout.

    `head` is the layout of the stamp's seconds and nanoseconds and the frame's length. `widest` is
    the alignment of doubles, and `zero` the number of zero bytes that end a text.
    """

    def __init__(self, head: str, widest: int, zero: int) -> None:
        self._head, self._widest, self._zero = Struct(head).unpack_from, widest, zero
        self._frame_at = CDR_START + Struct(head).size

    def header(self, data: bytes, size: int = 8) -> tuple[float, bytes, int]:
        """Return stamp (s), frame, and the offset of the next number, which has `size` bytes."""
        sec, nanosec, length = self._head(data, CDR_START)
        end = self._frame_at + length
        if self._zero and (not length or data[end - 1 : end] != b"\0"):
            raise error("the frame does not end in a zero")
        frame = bytes(data[self._frame_at : end - self._zero])
        return sec + nanosec * 1e-9, frame, self._aligned(end, size)

    def _aligned(self, at: int, size: int) -> int:
        return at + (CDR_START - at) % min(size, self._widest)

    def imu(self, data: bytes) -> ImuArrival:
        """Read a sensor_msgs/Imu."""
        stamp, text, at = self.header(data)
        x, y, z, w, no_yaw, wx, wy, wz, no_rate, fx, fy, fz, no_force = IMU_BODY.unpack_from(
            data, at
        )
        frame, stamp_bytes = frame_of(text), data[STAMP_PLACE]
        if no_force == ABSENT:
            return ImuArrival(frame, None, stamp_bytes)
        rate = NO_RATE if no_rate == ABSENT else (wx, wy, wz)
        orientation = None if no_yaw == ABSENT else (x, y, z, w)
        sample = ImuSample(stamp, (fx, fy, fz), rate, orientation)
        return ImuArrival(frame, sample, stamp_bytes)

    def heading(self, data: bytes) -> HeadingSample | str:
        """Return the yaw of a sensor_msgs/Imu's orientation, or why it has none."""
        stamp, _, at = self.header(data)
        x, y, z, w, mark, variance = HEADING.unpack_from(data, at)
        if mark == ABSENT:
            return "its orientation is marked absent (covariance -1)"
        size = x * x + y * y + z * z + w * w
        if not abs(size - 1.0) < 0.02:
            return f"its orientation is not a unit quaternion (length {math.sqrt(abs(size)):.3g})"
        if not (math.isfinite(variance) and 0.0 <= variance < NO_HEADING**2):
            return "its orientation covariance says that the yaw is not known"
        yaw = math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
        return HeadingSample(stamp, yaw, math.sqrt(variance) if variance > 0.0 else HEADING_SIGMA)

    def field(self, data: bytes) -> FieldArrival:
        """Read a sensor_msgs/MagneticField."""
        stamp, text, at = self.header(data)
        x, y, z, covariance = FIELD_BODY.unpack_from(data, at)
        sample = FieldSample(stamp, (x, y, z))
        return FieldArrival(frame_of(text), sample, data[STAMP_PLACE], covariance)

    def fix(self, data: bytes) -> Fix:
        """Return the fix of a sensor_msgs/NavSatFix."""
        stamp, _, at = self.header(data, 1)
        (status,) = STATUS.unpack_from(data, at)
        service = self._aligned(at + 1, 2)
        latitude, longitude, altitude = PLACE.unpack_from(data, self._aligned(service + 2, 8))
        # STATUS_FIX of sensor_msgs/NavSatStatus is 0; STATUS_NO_FIX and STATUS_UNKNOWN are below.
        return Fix(status >= 0, latitude, longitude, altitude, stamp)

    def velocity(self, data: bytes) -> VelocitySample | str:
        """Return the velocity of a geometry_msgs/TwistStamped, or why it has none."""
        stamp, _, at = self.header(data)
        east, north = VELOCITY.unpack_from(data, at)
        return _velocity(stamp, east, north, RECEIVER_SPEED_SIGMA)

    def velocity_with_covariance(self, data: bytes) -> VelocitySample | str:
        """Return the velocity of a geometry_msgs/TwistWithCovarianceStamped, or why it has none."""
        stamp, _, at = self.header(data)
        east, north, of_east, of_north = VELOCITY_COVARIANCE.unpack_from(data, at)
        if of_east == ABSENT:
            return "its velocity is marked absent (covariance -1)"
        is_known = of_east > 0.0 and of_north > 0.0
        sigma = math.sqrt(0.5 * (of_east + of_north)) if is_known else RECEIVER_SPEED_SIGMA
        return _velocity(stamp, east, north, sigma)

    def speed(self, data: bytes) -> SpeedSample | str:
        """Return the signed speed of a nav_msgs/Odometry, or why it has none.

        By REP-105 and nav_msgs the twist is in `child_frame_id`, the vehicle's frame.
        """
        stamp, world, at = self.header(data, 4)
        (length,) = LENGTH.unpack_from(data, at)
        end = at + LENGTH.size + length
        child = data[at + LENGTH.size : end - self._zero]
        x, y, mark = ODOMETRY_BODY.unpack_from(data, self._aligned(end, 8))
        if child and child == world:
            return (
                f"its child_frame_id {frame_of(child)!r} is its frame_id, so that its twist is not "
                "a speed along the vehicle: give the vehicle's frame as child_frame_id"
            )
        if mark == ABSENT:
            return "its twist is marked absent (covariance -1)"
        if not math.isfinite(x + y):
            return "its twist is not finite"
        # The sideways component is included, because frames are slightly misaligned.
        return SpeedSample(stamp, math.copysign(math.hypot(x, y), x))

    def current(self, data: bytes) -> tuple[float, float]:
        """Return stamp (s) and current (A) of a sensor_msgs/BatteryState of ROS 2."""
        stamp, _, at = self.header(data, 4)
        return stamp, *BATTERY.unpack_from(data, at)


def _velocity(stamp: float, east: float, north: float, sigma: float) -> VelocitySample | str:
    if not math.isfinite(east + north + sigma):
        return "its velocity is not finite"
    return VelocitySample(stamp, east, north, sigma)


CDR = Format("<iII", 8, 1)
ROS1 = Format("<III", 1, 0)


def is_plain_cdr(data: bytes) -> bool:
    """Whether a ROS 2 message is little-endian CDR, as recorders on usual machines write it."""
    return data[:2] == LITTLE_ENDIAN_CDR


@lru_cache(maxsize=8)
def frame_of(text: bytes) -> str:
    """Return a frame as ROS reads it: up to the first zero, with invalid UTF-8 replaced."""
    return text.partition(b"\0")[0].decode("utf-8", "replace")


def seconds(stamp: Any) -> float:
    """Return a builtin_interfaces/Time in seconds."""
    return float(stamp.sec + stamp.nanosec * 1e-9)
