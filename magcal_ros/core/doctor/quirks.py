"""Known faults of drivers: how they show in a log, and what corrects them."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from magcal_ros.core.doctor.health import Finding, looked_at
from magcal_ros.core.geometry.arrays import FloatArray
from magcal_ros.core.geometry.rotations import exp_rotations
from magcal_ros.core.knowledge import Knowledge
from magcal_ros.core.samples.units import FIELD_UNITS
from magcal_ros.core.samples.window import SensorLog

WRAP = 2.0**32 * 1e-6  # seconds after which a clock of 32 bits that counts microseconds begins anew

AK8963_IN_MPU9250 = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
AK09916_IN_ICM20948 = np.diag([1.0, -1.0, -1.0])
"""Rows: the magnetometer's axes in those of the same chip's accelerometer."""

NO_NORTH = (
    "do not use the yaw of this orientation as a heading: use compass/mag/enu/imu, or let the "
    "sensor publish its rotation vector, which uses the magnetometer"
)

INVERTED = -np.eye(3)  # as a field that points up looks where the inclination is known

FIELD_POINTS_UP = (
    "the field's inclination has the opposite sign to the reference's. A simulator may publish "
    "its world's field in north-east-down (NED) axes: in Gazebo, give the magnetometer's plugin "
    "<use_earth_frame_ned>false</use_earth_frame_ned>. On a robot, check the sign of "
    "reference.inclination_deg"
)


@dataclass(frozen=True)
class Quirk:
    """A known fault of a driver."""

    driver: str  # which drivers have it
    habit: str  # what it publishes
    remedy: str  # what to change
    line: str = "driver"  # which line of the page names it
    shows: Callable[[SensorLog, FloatArray | None], bool] | None = None
    """Whether a log shows it, given the magnetometer's axes (3, 3) in the IMU's where they alone
    err; None where the line that finds the fault names the driver itself."""


def _every_other_is_void(log: SensorLog, _: FloatArray | None) -> bool:
    void = np.asarray(~(np.abs(log.field) < 1e100).all(axis=1))
    # Of random gaps as many, half of the changes would be missing.
    return len(void) > 1 and float(np.mean(void[1:] != void[:-1])) > 0.75


def _leads_by(seconds: float, within: float) -> Callable[[SensorLog, FloatArray | None], bool]:
    """Return whether the field's stamps lead by so much, at the beginning and at the end."""

    def shows(log: SensorLog, _: FloatArray | None) -> bool:
        imu, field = (time[np.isfinite(time)] for time in (log.imu_time, log.field_time))
        if not len(imu) or not len(field):
            return False
        leads = field[[0, -1]] - imu[[0, -1]]
        return bool((np.abs(leads - seconds) < within).all())

    return shows


def _sits_as(habit: FloatArray) -> Callable[[SensorLog, FloatArray | None], bool]:
    return lambda _, axes: axes is not None and np.array_equal(axes, habit)


QUIRKS: tuple[Quirk, ...] = (
    *(
        Quirk(
            unit.drivers,
            f"publishes the field in {unit.name} instead of tesla",
            f"multiply by {unit.factor} in the driver",
            "field: unit",
        )
        for unit in FIELD_UNITS
        if unit.drivers
    ),
    Quirk(
        "Phidgets Spatial",
        "publishes NaN or 1e296 in every second message, between two readings of its magnetometer",
        ("lower the driver's data rate to the magnetometer's; until then these are left out"),
        shows=_every_other_is_void,
    ),
    Quirk(
        "SBG Systems",
        "stamps the field 4294.97 s ahead of the IMU: its 32-bit clock of microseconds has wrapped",
        "let the driver stamp with the ROS time (time_reference: ros), or restart the sensor",
        shows=_leads_by(WRAP, 1.0),
    ),
    Quirk(
        "ZED 2i",
        "stamps the field 0.8 s before the IMU that comes with it",
        "stamp the field with the time at which it is received, or use another magnetometer",
        shows=_leads_by(-0.8, 0.2),
    ),
    Quirk(
        "MPU-9250",
        "publishes the magnetometer's own axes, which are the accelerometer's y, x, -z",
        "set the mount_rpy_deg that the page names, or turn the axes in the driver",
        shows=_sits_as(AK8963_IN_MPU9250),
    ),
    Quirk(
        "ICM-20948 or a driver in forward-right-down axes",
        "publishes the magnetometer's own axes, which are the accelerometer's x, -y, -z",
        "set the mount_rpy_deg that the page names, or turn the axes in the driver",
        shows=_sits_as(AK09916_IN_ICM20948),
    ),
    Quirk(
        "Gazebo",
        "publishes its world's field in north-east-down axes (NED): it points up",
        "set use_earth_frame_ned to false in the magnetometer's plugin",
        shows=_sits_as(INVERTED),
    ),
    Quirk(
        "BNO08x",
        "publishes the game rotation vector as orientation: its yaw does not refer to north",
        NO_NORTH,
        "orientation",
    ),
)


