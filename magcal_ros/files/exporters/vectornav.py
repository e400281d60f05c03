"""VectorNav: register 23, magnetometer compensation.

`X = C (M - B)`, C row by row, B in gauss (VN-100 user manual UM001, 6.2.1). The sensor's axes are
forward-right-down. The checksum is the exclusive or of the bytes between `$` and `*`. The command
rests on uncompensated readings: the ROS drivers publish the compensated field, some in axes of
their own, so register 23 has to be the identity while the turn is made.
"""

from __future__ import annotations

import functools
import operator

import numpy as np

from magcal_ros.core.calibration.calibration import Calibration
from magcal_ros.files.exporters.common import (
    DECIMALS,
    GAUSS,
    NotExportable,
    in_forward_right_down,
)

LARGEST_NUMBER = 1e3

NOTES = (
    "register 23 had to be the identity while the turn was made, and the field in the sensor's own "
    "axes: ROS drivers publish the compensated field, some in axes of their own"
)


def export(calibration: Calibration) -> str:
    """Return the command that writes register 23.

    Parameters
    ----------
    calibration : Calibration
        What to export; made from fields in forward-left-up axes.

    Returns
    -------
    str
        One line; `$VNWNV` stores it for good. The serial line knows no comments: `NOTES` says
        beside it what it rests on.

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
