"""Conversion of the numbers in messages to samples."""

from __future__ import annotations

import math
from typing import Any

from magcal_ros.core.earth_field.reference import Fix
from magcal_ros.core.geometry.vec3 import Triple
from magcal_ros.core.samples.streams import HeadingSample, ImuSample, SpeedSample, VelocitySample

NO_RATE: Triple = (math.nan, math.nan, math.nan)
ABSENT = -1.0
"""First element of a covariance whose measurement is absent (sensor_msgs/Imu)."""


def seconds(stamp: Any) -> float:
    """Return a builtin_interfaces/Time in seconds."""
    return float(stamp.sec + stamp.nanosec * 1e-9)


def imu_of(
    stamp: float,
    force: Triple,
    force_mark: float,
    rate: Triple,
    rate_mark: float,
    orientation: tuple[float, float, float, float],
    orientation_mark: float,
) -> ImuSample | None:
    """Return the sample of an Imu's numbers; None if its acceleration is marked absent.

    The stamp is in seconds, force in m/s², rate in rad/s, orientation as quaternion x, y, z, w. The
    marks are the first elements of covariances; -1 there means that the measurement is absent.
    """
    if force_mark == ABSENT:
        return None
    return ImuSample(
        stamp,
        force,
        NO_RATE if rate_mark == ABSENT else rate,
        None if orientation_mark == ABSENT else orientation,
    )


def fix_from(stamp: float, status: int, latitude: float, longitude: float, altitude: float) -> Fix:
    """Return the fix of a NavSatFix, from seconds, its status, degrees and metres."""
    # STATUS_FIX of sensor_msgs/NavSatStatus is 0; only STATUS_NO_FIX is below.
    return Fix(status >= 0, latitude, longitude, altitude, stamp)


RECEIVER_SPEED_SIGMA = 0.1
"""m/s per axis of a receiver's velocity; a TwistStamped carries no covariance."""


def speed_from(
    stamp: float, world: str, child: str, mark: float, x: float, y: float
) -> SpeedSample | str:
    """Return the signed speed of an Odometry, or why it has none.

    The stamp is in seconds, `world` and `child` are the frames, `mark` is the first element of the
    twist's covariance, and x, y are the velocity, m/s. By REP-105 and nav_msgs the twist is in
    `child_frame_id`, the vehicle's frame.
    """
    if child and child == world:
        return (
            f"its child_frame_id {child!r} is its frame_id, so that its twist is not a speed along "
            "the vehicle: give the vehicle's frame as child_frame_id"
        )
    if mark == ABSENT:
        return "its twist is marked absent (covariance -1)"
    if not math.isfinite(x + y):
        return "its twist is not finite"
    # The sideways component is included, because frames are slightly misaligned.
    return SpeedSample(stamp, math.copysign(math.hypot(x, y), x))


def velocity_from(
    stamp: float, east: float, north: float, of_east: float = 0.0, of_north: float = 0.0
) -> VelocitySample | str:
    """Return the velocity of a twist, or why it has none.

    The stamp is in seconds, the velocity in m/s, and `of_east`, `of_north` are the variances,
    (m/s)²; zero if unknown.
    """
    if of_east == ABSENT:
        return "its velocity is marked absent (covariance -1)"
    sigma = RECEIVER_SPEED_SIGMA
    if of_east > 0.0 and of_north > 0.0:
        sigma = math.sqrt(0.5 * (of_east + of_north))
    if not math.isfinite(east + north + sigma):
        return "its velocity is not finite"
    return VelocitySample(stamp, east, north, sigma)


HEADING_SIGMA = math.radians(1.0)
"""Sigma of a heading whose orientation covariance is zero, which means unknown."""
NO_HEADING = math.radians(30.0)  # sigma from which a heading counts as unknown


def heading_from(
    stamp: float, orientation: tuple[float, float, float, float], mark: float, variance: float
) -> HeadingSample | str:
    """Return the yaw of an Imu's orientation (x, y, z, w), or why it has none.

    `mark` is the first element of its covariance, and `variance` the variance of the yaw, rad².
    """
    x, y, z, w = orientation
    if mark == ABSENT:
        return "its orientation is marked absent (covariance -1)"
    size = x * x + y * y + z * z + w * w
    if not abs(size - 1.0) < 0.02:
        return f"its orientation is not a unit quaternion (length {math.sqrt(abs(size)):.3g})"
    if not (math.isfinite(variance) and 0.0 <= variance < NO_HEADING**2):
        return "its orientation covariance says that the yaw is not known"
    yaw = math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
    return HeadingSample(stamp, yaw, math.sqrt(variance) if variance > 0.0 else HEADING_SIGMA)
