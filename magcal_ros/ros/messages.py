"""Numbers and words to messages: those that are not made anew for each field message."""

from __future__ import annotations

from collections.abc import Mapping

from diagnostic_msgs.msg import DiagnosticStatus, KeyValue
from sensor_msgs.msg import MagneticField

from magcal_ros.core.calibration.correction import Correction


def bias_message(correction: Correction, frame: str) -> MagneticField:
    """Return the correction as ctu-vras tools take it: h as the field, A as the covariance."""
    message = MagneticField()
    message.header.frame_id = frame
    message.magnetic_field.x, message.magnetic_field.y, message.magnetic_field.z = (
        float(value) for value in correction.hard_iron
    )
    message.magnetic_field_covariance = correction.matrix.ravel().copy()
    return message


def diagnostic(name: str, part: str) -> DiagnosticStatus:
    """Return an empty diagnostic of a part of the node."""
    return DiagnosticStatus(name=f"{name}: {part}", level=DiagnosticStatus.OK)


def key_values(values: Mapping[str, str]) -> list[KeyValue]:
    """Return a diagnostic's values."""
    return [KeyValue(key=key, value=value) for key, value in values.items()]
