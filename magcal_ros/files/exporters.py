"""A calibration in the formats of other programs, one function for each.

Each returns the text that its consumer reads. What the consumer cannot store is said in a comment;
what would make its heading wrong is refused. Those for autopilots are in `autopilots.py`.
"""

from __future__ import annotations

import functools
import math
import operator
from collections.abc import Callable

import numpy as np

from magcal_ros.core.calibration.calibration import Calibration
from magcal_ros.core.geometry.rotations import rotation_angle
from magcal_ros.files import autopilots
from magcal_ros.files.autopilots import NotExportable, ardupilot, px4


def ctu_vras(calibration: Calibration) -> str:
    """Return a parameter file for the compass stack of ctu-vras, for nodes of every name.

    `unbiased = M (mag - bias)`, tesla, M row by row
    (docs.ros.org/en/jazzy/p/magnetometer_pipeline). The documentation names the matrix
    `initial_scaling_matrix`; the node reads `initial_mag_scaling_matrix`. Both are written: a node
    ignores what it does not declare. magnetometer_bias_observer loads `magnetometer_bias_x/y/z`
    under `load_from_params`; it publishes them without a matrix, and a matrix that the receiver got
    as a parameter stays in force.
    """
    correction = calibration.correction
    matrix = f"[{autopilots.numbers(correction.matrix)}]"
    lines = ["/**:", "  ros__parameters:"]
    lines += [
        f"    {prefix}_{axis}: {autopilots.number(value, autopilots.OF_TESLA)}"
        for prefix in ("initial_mag_bias", "magnetometer_bias")
        for axis, value in zip("xyz", correction.hard_iron, strict=True)
    ]
    lines += [f"    initial_mag_scaling_matrix: {matrix}", f"    initial_scaling_matrix: {matrix}"]
    header = autopilots.commented(
        "#",
        autopilots.provenance(calibration),
        "unbiased = scaling_matrix * (mag - bias): tesla; the result is in the IMU's axes.",
    )
    return header + "\n".join(lines) + "\n"


def fusioncore(calibration: Calibration) -> str:
    """Return a parameter file for FusionCore; field_strength is the corrected field's.

    `corrected = soft_iron (mag - hard_iron)`, tesla, soft iron as a "3x3 scale+rotation matrix in
    row-major order" (docs/configuration.md of github.com/manankharwar/fusioncore).
    """
    correction, tesla = calibration.correction, autopilots.OF_TESLA
    header = autopilots.commented(
        "#",
        autopilots.provenance(calibration),
        "corrected = soft_iron * (mag - hard_iron): tesla, for the readings as the driver",
        "publishes them. soft_iron turns them into the IMU's axes: they must not be turned twice.",
    )
    return header + (
        "/**:\n"
        "  ros__parameters:\n"
        "    magnetometer.enabled: true\n"
        f"    magnetometer.hard_iron: [{autopilots.numbers(correction.hard_iron, tesla)}]\n"
        f"    magnetometer.soft_iron: [{autopilots.numbers(correction.matrix)}]\n"
        f"    magnetometer.field_strength: {autopilots.number(calibration.strength, tesla)}\n"
    )


UNCHANGED = 1e-9


def imu_filter_madgwick(calibration: Calibration) -> str:
    """Return a parameter file for imu_filter_madgwick, which knows the hard iron alone.

    `compensated = mag - mag_bias`, tesla (wiki.ros.org/imu_filter_madgwick).
    """
    comments = [autopilots.provenance(calibration), "compensated = mag - mag_bias, tesla."]
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
        lines.append(f"    mag_bias_{axis}: {autopilots.number(value, autopilots.OF_TESLA)}")
    return autopilots.commented("#", *comments) + "\n".join(lines) + "\n"


LARGEST_NUMBER = 1e3

VECTORNAV_NOTES = (
    "register 23 had to be the identity while the turn was made, and the field in the sensor's own "
    "axes: ROS drivers publish the compensated field, some in axes of their own"
)


def vectornav(calibration: Calibration) -> str:
    """Return the command that writes register 23, in one line; `$VNWNV` stores it for good.

    `X = C (M - B)`, C row by row, B in gauss, forward-right-down axes (VN-100 user manual UM001,
    6.2.1). The checksum is the exclusive or of the bytes between `$` and `*`. The serial line knows
    no comments: `VECTORNAV_NOTES` says what the command assumes. NotExportable if a number does not
    fit the fixed notation.
    """
    held = autopilots.in_forward_right_down(calibration.correction)
    twelve = np.concatenate([held.matrix.ravel(), autopilots.GAUSS * held.hard_iron])
    if np.abs(twelve).max() >= LARGEST_NUMBER:
        raise NotExportable(
            "The calibration has numbers that no VectorNav sensor could need. Check the field's "
            "unit (tesla) in the driver, and calibrate again."
        )
    body = "VNWRG,23," + ",".join(
        f"{round(value, autopilots.DECIMALS) + 0.0:.{autopilots.DECIMALS}f}" for value in twelve
    )
    return f"${body}*{checksum(body):02X}\n"


def checksum(body: str) -> int:
    """Return the exclusive or of a command's bytes, without `$` and `*`."""
    return functools.reduce(operator.xor, body.encode("ascii"), 0)


def c_header(calibration: Calibration) -> str:
    """Return a header with an include guard that any C or C++ compiler accepts."""
    correction = calibration.correction
    iron = autopilots.numbers(correction.hard_iron, autopilots.OF_TESLA)
    rows = ",\n".join(f"    {{{autopilots.numbers(row)}}}" for row in correction.matrix)
    return (
        f"/* {autopilots.provenance(calibration)}.\n"
        " * body = MAGCAL_MATRIX * (raw - MAGCAL_HARD_IRON): tesla, in the IMU's axes\n"
        " * (x forward, y left, z up). */\n"
        "#ifndef MAGCAL_CALIBRATION_H\n"
        "#define MAGCAL_CALIBRATION_H\n\n"
        f"static const double MAGCAL_HARD_IRON[3] = {{{iron}}};\n"
        f"static const double MAGCAL_MATRIX[3][3] = {{\n{rows}}};\n\n"
        "#endif\n"
    )


EXPORTERS: dict[str, Callable[..., str]] = {
    "ctu-vras": ctu_vras,
    "imu_filter_madgwick": imu_filter_madgwick,
    "fusioncore": fusioncore,
    "ardupilot": ardupilot,
    "px4": px4,
    "vectornav": vectornav,
    "c-header": c_header,
}
"""By the name that users give; each takes the calibration."""

OF_LOGS = {"ardupilot", "px4"}
"""Those that also take the magnetometer's frame, which names the sensor of a log."""

NOTES = {"vectornav": VECTORNAV_NOTES}
"""What a format without comments cannot say itself, by the same names."""
