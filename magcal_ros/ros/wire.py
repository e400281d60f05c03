"""Reading and writing of the node's messages as serialized bytes.

The conversion of messages to Python objects and back by rclpy takes more time than all computation
on them. The numbers in the node's few messages have fixed offsets, so they are read and written in
the bytes. For output, rclpy serializes a template once, which is then filled. Messages with another
layout are converted by rclpy.
"""

from __future__ import annotations

import contextlib
import importlib
import math
import struct
from collections.abc import Callable, Collection, Mapping
from struct import Struct
from typing import Any, TypeVar, cast

from diagnostic_msgs.msg import DiagnosticStatus, KeyValue
from geometry_msgs.msg import TwistStamped
from nav_msgs.msg import Odometry
from rclpy.node import Node
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import Imu, MagneticField, NavSatFix

from magcal_ros.core.calibration.correction import Correction
from magcal_ros.core.errors import MagcalError
from magcal_ros.core.geometry.attitude import true_yaw
from magcal_ros.core.heading.compass import Heading
from magcal_ros.core.knowledge import ReferenceField
from magcal_ros.files.disk import printable
from magcal_ros.files.wire import ABSENT, CDR, CDR_START, STAMP, STAMP_PLACE, is_plain_cdr

T = TypeVar("T")


class Unreadable(MagcalError):
    """Bytes that are not a message of the topic's type."""


def _reader(kind: type, parse: Callable[[bytes], T]) -> Callable[[bytes], T]:
    """Return a function that reads serialized messages, and raises `Unreadable` for other bytes."""

    def read(data: bytes) -> T:
        if is_plain_cdr(data):
            try:
                return parse(data)
            except struct.error:
                pass
        try:
            return parse(serialize_message(by_rclpy(data, kind)))
        except struct.error as error:
            raise Unreadable(f"a {kind.__name__} with an unknown layout") from error

    return read


read_imu = _reader(Imu, CDR.imu)
read_field = _reader(MagneticField, CDR.field)
read_heading = _reader(Imu, CDR.heading)
read_speed = _reader(Odometry, CDR.speed)
read_velocity = _reader(TwistStamped, CDR.velocity)
read_fix = _reader(NavSatFix, CDR.fix)


def read_stamp(data: bytes) -> float:
    """Return the stamp of a message with a header, seconds; NaN for another layout."""
    with contextlib.suppress(struct.error):
        if is_plain_cdr(data):
            return CDR.header(data)[0]
    return math.nan


def by_rclpy(data: bytes, kind: type) -> Any:
    """Return the message in serialized bytes; raises Unreadable if there is none."""
    try:
        return deserialize_message(data, kind)
    # rclpy has several base classes of errors, and the bytes may be anything.
    except Exception as error:
        raise Unreadable(f"the bytes are not a {kind.__name__}: {error}") from error


def optional_type(package: str, name: str) -> Any:
    """Return a message type; None if its package is not installed."""
    try:
        return getattr(importlib.import_module(f"{package}.msg"), name)
    except ImportError:
        return None


def published_instead(kind: str, published: Collection[str]) -> str:
    """Return the message types on a topic in words if `kind` is not among them, else nothing."""
    if not published or kind in published:
        return ""
    others = " and ".join(sorted(map(printable, set(published))))
    return f"{others} is published there, not {kind}"


def unreadable_topics(node: Node, handled: Collection[str]) -> list[str]:
    """Return in words the topics of which nothing arrives because all messages have another type.

    The topics that are `handled` elsewhere are left out.
    """
    found = []
    for each in node.subscriptions:
        topic, kind = each.topic_name, cast("type", each.msg_type)
        if topic in handled:
            continue
        published = [info.topic_type for info in node.get_publishers_info_by_topic(topic)]
        package = kind.__module__.partition(".")[0]
        words = published_instead(f"{package}/msg/{kind.__name__}", published)
        if words:
            found.append(
                f"nothing can arrive on {topic}: {words}; remap it to a topic of this type"
            )
    return found


DOUBLE = 8
_FRAME_PLACE = STAMP_PLACE.stop + 4
"""Offset of the frame, after the stamp and four bytes with the frame's length."""


