"""Numbers and words to messages: those that are not made anew for each field message."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus, KeyValue
from sensor_msgs.msg import MagneticField

from magcal_ros.core.calibration.correction import Correction
from magcal_ros.core.geometry.attitude import true_yaw
from magcal_ros.core.heading.compass import Heading
from magcal_ros.core.knowledge import ReferenceField
from magcal_ros.ros.wire.incoming import STAMP


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
    """Return a heading as a compass_interfaces/msg/Azimuth: ENU, radians.

    Parameters
    ----------
    kind : type
        The message, which most robots do not have installed.
    stamp : bytes
        As the field's message has it.
    frame : str
    heading : Heading
    reference : ReferenceField, optional
        With a declination, for true north; without, the azimuth is magnetic.
    """
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


def diagnostic(name: str, part: str) -> DiagnosticStatus:
    """Return an empty diagnostic of a part of the node."""
    return DiagnosticStatus(name=f"{name}: {part}", level=DiagnosticStatus.OK)


def key_values(values: Mapping[str, str]) -> list[KeyValue]:
    """Return a diagnostic's values."""
    return [KeyValue(key=key, value=value) for key, value in values.items()]
