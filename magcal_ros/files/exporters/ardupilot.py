"""ArduPilot: offsets that are added, and a symmetric matrix.

`corrected = D (mag + OFS)` with D = [[DIA_X, ODI_X, ODI_Y], [ODI_X, DIA_Y, ODI_Z],
[ODI_Y, ODI_Z, DIA_Z]], milligauss, forward-right-down body axes after COMPASS_ORIENT. The full
parameter list says of COMPASS_OFS_X "Offset to be added to the compass x-axis values": the sign is
the opposite of the hard iron's. COMPASS_SCALE multiplies besides and must be 1 for these numbers.
"""

from __future__ import annotations

import re

from magcal_ros.core.calibration.calibration import Calibration
from magcal_ros.files.exporters.common import (
    MILLIGAUSS,
    commented,
    number,
    provenance,
    without_rotation,
)

FRAME = "ardupilot_compass"
"""What a calibration from a log of ArduPilot remembers, with the number of the parameters."""


def export(calibration: Calibration, frame: str = "") -> str:
    """Return a parameter file for a ground station.

    Parameters
    ----------
    calibration : Calibration
        What to export; made from fields in the vehicle's forward-left-up axes.
    frame : str
        Of the magnetometer: from a log it says which compass this is.

    Returns
    -------
    str
        `NAME,value` lines.

    Raises
    ------
    NotExportable
        If the calibration turns the field by more than 5°.
    """
    held = without_rotation(calibration.correction, "ArduPilot")
    of_log = re.fullmatch(rf"{FRAME}([23]?)", frame)
    slot = of_log[1] if of_log else ""
    origin = (
        f"From a log, whose own OFS, DIA, ODI and SCALE were taken off: compass {slot or 1}.",
        "These numbers replace those in force; the compensation of the motors stays.",
    )
    driver = (
        "RESTS ON readings without COMPASS_OFS in them. MAVLink's RAW_IMU, and so imu/mag of",
        "MAVROS, has them in: calibrate with OFS and ODI at 0, DIA and SCALE at 1, or add these",
        "OFS to those in force.",
    )
    header = commented(
        "#",
        provenance(calibration),
        "corrected = D * (mag + OFS), milligauss, forward-right-down. Offsets beyond 1800 need",
        "a larger COMPASS_OFFS_MAX.",
        *(origin if of_log else driver),
        *held.comments,
    )
    offsets, matrix = -MILLIGAUSS * held.hard_iron, held.matrix
    values = {f"COMPASS_OFS{slot}_{axis}": offsets[k] for k, axis in enumerate("XYZ")}
    values |= {f"COMPASS_DIA{slot}_{axis}": matrix[k, k] for k, axis in enumerate("XYZ")}
    values |= {
        f"COMPASS_ODI{slot}_X": matrix[0, 1],
        f"COMPASS_ODI{slot}_Y": matrix[0, 2],
        f"COMPASS_ODI{slot}_Z": matrix[1, 2],
        f"COMPASS_SCALE{slot}": 1.0,
    }
    return header + "".join(f"{name},{number(value)}\n" for name, value in values.items())
