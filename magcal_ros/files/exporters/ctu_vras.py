"""ctu-vras compass stack: magnetometer_bias_remover and magnetometer_compass.

`unbiased = M (mag - bias)`, bias in tesla, M row by row (documentation of magnetometer_pipeline,
docs.ros.org/en/jazzy/p/magnetometer_pipeline). The documentation names the matrix
`initial_scaling_matrix`; the node reads `initial_mag_scaling_matrix`. Both are written: a node
ignores what it does not declare. `magnetometer_bias_x/y/z` is what magnetometer_bias_observer
loads under `load_from_params`; it publishes them without a matrix, and a matrix that the receiver
got as a parameter stays in force.
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
        What to export.

    Returns
    -------
    str
        YAML for ROS 2, matching nodes of every name.
    """
    correction = calibration.correction
    matrix = f"[{numbers(correction.matrix)}]"
    lines = ["/**:", "  ros__parameters:"]
    lines += [
        f"    {prefix}_{axis}: {number(value, OF_TESLA)}"
        for prefix in ("initial_mag_bias", "magnetometer_bias")
        for axis, value in zip("xyz", correction.hard_iron, strict=True)
    ]
    lines += [f"    initial_mag_scaling_matrix: {matrix}", f"    initial_scaling_matrix: {matrix}"]
    header = commented(
        "#",
        provenance(calibration),
        "unbiased = scaling_matrix * (mag - bias): tesla; the result is in the IMU's axes.",
    )
    return header + "\n".join(lines) + "\n"