class MessageTemplate:
    """A message that is filled repeatedly: a header, a vector and a covariance (3, 3).

    If rclpy uses another layout, the numbers are set in the message object.
    """

    def __init__(self, message: Any, vector: str, axes: str) -> None:
        self._message, self._vector, self._axes = message, vector, axes
        self._body = Struct(f"<{len(axes) + 9}d")
        self._frame: str | None = None
        self._data: bytearray | None = None
        self._place = 0

    def fill(self, stamp: bytes, frame: str, numbers: tuple[float, ...]) -> Any:
        """Return the message to publish, as bytes or as an object."""
        if frame != self._frame:
            self._lay_out(frame)
        if self._data is None:
            _set_stamp(self._message, stamp)
            for axis, number in zip(self._axes, numbers, strict=False):
                setattr(getattr(self._message, self._vector), axis, number)
            covariance = numbers[len(self._axes) :]
            setattr(self._message, f"{self._vector}_covariance", covariance)
            return self._message
        self._data[STAMP_PLACE] = stamp
        self._body.pack_into(self._data, self._place, *numbers)
        return bytes(self._data)

    def _lay_out(self, frame: str) -> None:
        self._frame = self._message.header.frame_id = frame
        data = serialize_message(self._message)
        end = _FRAME_PLACE + len(frame.encode()) + 1
        self._place = end + (CDR_START - end) % DOUBLE
        fits = is_plain_cdr(data) and len(data) >= self._place + self._body.size
        self._data = bytearray(data) if fits else None


def field_template() -> MessageTemplate:
    """Return a sensor_msgs/MagneticField to fill: tesla, and the covariance in T²."""
    return MessageTemplate(MagneticField(), "magnetic_field", "xyz")


def attitude_template() -> MessageTemplate:
    """Return a sensor_msgs/Imu to fill: quaternion and covariance; all else is marked absent."""
    message = Imu()
    message.angular_velocity_covariance[0] = ABSENT
    message.linear_acceleration_covariance[0] = ABSENT
    return MessageTemplate(message, "orientation", "xyzw")


def _set_stamp(message: Any, stamp: bytes) -> None:
    time = message.header.stamp
    time.sec, time.nanosec = STAMP.unpack(stamp)


def bias_message(correction: Correction, frame: str) -> MagneticField:
    """Return the correction in the form of ctu-vras tools: h as the field, A as the covariance."""
    message = MagneticField()
    message.header.frame_id = frame
    message.magnetic_field.x, message.magnetic_field.y, message.magnetic_field.z = (
        float(value) for value in correction.hard_iron
    )
    message.magnetic_field_covariance = correction.matrix.ravel().copy()
    return message


def azimuth_message(
    kind: Any, stamp: bytes, frame: str, heading: Heading, reference: ReferenceField | None = None
) -> Any:
    """Return a heading as a compass_interfaces/msg/Azimuth: ENU, radians."""
    message = kind()
    message.header.frame_id = frame
    _set_stamp(message, stamp)
    message.unit, message.orientation = kind.UNIT_RAD, kind.ORIENTATION_ENU
    message.reference = kind.REFERENCE_MAGNETIC
    message.azimuth, message.variance = heading.yaw, heading.yaw_variance
    if reference is not None:
        message.reference = kind.REFERENCE_GEOGRAPHIC
        message.azimuth = true_yaw(heading.yaw, reference.declination or 0.0)
        message.variance += reference.declination_sigma**2
    return message


def yaw_values(heading: Heading | None) -> dict[str, str]:
    """Return the values of a heading for diagnostics; empty without a heading."""
    if heading is None:
        return {}
    sigma = math.degrees(math.sqrt(heading.yaw_variance))
    yaw = f"{math.degrees(heading.yaw):.1f}° (ENU, magnetic)"
    return {"yaw": yaw, "yaw sigma": f"{sigma:.2f}°"}


def diagnostic(
    part: str,
    message: str,
    values: Mapping[str, str] | None = None,
    level: bytes = DiagnosticStatus.OK,
) -> DiagnosticStatus:
    """Return the diagnostic of a part of the node."""
    pairs = [KeyValue(key=key, value=value) for key, value in (values or {}).items()]
    return DiagnosticStatus(name=part, level=level, message=message, values=pairs)
