"""Known faults of drivers: how a log shows them, and the remedies."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from magcal_ros.core.doctor.doctor_tuning import ERRORS
from magcal_ros.core.doctor.finding import Finding, ok_or_warning
from magcal_ros.core.geometry.arrays import FloatArray
from magcal_ros.core.knowledge import CLEAR, Knowledge
from magcal_ros.core.samples.units import FIELD_UNITS
from magcal_ros.core.samples.window import SensorLog

WRAP = 2.0**32 * 1e-6  # seconds until a 32-bit counter of microseconds wraps around

AK8963_IN_MPU9250 = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
AK09916_IN_ICM20948 = np.diag([1.0, -1.0, -1.0])
"""Rows are the magnetometer's axes in the axes of the accelerometer on the same chip."""

NO_NORTH = (
    "do not use the yaw of this orientation as a heading: use compass/mag/enu/imu, or let the "
    "sensor publish its rotation vector, which uses the magnetometer"
)

INVERTED = -np.eye(3)  # axes that look like a field that points up, if the inclination is known

FIELD_POINTS_UP = (
    "the field's inclination has the opposite sign to the reference's. A simulator may publish "
    "its world's field in north-east-down (NED) axes: in Gazebo, give the magnetometer's plugin "
    "<use_earth_frame_ned>false</use_earth_frame_ned>. On a robot, check the sign of "
    "reference.inclination_deg"
)


@dataclass(frozen=True)
class Quirk:
    """A known fault of a driver."""

    driver: str  # names of the drivers
    fault: str  # its description
    remedy: str
    line: str = "driver"  # `Finding.name` of the finding on the fault
    shows: Callable[[SensorLog, FloatArray | None], bool] | None = None
    """Whether a log has the fault. The second argument is the magnetometer's axes (3, 3) in the
    IMU's, if only these are wrong. None if another check finds the fault."""


def _alternates_with_invalid(log: SensorLog, _: FloatArray | None) -> bool:
    void = np.asarray(~(np.abs(log.field) < 1e100).all(axis=1))
    # If as many were invalid at random, half of the changes would be missing.
    return len(void) > 1 and float(np.mean(void[1:] != void[:-1])) > 0.75


def _leads_by(seconds: float, within: float) -> Callable[[SensorLog, FloatArray | None], bool]:
    """Return a test that the field's stamps lead by `seconds`, at the beginning and the end."""

    def shows(log: SensorLog, _: FloatArray | None) -> bool:
        imu, field = (time[np.isfinite(time)] for time in (log.imu_time, log.field_time))
        if not len(imu) or not len(field):
            return False
        leads = field[[0, -1]] - imu[[0, -1]]
        return bool((np.abs(leads - seconds) < within).all())

    return shows


def _has_axes(habit: FloatArray) -> Callable[[SensorLog, FloatArray | None], bool]:
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
        shows=_alternates_with_invalid,
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
        shows=_has_axes(AK8963_IN_MPU9250),
    ),
    Quirk(
        "ICM-20948 or a driver in forward-right-down axes",
        "publishes the magnetometer's own axes, which are the accelerometer's x, -y, -z",
        "set the mount_rpy_deg that the page names, or turn the axes in the driver",
        shows=_has_axes(AK09916_IN_ICM20948),
    ),
    Quirk(
        "Gazebo",
        "publishes its world's field in north-east-down axes (NED): it points up",
        "set use_earth_frame_ned to false in the magnetometer's plugin",
        shows=_has_axes(INVERTED),
    ),
    Quirk(
        "BNO08x",
        "publishes the game rotation vector as orientation: its yaw does not refer to north",
        NO_NORTH,
        "orientation",
    ),
)


def known_quirks(log: SensorLog, axes: FloatArray | None = None) -> list[Finding]:
    """Return a finding for each driver whose known fault a log has.

    Rows of `axes` (3, 3) are the magnetometer's axes in the IMU's, if only these are wrong.
    """
    return [
        ok_or_warning("driver", "driver", f"as {each.driver}: {each.fault}", each.remedy)
        for each in QUIRKS
        if each.shows is not None and each.shows(log, axes)
    ]


def orientation_findings(log: SensorLog, knowledge: Knowledge) -> list[Finding]:
    """Compare the yaw of the driver's orientation with the field; empty without an orientation.

    The field is constant in the world frame of this orientation, and the hard iron in body axes.
    Both follow from a turn by linear least squares. The direction of the field gives the error of
    this frame's north.
    """
    if log.orientation is None or not len(log.field) or not len(log.imu_time):
        return []
    # Slow to import.
    from scipy.spatial.transform import Rotation

    order = np.argsort(log.imu_time)
    nearest = np.searchsorted(log.imu_time[order], log.field_time).clip(0, len(order) - 1)
    quaternion = log.orientation[order][nearest]
    size = np.linalg.norm(quaternion, axis=1)
    with np.errstate(over="ignore", invalid="ignore"):
        kept = (np.abs(size - 1.0) < 0.02) & (np.linalg.norm(log.field, axis=1) < 1e100)
    if kept.sum() < 20:
        return []
    to_world = Rotation.from_quat(quaternion[kept]).as_matrix()
    field = log.field[kept] @ knowledge.mounting.to_body.T
    axes = np.broadcast_to(np.eye(3), to_world.shape)
    design = np.concatenate([np.swapaxes(to_world, 1, 2), axes], axis=2).reshape(-1, 6)
    found = np.linalg.lstsq(design, field.ravel(), rcond=None)[0]
    # Residuals of soft iron and wrong attitudes are systematic and do not average out. The prior
    # of both vectors has the size of the largest reading.
    left = float(np.mean((design @ found - field.ravel()) ** 2))
    longest = float((field**2).sum(axis=1).max())
    known = design.T @ design / kept.sum() + left / longest * np.eye(6)
    level = left * np.linalg.inv(known)[:2, :2]
    across = np.array([-found[1], found[0]]) / float(found[:2] @ found[:2])
    sigma = math.sqrt(float(across @ level @ across))
    if not sigma * CLEAR < ERRORS.near:
        return []
    off = math.remainder(math.atan2(found[1], found[0]) - 0.5 * math.pi, math.tau)
    declination = knowledge.reference.declination
    least, most = -ERRORS.declination, ERRORS.declination
    if declination is not None:
        least, most = min(-declination, 0.0), max(-declination, 0.0)
    sizes = f"{math.degrees(off):+.0f} ± {math.degrees(sigma):.0f}°"
    words = f"its yaw is {sizes} off the magnetic yaw (ENU)"
    if max(least - off, off - most) < 3.0 * math.hypot(sigma, ERRORS.own_yaw):
        return [ok_or_warning("orientation", "IMU: orientation", words)]
    words += (
        ": it counts from north instead of east, or it does not refer to north (game rotation "
        "vector of a BNO08x)"
    )
    return [ok_or_warning("orientation", "IMU: orientation", words, NO_NORTH)]
