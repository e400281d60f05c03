"""FusionCore: the full correction.

`corrected = soft_iron (mag - hard_iron)`, hard iron in tesla, soft iron as a "3x3 scale+rotation
matrix in row-major order" (parameters `magnetometer.hard_iron` and `magnetometer.soft_iron`,
docs/configuration.md of github.com/manankharwar/fusioncore).
"""

from __future__ import annotations

from magcal_ros.core.calibration.calibration import Calibration
from magcal_ros.files.exporters.common import (
    OF_TESLA,
    commented,
    number,
    numbers,
    provenance,
)


def export(calibration: Calibration) -> str:
    """Return a parameter file for `--params-file`.

    Parameters
    ----------
    calibration : Calibration
        What to export; nothing is lost.

    Returns
    -------
    str
        YAML for ROS 2. The field's strength is the one that the corrected field has.
    """
    correction = calibration.correction
    header = commented(
        "#",
        provenance(calibration),
        "corrected = soft_iron * (mag - hard_iron): tesla, for the readings as the driver",
        "publishes them. soft_iron turns them into the IMU's axes: they must not be turned twice.",
    )
    return header + (
        "/**:\n"
        "  ros__parameters:\n"
        "    magnetometer.enabled: true\n"
        f"    magnetometer.hard_iron: [{numbers(correction.hard_iron, OF_TESLA)}]\n"
        f"    magnetometer.soft_iron: [{numbers(correction.matrix)}]\n"
        f"    magnetometer.field_strength: {number(calibration.strength, OF_TESLA)}\n"
    )
