"""Where up is: carried by the gyro, corrected by the accelerometer."""

from magcal_ros.core.up.follower import Up, UpFollower
from magcal_ros.core.up.windows import carried_up, relative_attitudes

__all__ = ["Up", "UpFollower", "carried_up", "relative_attitudes"]
