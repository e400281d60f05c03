"""What a calibration is: the correction, its covariance, the evidence for it."""

from magcal_ros.core.calibration.calibration import (
    Calibration,
    Evidence,
)
from magcal_ros.core.calibration.correction import (
    PARAMETERS,
    Correction,
)
from magcal_ros.core.calibration.estimate import (
    Estimate,
    GyroSwing,
    Installation,
    yaw_jacobian,
)
from magcal_ros.core.calibration.figure import (
    Figure,
    along,
)
from magcal_ros.core.calibration.heading_sigma import (
    arc_sigma,
    calibration_sigma,
    common_figures,
    heading_jacobian,
    headings_apart,
    local_sigma,
    predicted_heading_sigma,
    rms_apart,
    sideways_pull,
)
from magcal_ros.core.calibration.motors import (
    AT_REST,
    MotorField,
    MotorInput,
    Running,
)

__all__ = [
    "AT_REST", "PARAMETERS", "Calibration", "Correction", "Estimate", "Evidence", "Figure",
    "GyroSwing", "Installation", "MotorField", "MotorInput", "Running", "along", "arc_sigma",
    "calibration_sigma", "common_figures", "heading_jacobian", "headings_apart", "local_sigma",
    "predicted_heading_sigma", "rms_apart", "sideways_pull", "yaw_jacobian",
]  # fmt: skip
