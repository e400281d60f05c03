"""From a corrected field to a yaw."""

from magcal_ros.core.lazy_names import lazy_names

__getattr__, __dir__, __all__ = lazy_names(
    __name__,
    """
    base_heading: BaseHeading VehicleYaw compare_with_course corrected_pose
    compass: CompassReader CompassReading Heading quaternion_from_rpy
    disturbance: FieldDeviation FieldUse PATIENCE
    fused_yaw: FusedYaw
    heading_tuning: FUSION
    motor_field_filter: MotorFieldFilter ODDS UNSEEN
    motor_inputs: MotionDetector
    several_compasses: SeveralCompasses
    yaw_filter: BY_COMPASS BY_REST GyroDrift PERFECT YawFilter
    """,
)
