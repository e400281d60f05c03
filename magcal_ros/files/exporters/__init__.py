"""A calibration in the words of other programs, one consumer a file.

An exporter is a function from a calibration to the text its consumer reads. What the consumer
cannot hold is said in a comment of that text; what would make its heading wrong is refused.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeAlias

from magcal_ros.files.exporters import (
    ardupilot,
    c_header,
    ctu_vras,
    fusioncore,
    imu_filter_madgwick,
    px4,
    vectornav,
)
from magcal_ros.files.exporters.common import NotExportable

Exporter: TypeAlias = Callable[..., str]
"""Takes the calibration, and those of `OF_LOGS` the magnetometer's frame as well."""

EXPORTERS: dict[str, Exporter] = {
    "ctu-vras": ctu_vras.export,
    "imu_filter_madgwick": imu_filter_madgwick.export,
    "fusioncore": fusioncore.export,
    "ardupilot": ardupilot.export,
    "px4": px4.export,
    "vectornav": vectornav.export,
    "c-header": c_header.export,
}
"""By the name that users give."""

OF_LOGS = {"ardupilot", "px4"}
"""Those of programs whose logs are read: a calibration from one knows which sensor it is of."""

NOTES = {"vectornav": vectornav.NOTES}
"""What a form without comments cannot say of itself, by the same names."""

__all__ = ["EXPORTERS", "NOTES", "OF_LOGS", "Exporter", "NotExportable"]
