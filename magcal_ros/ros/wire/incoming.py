"""The numbers of the sensors' messages and of speeds, from serialized bytes."""

from __future__ import annotations

import math
import struct
from collections.abc import Callable
from contextlib import suppress
from functools import lru_cache
from typing import Any, NamedTuple, TypeVar

from builtin_interfaces.msg import Time
from geometry_msgs.msg import TwistStamped
from nav_msgs.msg import Odometry
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import Imu, MagneticField, NavSatFix

from magcal_ros.core.errors import MagcalError
from magcal_ros.core.messages import field_sample, fix_of, imu_sample, speed_of, velocity_of
from magcal_ros.core.samples.streams import FieldSample, ImuSample
from magcal_ros.files import wire
from magcal_ros.files.wire import fix_in, speed_in, stamp_in, velocity_in

T = TypeVar("T")

STAMP = struct.Struct("<iI")
_STAMP_PLACE = slice(wire.CDR_START, wire.CDR_START + STAMP.size)
_COVARIANCE = struct.Struct("<9d")
_parse_imu = wire.imu_parser(wire.CDR)
_parse_field = wire.field_parser(wire.CDR)
_frame_of = lru_cache(maxsize=8)(wire.frame_of)


class Unreadable(MagcalError):
    """Bytes that are no message of their topic's type."""


class ImuArrival(NamedTuple):
    """What the node takes from a sensor_msgs/Imu."""

    frame: str
    """The IMU's."""
    sample: ImuSample | None
    """Its numbers; None if it carries no acceleration."""
    stamp: bytes
    """Seconds and nanoseconds, little-endian, as every answer to this message carries them."""


class FieldArrival(NamedTuple):
    """What the node takes from a sensor_msgs/MagneticField."""

    frame: str
    """The magnetometer's."""
    sample: FieldSample
    """Its numbers."""
    stamp: bytes
    """Seconds and nanoseconds, little-endian, as every answer to this message carries them."""
    covariance: bytes
    """Nine little-endian doubles, row-major, T²."""


def read_imu(data: bytes) -> ImuArrival:
    """Return what a serialized sensor_msgs/Imu says.

    Raises
    ------
    Unreadable
        If it is none.
    """
    if wire.is_plain_cdr(data):
        try:
            frame, sample = _parse_imu(data)
        except struct.error:
            pass
        else:
            return ImuArrival(_frame_of(frame), sample, data[_STAMP_PLACE])
    message = by_rclpy(data, Imu)
    return ImuArrival(message.header.frame_id, imu_sample(message), _packed(message.header.stamp))


def read_field(data: bytes) -> FieldArrival:
    """Return what a serialized sensor_msgs/MagneticField says.

    Raises
    ------
    Unreadable
        If it is none.
    """
    if wire.is_plain_cdr(data):
        try:
            frame, sample, covariance = _parse_field(data)
        except struct.error:
            pass
        else:
            return FieldArrival(_frame_of(frame), sample, data[_STAMP_PLACE], covariance)
    message = by_rclpy(data, MagneticField)
    return FieldArrival(
        message.header.frame_id,
        field_sample(message),
        _packed(message.header.stamp),
        _COVARIANCE.pack(*message.magnetic_field_covariance),
    )


def _travel_reader(
    kind: type, from_bytes: Callable[[bytes], T], from_message: Callable[[Any], T]
) -> Callable[[bytes], T]:
    """Return what reads a message, and raises `Unreadable` if it is none."""

    def read(data: bytes) -> T:
        if wire.is_plain_cdr(data):
            try:
                return from_bytes(data)
            except struct.error:
                pass
        return from_message(by_rclpy(data, kind))

    return read


def read_stamp(data: bytes) -> float:
    """Return the stamp of a message with a header, seconds; NaN where a look does not tell it."""
    if wire.is_plain_cdr(data):
        with suppress(struct.error):
            return stamp_in(data)
    return math.nan


read_speed = _travel_reader(Odometry, speed_in, speed_of)
read_velocity = _travel_reader(TwistStamped, velocity_in, velocity_of)
read_fix = _travel_reader(NavSatFix, fix_in, fix_of)


def _packed(stamp: Time) -> bytes:
    return STAMP.pack(stamp.sec, stamp.nanosec)


def by_rclpy(data: bytes, kind: type) -> Any:
    """Return a message of any kind.

    Raises
    ------
    Unreadable
        If the bytes are none.
    """
    try:
        return deserialize_message(data, kind)
    except Exception as error:  # rclpy has several roots, and a message from outside no manners
        raise Unreadable(f"bytes that are no {kind.__name__}: {error}") from error
