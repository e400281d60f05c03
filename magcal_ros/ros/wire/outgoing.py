"""The node's messages as templates: serialized once by rclpy, and filled where the numbers lie."""

from __future__ import annotations

from collections.abc import Mapping
from struct import Struct
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus, KeyValue
from rclpy.serialization import serialize_message
from sensor_msgs.msg import Imu, MagneticField
from std_msgs.msg import Float64

from magcal_ros.core.calibration.correction import Correction
from magcal_ros.core.geometry.attitude import true_yaw
from magcal_ros.core.geometry.vec3 import Triple
from magcal_ros.core.heading.compass import Heading
from magcal_ros.core.knowledge import ReferenceField
from magcal_ros.core.messages import ABSENT
from magcal_ros.files.wire import CDR_START, is_plain_cdr
from magcal_ros.ros.wire.incoming import STAMP

DOUBLE = 8
_STAMP_END = CDR_START + STAMP.size
_FRAME_PLACE = _STAMP_END + 4
"""After the stamp comes the frame's length in four bytes."""

Nine = tuple[float, ...]
"""A 3 x 3 matrix, row-major."""


class Template:
    """A message with header, and doubles that begin right after it."""

    def __init__(self, message: Any, doubles: int) -> None:
        self._message = message
        self._body = Struct(f"<{doubles}d")
        self._frame: str | None = None
        self._data: bytearray | None = None
        self._place = 0

    def _filled(self, stamp: bytes, frame: str, numbers: tuple[float, ...]) -> bytes | None:
        """Return the message as bytes; None where rclpy lays it out in another way."""
        if frame != self._frame:
            self._lay_out(frame)
        if self._data is None:
            return None
        self._data[CDR_START:_STAMP_END] = stamp
        self._body.pack_into(self._data, self._place, *numbers)
        return bytes(self._data)

    def _addressed(self, stamp: bytes) -> Any:
        """Return the message itself, its stamp filled in."""
        header = self._message.header
        header.stamp.sec, header.stamp.nanosec = STAMP.unpack(stamp)
        return self._message

    def _lay_out(self, frame: str) -> None:
        self._frame = self._message.header.frame_id = frame
        data = serialize_message(self._message)
        end = _FRAME_PLACE + len(frame.encode()) + 1
        self._place = end + (CDR_START - end) % DOUBLE
        fits = is_plain_cdr(data) and len(data) >= self._place + self._body.size
        self._data = bytearray(data) if fits else None


class FieldTemplate(Template):
    """A sensor_msgs/MagneticField."""

    def __init__(self) -> None:
        super().__init__(MagneticField(), 3 + 9)

    def fill(self, stamp: bytes, frame: str, field: Triple, covariance: Nine) -> Any:
        """Return what to publish for a field (tesla) and its covariance (T²)."""
        data = self._filled(stamp, frame, field + covariance)
        if data is not None:
            return data
        message = self._addressed(stamp)
        vector = message.magnetic_field
        vector.x, vector.y, vector.z = field
        message.magnetic_field_covariance = covariance
        return message


class AttitudeTemplate(Template):
    """A sensor_msgs/Imu with an orientation; rates and accelerations are marked absent."""

    def __init__(self) -> None:
        message = Imu()
        message.angular_velocity_covariance[0] = ABSENT
        message.linear_acceleration_covariance[0] = ABSENT
        super().__init__(message, 4 + 9)

    def fill(
        self,
        stamp: bytes,
        frame: str,
        heading: Heading,
        declination: float = 0.0,
        declination_sigma: float = 0.0,
    ) -> Any:
        """Return what to publish for a heading; without a declination (rad) to magnetic north."""
        quaternion = heading.quaternion(declination)
        covariance = heading.covariance(declination_sigma**2)
        data = self._filled(stamp, frame, quaternion + covariance)
        if data is not None:
            return data
        message = self._addressed(stamp)
        q = message.orientation
        q.x, q.y, q.z, q.w = quaternion
        message.orientation_covariance = covariance
        return message


class NumberTemplate:
    """A std_msgs/Float64."""

    def __init__(self) -> None:
        self._message = Float64()
        data = serialize_message(self._message)
        fits = is_plain_cdr(data) and len(data) == CDR_START + DOUBLE
        self._encapsulation = data[:CDR_START] if fits else None
        self._pack = Struct("<d").pack

    def fill(self, value: float) -> Any:
        """Return what to publish for a number."""
        if self._encapsulation is not None:
            return self._encapsulation + self._pack(value)
        self._message.data = value
        return self._message


def bias_message(correction: Correction, frame: str) -> MagneticField:
    """Return the correction as ctu-vras tools take it: h as the field, A as the covariance."""
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
    message.header.stamp.sec, message.header.stamp.nanosec = STAMP.unpack(stamp)
    message.unit, message.orientation = kind.UNIT_RAD, kind.ORIENTATION_ENU
    message.reference = kind.REFERENCE_MAGNETIC
    message.azimuth, message.variance = heading.yaw, heading.yaw_variance
    if reference is not None:
        message.reference = kind.REFERENCE_GEOGRAPHIC
        message.azimuth = true_yaw(heading.yaw, reference.declination or 0.0)
        message.variance += reference.declination_sigma**2
    return message


def diagnostic(
    name: str,
    part: str,
    message: str,
    values: Mapping[str, str] | None = None,
    level: bytes = DiagnosticStatus.OK,
) -> DiagnosticStatus:
    """Return the diagnostic of a part of the node."""
    pairs = [KeyValue(key=key, value=value) for key, value in (values or {}).items()]
    return DiagnosticStatus(name=f"{name}: {part}", level=level, message=message, values=pairs)
