"""A calibration in the formats of other programs, one function each.

An exporter is a function from a calibration to the text its consumer reads. What the consumer
cannot hold is said in a comment of that text; what would make its heading wrong is refused.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeAlias

from magcal_ros.files.exporters import autopilots, ros_nodes
from magcal_ros.files.exporters.autopilots import NotExportable

Exporter: TypeAlias = Callable[..., str]
"""Takes the calibration, and those of `OF_LOGS` the magnetometer's frame as well."""

EXPORTERS: dict[str, Exporter] = {
    "ctu-vras": ros_nodes.ctu_vras,
    "imu_filter_madgwick": ros_nodes.imu_filter_madgwick,
    "fusioncore": ros_nodes.fusioncore,
    "ardupilot": autopilots.ardupilot,
    "px4": autopilots.px4,
    "vectornav": ros_nodes.vectornav,
    "c-header": ros_nodes.c_header,
}
"""By the name that users give."""

OF_LOGS = {"ardupilot", "px4"}
"""Those of programs whose logs are read: a calibration from one knows which sensor it is of."""

NOTES = {"vectornav": ros_nodes.VECTORNAV_NOTES}
"""What a form without comments cannot say of itself, by the same names."""

__all__ = ["EXPORTERS", "NOTES", "OF_LOGS", "Exporter", "NotExportable"]
