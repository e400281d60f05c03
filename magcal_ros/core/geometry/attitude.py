"""Up, tilt and tilt-compensated yaw from specific force and field (FLU body, ENU world)."""

from __future__ import annotations

import math

import numpy as np

from magcal_ros.core.geometry.arrays import FloatArray

STANDARD_GRAVITY = 9.80665  # m/s², the specific force of an accelerometer at rest, upwards

FRD_FROM_FLU: FloatArray = np.diag([1.0, -1.0, -1.0])
"""Body axes forward-right-down from forward-left-up, and the other way round."""


def unit(vectors: FloatArray) -> FloatArray:
    """Scale vectors (..., 3) to length one; a zero vector stays zero."""
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.asarray(vectors / np.where(length > 0.0, length, 1.0))


def usual_size(vectors: FloatArray) -> float:
    """Return the median length of vectors (n, 3)."""
    return float(np.median(np.linalg.norm(vectors, axis=1)))


def angle_between(one: FloatArray, other: FloatArray) -> float:
    """Return the angle between two vectors (3,), radians; zero if one of them is zero."""
    return math.atan2(float(np.linalg.norm(np.cross(one, other))), float(one @ other))


def level_part(vectors: FloatArray, up: FloatArray) -> FloatArray:
    """Return the components of vectors (n, 3) perpendicular to up, unit vectors (n, 3)."""
    return np.asarray(vectors - np.sum(vectors * up, axis=1, keepdims=True) * up)


def yaw_from_up_and_field(up: FloatArray, field: FloatArray) -> FloatArray:
    """Return the ENU yaw to magnetic north.

    Up and field (..., 3) are in body axes, of any positive length. East is the field crossed with
    up, north is up crossed with east (Vitali, ST design tip DT0103, computes the same in NED). The
    yaw (...) is in radians in (-pi, pi]: zero where body x points to magnetic east,
    counter-clockwise positive.
    """
    up = unit(up)
    east = np.cross(field, up)
    north = np.cross(up, east)
    return np.asarray(np.arctan2(north[..., 0], east[..., 0]))


def body_from_enu(up: FloatArray, field: FloatArray) -> FloatArray:
    """Return the rotation from magnetic ENU to body axes by gravity and field.

    Both vectors (..., 3) are in body axes and not parallel. The columns of the rotations (..., 3,
    3) are east, north and up in body axes.
    """
    up = unit(up)
    east = unit(np.cross(field, up))
    return np.stack([east, np.cross(up, east), up], axis=-1)


def field_in_enu(strength: float, inclination: float, declination: float = 0.0) -> FloatArray:
    """Return the reference field in ENU, shape (3,), in the unit of `strength`.

    `inclination` is positive where the field points down, and `declination` where magnetic north
    lies east of true north, radians; without a declination it is magnetic ENU.
    """
    level = strength * np.cos(inclination)
    return np.array(
        [level * np.sin(declination), level * np.cos(declination), -strength * np.sin(inclination)]
    )


def yaw_rate(rate: FloatArray, up: FloatArray) -> FloatArray:
    """Return the rate of yaw, rad/s, (n,), from the gyro (n, 3) and up (n, 3) in body axes.

    It is (w_y sin roll + w_z cos roll) / cos pitch, on any slope.
    """
    across = np.maximum(1.0 - up[:, 0] ** 2, 0.0025)  # nose up or down there is no yaw
    return np.asarray(np.sum(rate[:, 1:] * up[:, 1:], axis=1) / across)


def wrap_angle(angle: FloatArray | float) -> FloatArray:
    """Return angles in radians, wrapped into (-pi, pi]."""
    return np.asarray(np.pi - np.mod(np.pi - np.asarray(angle), 2.0 * np.pi))


def wrapped(angle: float) -> float:
    """Return one angle in radians, wrapped into [-pi, pi]; faster than `wrap_angle`."""
    return math.remainder(angle, math.tau)


def mean_angle(angles: FloatArray) -> float:
    """Return the mean of directions in one plane, radians in (-pi, pi]."""
    return float(np.angle(np.exp(1j * angles).mean()))


def true_yaw(magnetic_yaw: float, declination: float) -> float:
    """Return the ENU yaw to true north, radians in (-pi, pi]: declination is positive east."""
    return float(wrap_angle(magnetic_yaw - declination))
