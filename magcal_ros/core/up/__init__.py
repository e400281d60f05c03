"""Where up is: propagated by the gyro, corrected by the accelerometer."""

from magcal_ros.core.up.follower import (
    Up,
    UpFollower,
    propagated_up,
    relative_attitudes,
    unseen_angles,
)
from magcal_ros.core.up.propagation import GyroBias

__all__ = ["GyroBias", "Up", "UpFollower", "propagated_up", "relative_attitudes", "unseen_angles"]
