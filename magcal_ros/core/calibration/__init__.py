"""A calibration: the correction, its covariance, the evidence for it."""

from magcal_ros.core.calibration.calibration import (
    Calibration,
    Estimate,
    Evidence,
    GyroSwing,
    Installation,
    yaw_jacobian,
)
from magcal_ros.core.calibration.correction import (
    AT_REST,
    PARAMETERS,
    Correction,
    MotorField,
    MotorInput,
    Running,
)
from magcal_ros.core.calibration.figure import Figure, along
from magcal_ros.core.calibration.heading_sigma import (
    arc_sigma,
    calibration_sigma,
    common_figures,
    heading_jacobian,
    headings_apart,
    local_sigma,
    predicted_heading_sigma,
    rms_apart,
    sideways_acceleration,
)

__all__ = [
    "AT_REST", "PARAMETERS", "Calibration", "Correction", "Estimate", "Evidence", "Figure",
    "GyroSwing", "Installation", "MotorField", "MotorInput", "Running", "along", "arc_sigma",
    "calibration_sigma", "common_figures", "heading_jacobian", "headings_apart", "local_sigma",
    "predicted_heading_sigma", "rms_apart", "sideways_acceleration",
    "yaw_jacobian",
]  # fmt: skip
