"""PX4: offsets that are subtracted, and a symmetric matrix.

`corrected = R S (mag - OFF)` with S = [[XSCALE, XODIAG, YODIAG], [XODIAG, YSCALE, ZODIAG],
[YODIAG, ZODIAG, ZSCALE]], gauss, in the sensor's own forward-right-down axes; R is CAL_MAG0_ROT,
one of a few right-angled rotations, and is left alone (parameter reference, CAL_MAG0_XOFF in
gauss, CAL_MAG0_XSCALE, CAL_MAG0_XODIAG). Scales must lie between 0.1 and 3.
"""

from __future__ import annotations

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

SMALLEST_SCALE, LARGEST_SCALE = 0.1, 3.0


def export(calibration: Calibration) -> str:
    """Return commands for the PX4 console.

    Parameters
    ----------
    calibration : Calibration
        What to export; made from fields in the vehicle's forward-left-up axes.

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
    scales = np.diag(held.matrix)
    if scales.min() < SMALLEST_SCALE or scales.max() > LARGEST_SCALE:
        raise NotExportable(
            f"PX4 takes scales from {SMALLEST_SCALE} to {LARGEST_SCALE} only, and this calibration "
            f"has {scales.min():.3g} to {scales.max():.3g}. Check the field's unit (tesla) in the "
            "driver, and calibrate again."
        )
    header = commented(
        "#",
        provenance(calibration),
        "corrected = CAL_MAG0_ROT * S * (mag - OFF), gauss, forward-right-down; for the first",
        "magnetometer and CAL_MAG0_ROT = 0 or -1.",
        "RESTS ON CAL_MAG0_ID being the device that was calibrated: PX4 finds a sensor's numbers",
        "by it (param show CAL_MAG*_ID); where another slot has it, put that number for the 0.",
        *held.comments,
    )
    values = {f"CAL_MAG0_{axis}OFF": GAUSS * held.hard_iron[k] for k, axis in enumerate("XYZ")}
    values |= {f"CAL_MAG0_{axis}SCALE": scales[k] for k, axis in enumerate("XYZ")}
    values |= {
        "CAL_MAG0_XODIAG": held.matrix[0, 1],
        "CAL_MAG0_YODIAG": held.matrix[0, 2],
        "CAL_MAG0_ZODIAG": held.matrix[1, 2],
    }
    return header + "".join(f"param set {name} {number(value)}\n" for name, value in values.items())
