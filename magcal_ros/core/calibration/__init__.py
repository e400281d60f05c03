"""A calibration: the correction, its covariance, the evidence for it."""

from magcal_ros.core.lazy_names import lazy_names

__getattr__, __dir__, __all__ = lazy_names(
    __name__,
    """
    calibration: Evidence FittedGyroBias yaw_jacobian
    correction: AT_REST INPUTS MotorField MotorInput MotorState PARAMETERS
    figure: along
    heading_sigma: arc_sigma calibration_sigma every_figure heading_differences heading_jacobian
        heading_swing known_sigma predicted_heading_sigma sideways_acceleration
    """,
)
