"""PX4: offsets that are subtracted, and a symmetric matrix.

`corrected = R S (mag - OFF)` with S = [[XSCALE, XODIAG, YODIAG], [XODIAG, YSCALE, ZODIAG],
[YODIAG, ZODIAG, ZSCALE]], gauss, in the sensor's own forward-right-down axes; R is CAL_MAG0_ROT,
one of a few rotations, and is left alone (parameter reference, CAL_MAG0_XOFF in
gauss, CAL_MAG0_XSCALE, CAL_MAG0_XODIAG). Scales must lie between 0.1 and 3.
"""

from __future__ import annotations

import re

import numpy as np

from magcal_ros.core.calibration.calibration import Calibration
from magcal_ros.files.exporters.common import (
    GAUSS,
    NotExportable,
    commented,
    number,
    provenance,
    without_rotation,
)
from magcal_ros.files.logs.px4 import rotation_of

FRAME = "px4_mag{slot}_rot{rotation}"
"""What a calibration from a log of PX4 remembers: CAL_MAGn and its ROT."""

SMALLEST_SCALE, LARGEST_SCALE = 0.1, 3.0


def export(calibration: Calibration, frame: str = "") -> str:
    """Return commands for the PX4 console.

    Parameters
    ----------
    calibration : Calibration
        What to export; made from fields in the vehicle's forward-left-up axes.
    frame : str
        Of the magnetometer: from a log it says which slot this is, and how it is turned.

    Returns
    -------
    str
        `param set NAME value` lines.

    Raises
    ------
    NotExportable
        If the calibration turns the field by more than 5°, or scales it beyond PX4's range.
    """
    held = without_rotation(calibration.correction, "PX4")
    of_log = re.fullmatch(FRAME.format(slot=r"(\d)", rotation=r"(\d+)"), frame)
    slot, rotation = (int(number) for number in of_log.groups()) if of_log else (0, 0)
    turn = rotation_of(rotation)  # the parameters are in the sensor's own axes
    matrix, offset = turn.T @ held.matrix @ turn, turn.T @ held.hard_iron
    scales = np.diag(matrix)
    if scales.min() < SMALLEST_SCALE or scales.max() > LARGEST_SCALE:
        raise NotExportable(
            f"PX4 takes scales from {SMALLEST_SCALE} to {LARGEST_SCALE} only, and this calibration "
            f"has {scales.min():.3g} to {scales.max():.3g}. Check the field's unit (tesla) in the "
            "driver, and calibrate again."
        )
    origin = (
        f"From a log, whose own calibration was taken off: CAL_MAG{slot}, CAL_MAG{slot}_ROT "
        f"{rotation}.",
    )
    driver = (
        "For the first magnetometer and CAL_MAG0_ROT = 0 or -1.",
        "RESTS ON CAL_MAG0_ID being the device that was calibrated: PX4 finds a sensor's numbers",
        "by it (param show CAL_MAG*_ID); where another slot has it, put that number for the 0.",
    )
    header = commented(
        "#",
        provenance(calibration),
        "corrected = ROT * S * (mag - OFF), gauss, forward-right-down.",
        *(origin if of_log else driver),
        *held.comments,
    )
    name = f"CAL_MAG{slot}"
    values = {f"{name}_{axis}OFF": GAUSS * offset[k] for k, axis in enumerate("XYZ")}
    values |= {f"{name}_{axis}SCALE": scales[k] for k, axis in enumerate("XYZ")}
    values |= {
        f"{name}_XODIAG": matrix[0, 1],
        f"{name}_YODIAG": matrix[0, 2],
        f"{name}_ZODIAG": matrix[1, 2],
    }
    return header + "".join(f"param set {name} {number(value)}\n" for name, value in values.items())
