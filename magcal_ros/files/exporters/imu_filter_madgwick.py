"""imu_filter_madgwick: the hard iron alone.

`compensated = mag - mag_bias`, in the message's unit, tesla (parameters `mag_bias_x/y/z`,
wiki.ros.org/imu_filter_madgwick: "Magnetometer bias (hard iron compensation)").
"""

from __future__ import annotations

import math

import numpy as np

from magcal_ros.core.calibration.calibration import Calibration
from magcal_ros.core.geometry.rotations import rotation_angle
from magcal_ros.files.exporters.common import OF_TESLA, commented, number, provenance

UNCHANGED = 1e-9


def export(calibration: Calibration) -> str:
    """Return a parameter file for `--params-file`.

    Parameters
    ----------
    calibration : Calibration
        What to export; its matrix is lost, and the text says how much that is.

    Returns
    -------
    str
        YAML for ROS 2.
    """
    comments = [provenance(calibration), "compensated = mag - mag_bias, tesla."]
    matrix = calibration.correction.matrix
    if np.abs(matrix - np.eye(3)).max() > UNCHANGED:
        left, sizes, right = np.linalg.svd(matrix)
        angle = math.degrees(rotation_angle(left @ right))
        comments += [
            f"LOST: installation of {angle:.2f} degrees and soft iron with gains from "
            f"{sizes.min():.4f} to {sizes.max():.4f}; this filter knows the hard iron only.",
            "To lose nothing, let it subscribe to imu/mag_unbiased of the calibrator, with zeros "
            "here.",
        ]
    lines = ["/**:", "  ros__parameters:"]
    for axis, value in zip("xyz", calibration.correction.hard_iron, strict=True):
        lines.append(f"    mag_bias_{axis}: {number(value, OF_TESLA)}")
    return commented("#", *comments) + "\n".join(lines) + "\n"
