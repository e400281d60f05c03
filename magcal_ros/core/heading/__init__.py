"""From a corrected field to a yaw."""

from magcal_ros.core.lazy_names import lazy_names

__getattr__, __dir__, __all__ = lazy_names(
    __name__,
    """
    base_view: BaseView VehicleYaw corrected_pose vehicle_front
    compass: Heading Moment quaternion_from_rpy
    disturbance: DisturbanceDetector FieldDoubt PATIENCE Trust
    fused_yaw: FusedYaw
    motion_sense: MotionSense
    motors_now: MotorsNow ODDS UNSEEN
    several_compasses: SeveralCompasses
    yaw_filter: FUSION GyroLoss PERFECT YawFilter
    """,
)
