"""Recordings as other robots would have made them: the same drive by other sensors.

Whatever is done here is known exactly, so that an answer must not be worse for it, or must say so.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import shared_cases  # noqa: F401
from recorded_truth import Drive, Truth

from magcal_ros.core.geometry.arrays import FloatArray
from magcal_ros.core.geometry.rotations import rotation_from_rpy
from magcal_ros.files.recording import Recording

STAMP, FORCE, RATE, FIELD = slice(0, 1), slice(1, 4), slice(4, 7), slice(1, 4)
LATE = 0.6
"""Seconds by which a course usually comes late; driven backwards it would be early."""

Change = Callable[[FloatArray, FloatArray], tuple[FloatArray, FloatArray]]
"""From tables of IMU (n, 7) and field (m, 4) to those of the other sensors; both may be written."""


def turned(imu_rpy: tuple[float, float, float], mag_rpy: tuple[float, float, float]) -> Change:
    """Sensors mounted otherwise, degrees."""
    of_imu, of_field = (rotation_from_rpy(*np.radians(rpy)) for rpy in (imu_rpy, mag_rpy))

    def change(imu: FloatArray, field: FloatArray) -> tuple[FloatArray, FloatArray]:
        imu[:, FORCE] = imu[:, FORCE] @ of_imu.T
        imu[:, RATE] = imu[:, RATE] @ of_imu.T
        field[:, FIELD] = field[:, FIELD] @ of_field.T
        return imu, field

    return change


def added(
    force: tuple[float, float, float] = (0.0, 0.0, 0.0),
    rate: tuple[float, float, float] = (0.0, 0.0, 0.0),
    field: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> Change:
    """Offsets of accelerometer (m/s²), gyro (degrees a second) and magnetometer (µT)."""

    def change(imu: FloatArray, raw: FloatArray) -> tuple[FloatArray, FloatArray]:
        imu[:, FORCE] += force
        imu[:, RATE] += np.radians(rate)
        raw[:, FIELD] += 1e-6 * np.array(field)
        return imu, raw

    return change


def softened(imu: FloatArray, field: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Soft iron of up to 12%."""
    iron = np.array([[1.12, 0.04, 0.02], [0.04, 0.92, -0.03], [0.02, -0.03, 1.05]])
    field[:, FIELD] = field[:, FIELD] @ iron.T
    return imu, field


def noisier(imu: FloatArray, field: FloatArray) -> tuple[FloatArray, FloatArray]:
    """A coarse magnetometer: .6 µT of noise, steps of .3 µT."""
    noisy = field[:, FIELD] + np.random.default_rng(5).normal(0.0, 0.6e-6, (len(field), 3))
    field[:, FIELD] = np.round(noisy / 0.3e-6) * 0.3e-6
    return imu, field


def slower(imu: FloatArray, field: FloatArray) -> tuple[FloatArray, FloatArray]:
    """A quarter of the samples, as they came."""
    return imu[::4], field[::4]


def later(imu: FloatArray, field: FloatArray) -> tuple[FloatArray, FloatArray]:
    """A field that is 60 ms late."""
    field[:, STAMP] += 0.06
    return imu, field


def without_gyro(imu: FloatArray, field: FloatArray) -> tuple[FloatArray, FloatArray]:
    """An IMU without a gyro."""
    imu[:, RATE] = math.nan
    return imu, field


def with_a_gain(imu: FloatArray, field: FloatArray) -> tuple[FloatArray, FloatArray]:
    """A gyro with a scale error of 3%."""
    imu[:, RATE] *= 1.03
    return imu, field


def about_z_alone(imu: FloatArray, field: FloatArray) -> tuple[FloatArray, FloatArray]:
    """A gyro that measures about z alone."""
    imu[:, RATE] *= np.array([0.0, 0.0, 1.0])
    return imu, field


MIRROR = np.array([1.0, -1.0, 1.0])


def mirrored(imu: FloatArray, field: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The drive in a mirror: left is right."""
    imu[:, FORCE] *= MIRROR
    imu[:, RATE] *= -MIRROR
    field[:, FIELD] *= MIRROR
    return imu, field


def backwards(imu: FloatArray, field: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The drive backwards in time."""
    ends = imu[0, 0] + imu[-1, 0]
    imu, field = imu[::-1], field[::-1]
    imu[:, STAMP], field[:, STAMP] = ends - imu[:, STAMP], ends - field[:, STAMP]
    imu[:, RATE] *= -1.0
    return imu, field


CHANGES: dict[str, Change] = {
    "mirrored": mirrored,
    "backwards": backwards,
    "tilted": turned((8.0, -5.0, 0.0), (8.0, -5.0, 0.0)),
    "turned by 45": turned((0.0, 0.0, -45.0), (0.0, 0.0, -45.0)),
    "turned by 90": turned((0.0, 0.0, 90.0), (0.0, 0.0, 90.0)),
    "field tilted": turned((0.0, 0.0, 0.0), (6.0, -4.0, 0.0)),
    "hard iron": added(field=(30.0, -20.0, 40.0)),
    "soft iron": softened,
    "gyro off": added(rate=(2.0, -1.5, 1.0)),
    "gyro gain": with_a_gain,
    "gyro about z": about_z_alone,
    "no gyro": without_gyro,
    "force off": added(force=(0.25, -0.2, 0.0)),
    "field noisy": noisier,
    "field late": later,
    "10 Hz": slower,
}


def truth_mirrored(truth: Truth, _: FloatArray) -> Truth:
    return replace(truth, yaw=-truth.yaw)


def truth_backwards(truth: Truth, time: FloatArray) -> Truth:
    late = 2.0 * LATE if truth.is_course else 0.0
    turned_around = time[0] + time[-1] - truth.time
    return replace(truth, time=turned_around[::-1] + late, yaw=truth.yaw[::-1])


TRUTHS = {"mirrored": truth_mirrored, "backwards": truth_backwards}
"""What becomes of the truth over the stamps of a recording; of the other changes nothing."""


def changed(drive: Drive, name: str | None) -> Drive:
    """Return a drive as the sensors of one of `CHANGES` would have recorded it; None as it is."""
    if name is None:
        return drive
    recorded, truth = drive.recording, drive.truth
    if truth is not None and name in TRUTHS:
        truth = TRUTHS[name](truth, recorded.imu[:, 0])
    imu, field = CHANGES[name](recorded.imu.copy(), recorded.field.copy())
    return Drive(drive.name, Recording(imu, field), truth, drive.knowledge)