def known_habits(log: SensorLog, axes: FloatArray | None = None) -> list[Finding]:
    """Return a line for each driver whose habit a log shows.

    `axes` (3, 3) are the magnetometer's, rows in the IMU's, where they alone err.
    """
    return [
        looked_at("driver", "driver", f"as {each.driver}: {each.habit}", each.remedy)
        for each in QUIRKS
        if each.shows is not None and each.shows(log, axes)
    ]


@dataclass(frozen=True)
class YawTuning:
    """How far a driver's yaw may be off the magnetic yaw, and how well a log shows it."""

    declination: float = math.radians(25.0)  # largest where people live, where no place is given
    own: float = math.radians(8.0)
    """Sigma of the mean error, over a turn or a part of it, of a driver's own compass."""
    sigma: float = math.radians(15.0)  # radians; a log that shows it worse shows nothing


YAW = YawTuning()


def orientation_findings(log: SensorLog, knowledge: Knowledge) -> list[Finding]:
    """Compare the yaw of the driver's orientation with the field; nothing where it has none.

    In the world of this orientation the field is one vector, and the hard iron one in the
    magnetometer's axes: both follow from a turn by linear least squares. The direction of the
    vector is how far this world's north is off.
    """
    if log.orientation is None or not len(log.field) or not len(log.imu_time):
        return []
    order = np.argsort(log.imu_time)
    nearest = np.searchsorted(log.imu_time[order], log.field_time).clip(0, len(order) - 1)
    quaternion = log.orientation[order][nearest]
    size = np.linalg.norm(quaternion, axis=1)
    with np.errstate(over="ignore", invalid="ignore"):
        kept = (np.abs(size - 1.0) < 0.02) & (np.linalg.norm(log.field, axis=1) < 1e100)
    if kept.sum() < 20:
        return []
    vector, turn = quaternion[kept, :3], quaternion[kept, 3:]
    sine = np.linalg.norm(vector, axis=1, keepdims=True)
    to_world = exp_rotations(2.0 * np.arctan2(sine, turn) * vector / np.maximum(sine, 1e-12))
    field = log.field[kept] @ knowledge.mounting.to_body.T
    axes = np.broadcast_to(np.eye(3), to_world.shape)
    design = np.concatenate([np.swapaxes(to_world, 1, 2), axes], axis=2).reshape(-1, 6)
    found = np.linalg.lstsq(design, field.ravel(), rcond=None)[0]
    # What is left is soft iron and wrong attitudes, which last: it does not average out. Neither
    # vector is longer than the readings.
    left = float(np.mean((design @ found - field.ravel()) ** 2))
    longest = float((field**2).sum(axis=1).max())
    known = design.T @ design / kept.sum() + left / longest * np.eye(6)
    level = left * np.linalg.inv(known)[:2, :2]
    across = np.array([-found[1], found[0]]) / float(found[:2] @ found[:2])
    sigma = math.sqrt(float(across @ level @ across))
    if not sigma < YAW.sigma:
        return []
    off = math.remainder(math.atan2(found[1], found[0]) - 0.5 * math.pi, math.tau)
    declination = knowledge.reference.declination
    least, most = -YAW.declination, YAW.declination
    if declination is not None:
        least, most = min(-declination, 0.0), max(-declination, 0.0)
    sizes = f"{math.degrees(off):+.0f} ± {math.degrees(sigma):.0f}°"
    words = f"its yaw is {sizes} off the magnetic yaw (ENU)"
    if max(least - off, off - most) < 3.0 * math.hypot(sigma, YAW.own):
        return [looked_at("orientation", "IMU: orientation", words)]
    words += (
        ": it counts from north instead of east, or it does not refer to north (game rotation "
        "vector of a BNO08x)"
    )
    return [looked_at("orientation", "IMU: orientation", words, NO_NORTH)]
