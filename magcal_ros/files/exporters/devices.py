"""Calibrations for a sensor that corrects itself, and for firmware.

VectorNav: register 23, magnetometer compensation.

`X = C (M - B)`, C row by row, B in gauss (VN-100 user manual UM001, 6.2.1). The sensor's axes are
forward-right-down. The checksum is the exclusive or of the bytes between `$` and `*`. The command
rests on uncompensated readings: the ROS drivers publish the compensated field, some in axes of
their own, so register 23 has to be the identity while the turn is made.

The twelve numbers as a C header, for firmware of one's own.

`body = MAGCAL_MATRIX (raw - MAGCAL_HARD_IRON)`, tesla, forward-left-up.
"""

from __future__ import annotations

import functools
import operator

import numpy as np

from magcal_ros.core.calibration.calibration import Calibration
from magcal_ros.files.exporters.common import (
    DECIMALS,
    GAUSS,
    OF_TESLA,
    NotExportable,
    in_forward_right_down,
    numbers,
    provenance,
)

LARGEST_NUMBER = 1e3

VECTORNAV_NOTES = (
    "register 23 had to be the identity while the turn was made, and the field in the sensor's own "
    "axes: ROS drivers publish the compensated field, some in axes of their own"
)


def vectornav(calibration: Calibration) -> str:
    """Return the command that writes register 23.

    Parameters
    ----------
    calibration : Calibration
        What to export; made from fields in forward-left-up axes.

    Returns
    -------
    str
        One line; `$VNWNV` stores it for good. The serial line knows no comments;
        `VECTORNAV_NOTES` says what the command assumes.

    Raises
    ------
    NotExportable
        If a number does not fit the command's fixed notation.
    """
    held = in_forward_right_down(calibration.correction)
    twelve = np.concatenate([held.matrix.ravel(), GAUSS * held.hard_iron])
    if np.abs(twelve).max() >= LARGEST_NUMBER:
        raise NotExportable(
            "The calibration has numbers that no VectorNav sensor could need. Check the field's "
            "unit (tesla) in the driver, and calibrate again."
        )
    body = "VNWRG,23," + ",".join(
        f"{round(value, DECIMALS) + 0.0:.{DECIMALS}f}" for value in twelve
    )
    return f"${body}*{checksum(body):02X}\n"


def checksum(body: str) -> int:
    """Return the exclusive or of a command's bytes, without `$` and `*`."""
    return functools.reduce(operator.xor, body.encode("ascii"), 0)


def c_header(calibration: Calibration) -> str:
    """Return a header that any C or C++ compiler takes.

    Returns
    -------
    str
        With an include guard.
    """
    correction = calibration.correction
    iron = numbers(correction.hard_iron, OF_TESLA)
    rows = ",\n".join(f"    {{{numbers(row)}}}" for row in correction.matrix)
    return (
        f"/* {provenance(calibration)}.\n"
        " * body = MAGCAL_MATRIX * (raw - MAGCAL_HARD_IRON): tesla, in the IMU's axes\n"
        " * (x forward, y left, z up). */\n"
        "#ifndef MAGCAL_CALIBRATION_H\n"
        "#define MAGCAL_CALIBRATION_H\n\n"
        f"static const double MAGCAL_HARD_IRON[3] = {{{iron}}};\n"
        f"static const double MAGCAL_MATRIX[3][3] = {{\n{rows}}};\n\n"
        "#endif\n"
    )
