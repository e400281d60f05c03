"""The twelve numbers as a C header, for firmware of one's own.

`body = MAGCAL_MATRIX (raw - MAGCAL_HARD_IRON)`, tesla, forward-left-up.
"""

from __future__ import annotations

from magcal_ros.core.calibration.calibration import Calibration
from magcal_ros.files.exporters.common import OF_TESLA, numbers, provenance


def export(calibration: Calibration) -> str:
    """Return a header that any C or C++ compiler takes.

    Parameters
    ----------
    calibration : Calibration
        What to export; nothing is lost.

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
