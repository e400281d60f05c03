"""Rotation matrices, and axes that are swapped or have a wrong sign.

Every matrix is *active*: `R @ v` rotates the vector `v`. A change of axes "from body to sensor" is
the inverse of the sensor's pose in the body.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import fields, is_dataclass, replace
from functools import cache
from typing import Any, TypeVar

import numpy as np

from magcal_ros.core.geometry.arrays import FloatArray, frozen_array

T = TypeVar("T")
IDENTITY = frozen_array(np.eye(3), (3, 3), "rotation")


def in_axes(value: T, rotation: FloatArray) -> T:
    """Return a value in body axes that are rotated by `rotation` (3, 3), by its own `in_axes`.

    The elements of a list, a tuple, a mapping, and of a dataclass without `in_axes`, are returned
    in rotated axes. Anything else, arrays included, is taken to have no axes and stays as it is.
    """
    found: Any = value
    if np.array_equal(rotation, IDENTITY):
        return value
    if hasattr(value, "in_axes"):
        found = value.in_axes(rotation)
    elif type(value) in (list, tuple):
        found = type(found)(in_axes(each, rotation) for each in found)
    elif isinstance(value, Mapping):
        found = {name: in_axes(each, rotation) for name, each in value.items()}
    elif is_dataclass(value) and not isinstance(value, type):
        names = [each.name for each in fields(value)]
        found = replace(value, **{name: in_axes(getattr(value, name), rotation) for name in names})
    return found  # type: ignore[no-any-return]


def skew(v: FloatArray) -> FloatArray:
    """Return the matrix of the cross product: `skew(v) @ w == np.cross(v, w)`, shape (3, 3)."""
    x, y, z = v
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def exp_rotation(vector: FloatArray) -> FloatArray:
    """Return the rotation by |vector| radians about `vector` (Rodrigues' formula), (3, 3)."""
    x, y, z = vector.tolist()
    xx, yy, zz = x * x, y * y, z * z
    angle = math.sqrt(xx + yy + zz)
    s, c = 1.0, 0.5
    if angle >= 1e-8:
        # 1 - cos by the half angle: no cancellation for small steps.
        s, c = math.sin(angle) / angle, 2.0 * (math.sin(0.5 * angle) / angle) ** 2
    xy, yz, zx = c * x * y, c * y * z, c * z * x
    return np.array(
        [
            [1.0 - c * (yy + zz), xy - s * z, zx + s * y],
            [xy + s * z, 1.0 - c * (xx + zz), yz - s * x],
            [zx - s * y, yz + s * x, 1.0 - c * (xx + yy)],
        ]
    )


def crossed(one: FloatArray, other: FloatArray) -> FloatArray:
    """Return the cross products of vectors (..., 3), three times as fast as `np.cross`."""
    x, y, z = one[..., 0], one[..., 1], one[..., 2]
    u, v, w = other[..., 0], other[..., 1], other[..., 2]
    out = np.empty(np.broadcast_shapes(one.shape, other.shape))
    out[..., 0] = y * w - z * v
    out[..., 1] = z * u - x * w
    out[..., 2] = x * v - y * u
    return out


def skews(vectors: FloatArray) -> FloatArray:
    """Return the cross-product matrices of vectors (..., 3), shape (..., 3, 3)."""
    out = np.zeros((*vectors.shape, 3))
    x, y, z = vectors[..., 0], vectors[..., 1], vectors[..., 2]
    out[..., 0, 1], out[..., 0, 2], out[..., 1, 2] = -z, y, -x
    out[..., 1, 0], out[..., 2, 0], out[..., 2, 1] = z, -y, x
    return out


def exp_rotations(vectors: FloatArray) -> FloatArray:
    """Return Rodrigues' rotation for each vector (n, 3) of radians, shape (n, 3, 3)."""
    angle = np.sqrt(np.add.reduce(vectors * vectors, axis=1))
    safe = np.maximum(angle, 1e-8)
    sine = np.where(angle < 1e-8, 1.0, np.sin(safe) / safe)
    # 1 - cos by the half angle: no cancellation for small steps.
    versine = np.where(angle < 1e-8, 0.5, 2.0 * (np.sin(0.5 * safe) / safe) ** 2)
    k = skews(vectors)
    return np.asarray(IDENTITY + sine[:, None, None] * k + versine[:, None, None] * (k @ k))


def rotation_vectors(rotations: FloatArray) -> FloatArray:
    """Return the vectors (n, 3) of small rotations (n, 3, 3), the inverse of `exp_rotations`.

    Angles below a quarter turn.
    """
    part = _axis_by_sine(rotations)
    sine = np.minimum(np.linalg.norm(part, axis=1), 1.0)
    longer = np.where(sine > 1e-9, np.arcsin(sine) / np.maximum(sine, 1e-9), 1.0)
    return np.asarray(part * longer[:, None])


def rotation_vectors_near(rotations: FloatArray, near: FloatArray) -> FloatArray:
    """Return the vectors of rotations (n, 3, 3) by any angle, each the one nearest to `near`.

    A rotation does not show full turns; `near` (n, 3) is a rough estimate, radians.
    """
    part = _axis_by_sine(rotations)
    sine = np.linalg.norm(part, axis=1)
    angle = np.arctan2(sine, 0.5 * (np.trace(rotations, axis1=1, axis2=2) - 1.0))
    # The antisymmetric part does not show the axis of full and half turns.
    shown = (sine > 1e-6)[:, None]
    size = np.linalg.norm(near, axis=1)
    axis = np.where(shown, part / np.maximum(sine, 1e-6)[:, None], near / (size + 1e-12)[:, None])
    rounds = np.round((np.sum(near * axis, axis=1) - angle) / math.tau)
    is_tiny = ~shown & (size < 1.0)[:, None]
    return np.where(is_tiny, part, axis * (angle + math.tau * rounds)[:, None])


def _axis_by_sine(rotations: FloatArray) -> FloatArray:
    """Return the axes times the sines of the angles, the antisymmetric parts, shape (n, 3)."""
    return np.asarray(
        0.5 * (rotations[:, [2, 0, 1], [1, 2, 0]] - rotations[:, [1, 2, 0], [2, 0, 1]])
    )


def turns_about_z(rotations: FloatArray) -> FloatArray:
    """Return the angles (n,) of the rotations about z nearest to rotations (n, 3, 3)."""
    return np.arctan2(
        rotations[:, 1, 0] - rotations[:, 0, 1], rotations[:, 0, 0] + rotations[:, 1, 1]
    )


def chained(steps: FloatArray) -> FloatArray:
    """Return the products of steps (k, n, 3, 3), each on the left of those before it.

    Shape (k, n + 1, 3, 3); the first product of each k is the identity. Blocks of about the root of
    n steps are multiplied in parallel and then combined.
    """
    count, n = steps.shape[:2]
    length = max(1, math.isqrt(n))
    blocks = -(-n // length)
    padded = np.broadcast_to(np.eye(3), (count, blocks * length, 3, 3)).copy()
    padded[:, :n] = steps
    within = padded.reshape(count, blocks, length, 3, 3)
    for row in range(1, length):
        within[:, :, row] = within[:, :, row] @ within[:, :, row - 1]
    before = np.broadcast_to(np.eye(3), (count, blocks, 3, 3)).copy()
    for block in range(1, blocks):
        before[:, block] = within[:, block - 1, -1] @ before[:, block - 1]
    out = np.broadcast_to(np.eye(3), (count, n + 1, 3, 3)).copy()
    out[:, 1:] = (within @ before[:, :, None]).reshape(count, -1, 3, 3)[:, :n]
    return out


def rotation_about(axis: FloatArray, angle: FloatArray) -> FloatArray:
    """Return rotations by each of `angle` (n,) radians about the unit vector `axis`."""
    return exp_rotations(angle[:, None] * axis)


def rotation_from_rpy(roll: float, pitch: float, yaw: float = 0.0) -> FloatArray:
    """Return the pose Rz(yaw) Ry(pitch) Rx(roll) of a link in its parent (REP-103, URDF).

    The angles are radians about the fixed axes x, y, z, in this order. The matrix is the rotation
    from the link's axes to the parent's.
    """
    cr, sr = math.cos(roll), math.sin(roll)
    cp, sp = math.cos(pitch), math.sin(pitch)
    cy, sy = math.cos(yaw), math.sin(yaw)
    return np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )


def rpy_from_rotation(pose: FloatArray) -> tuple[float, float, float]:
    """Return roll, pitch, yaw in radians of a pose: the inverse of `rotation_from_rpy`.

    Pitch is within ±90°. At ±90° roll and yaw have the same axis, and yaw is set to zero.
    """
    pitch = math.asin(min(1.0, max(-1.0, -float(pose[2, 0]))))
    if math.hypot(float(pose[0, 0]), float(pose[1, 0])) < 1e-9:
        roll = math.atan2(-float(pose[1, 2]), float(pose[1, 1]))
        return roll, pitch, 0.0
    roll = math.atan2(float(pose[2, 1]), float(pose[2, 2]))
    yaw = math.atan2(float(pose[1, 0]), float(pose[0, 0]))
    return roll, pitch, yaw


def roll_pitch_between(
    axis: FloatArray, normal: FloatArray, *, or_nearest: bool = False
) -> list[tuple[float, float]]:
    """Return every (roll, pitch) whose pose, transposed, rotates `axis` to `normal`.

    With the pose Ry(pitch) Rx(roll), Rx(roll) normal = Ry(pitch)^T axis. Roll does not change the
    x component, which determines pitch; the other components determine roll.

    Both are unit vectors (3,), in parent and in child. The result has none, one or two pairs in
    radians, |pitch| at most 90°. With noise there may be no solution; `or_nearest` then gives the
    nearest one.
    """
    reach = float(normal[0]) / max(math.hypot(axis[0], axis[2]), 1e-9)
    if abs(reach) > 1.0 + 1e-9 and not or_nearest:
        return []
    phase = math.atan2(axis[2], axis[0])
    opening = math.acos(min(1.0, max(-1.0, reach)))
    found = []
    for pitch in (opening - phase, -opening - phase):
        pitch = math.remainder(pitch, math.tau)
        if abs(pitch) > 0.5 * math.pi + 1e-9:
            continue
        level = rotation_from_rpy(0.0, pitch).T @ axis
        roll = math.atan2(level[2], level[1]) - math.atan2(normal[2], normal[1])
        found.append((math.remainder(roll, math.tau), pitch))
    return found if opening > 1e-6 else found[:1]


def rotation_from_quaternion(x: float, y: float, z: float, w: float) -> FloatArray | None:
    """Return the rotation of a quaternion of any length, shape (3, 3); None if it is zero."""
    size = math.sqrt(x * x + y * y + z * z + w * w)
    if not 1e-6 < size < math.inf:
        return None
    axis = np.array([x, y, z]) / size
    k = skew(axis)
    return np.asarray(np.eye(3) + 2.0 * (w / size) * k + 2.0 * (k @ k))


def minimal_rotation(start: FloatArray, end: FloatArray) -> FloatArray:
    """Return the smallest rotation from the unit vector `start` to `end`, shape (3, 3).

    For opposite vectors, any axis across them is used.
    """
    middle = start + end
    if np.linalg.norm(middle) < 1e-8:
        middle = np.cross(start, np.eye(3)[int(np.argmin(np.abs(start)))])
    # Two half turns; dividing by one plus the cosine would be inaccurate near opposite vectors.
    middle = middle / np.linalg.norm(middle)
    first, second = (2.0 * np.outer(axis, axis) - np.eye(3) for axis in (start, middle))
    return np.asarray(second @ first)


def rotation_angle(rotation: FloatArray) -> float:
    """Return the angle of a rotation in radians, 0 to pi."""
    sine = 0.5 * math.hypot(
        float(rotation[2, 1] - rotation[1, 2]),
        float(rotation[0, 2] - rotation[2, 0]),
        float(rotation[1, 0] - rotation[0, 1]),
    )
    return math.atan2(sine, 0.5 * (float(np.trace(rotation)) - 1.0))


DIRECTIONS = (("forward", "backward"), ("left", "right"), ("up", "down"))
"""Directions of the body's axes, positive and negative (REP-103)."""


@cache
def signed_permutations() -> FloatArray:
    """Return all matrices that only swap axes and change signs, shape (48, 3, 3).

    Rows are the sensor's axes in the body's. The rotations come first, in order of angle; then the
    mirrored matrices, first those that differ by one sign.
    """
    found = [
        np.diag(signs) @ np.eye(3)[list(order)]
        for order in itertools.permutations(range(3))
        for signs in itertools.product((1.0, -1.0), repeat=3)
    ]
    return frozen_array(sorted(found, key=_sort_key), (48, 3, 3), "axes")


def rank_of(axes: FloatArray) -> int:
    """Return the index of axes (3, 3) in `signed_permutations`."""
    return int(np.flatnonzero((signed_permutations() == axes).all(axis=(1, 2)))[0])


def is_mirrored(axes: FloatArray) -> bool:
    """Return whether axes (3, 3) are left-handed."""
    return bool(np.linalg.det(axes) < 0.0)


def axes_in_words(
    axes: FloatArray, directions: Sequence[tuple[str, str]] = DIRECTIONS, verb: str = " "
) -> str:
    """Return the directions of the axes (3, 3) in words, as "x forward, y left, z up"."""
    along = np.argmax(np.abs(axes), axis=1)
    negative = (axes.sum(axis=1) < 0.0).astype(int)
    names = (directions[k][sign] for k, sign in zip(along, negative, strict=True))
    return ", ".join(f"{name}{verb}{to}" for name, to in zip("xyz", names, strict=True))


def swapped(axes: FloatArray) -> str:
    """Return which two axes (3, 3) are swapped, in words; empty for any other fault."""
    pairs = [(i, j) for i, j in itertools.combinations(range(3), 2) if axes[i, j] and axes[j, i]]
    if not pairs or np.any(axes < 0.0):
        return ""
    i, j = pairs[0]
    return f"{'xyz'[i]} and {'xyz'[j]} are swapped"


def likely_slip(axes: FloatArray) -> str:
    """Return the most likely fault of a driver whose axes (3, 3) are mirrored, in words."""
    if exchanged := swapped(axes):
        return f"{exchanged} in the driver"
    turned = [np.diag(np.where(np.arange(3) == axis, -1.0, 1.0)) @ axes for axis in range(3)]
    likely = "xyz"[min(range(3), key=lambda axis: _sort_key(turned[axis]))]
    return f"one axis has the wrong sign in the driver, most likely {likely}"


def _sort_key(axes: FloatArray) -> tuple[int, float, int, int]:
    """Return the sort key of axes: rotations first, by angle, about x before about y."""
    mirrored = is_mirrored(axes)
    angle = rotation_angle(-axes if mirrored else axes)
    upside_down = int(axes[2, 2] == -1.0 and axes[0, 0] == 1.0)
    flips = int((np.diag(axes) != 1.0).sum())
    kept = flips if mirrored else 0
    return int(mirrored), kept if mirrored else round(angle, 6), -upside_down, int(axes[0, 0] < 1.0)
