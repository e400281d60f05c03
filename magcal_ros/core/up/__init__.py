"""The direction of up: propagated by the gyro, corrected by the accelerometer."""

from magcal_ros.core.lazy_names import lazy_names

__getattr__, __dir__, __all__ = lazy_names(
    __name__,
    """
    filter: REST
    follower: Levelling Up UpFollower propagated_up
    propagation: GyroBias LinearAcceleration
    stillness: BlockMeans GyroCheck ShakenRest SteadyInterval
    """,
)
