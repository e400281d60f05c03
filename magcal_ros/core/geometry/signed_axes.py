"""The 48 ways in which the axes of one sensor can lie along those of another."""

from __future__ import annotations

import itertools
from functools import cache

import numpy as np

from magcal_ros.core.geometry.arrays import FloatArray, frozen_array
from magcal_ros.core.geometry.rotations import rotation_angle

DIRECTIONS = (("forward", "backward"), ("left", "right"), ("up", "down"))
"""Of the body's axes, positive and negative (REP-103)."""


@cache
def signed_permutations() -> FloatArray:
    """Return all matrices that only swap axes and turn their signs, shape (48, 3, 3).

    Rows are the sensor's axes in the body's. Those that a mounting can make come first, from the
    one that changes least; then the mirrored ones, from those that differ by one sign.
    """
    found = [
        np.diag(signs) @ np.eye(3)[list(order)]
        for order in itertools.permutations(range(3))
        for signs in itertools.product((1.0, -1.0), repeat=3)
    ]
    return frozen_array(sorted(found, key=_strangeness), (48, 3, 3), "axes")


def rank_of(axes: FloatArray) -> int:
    """Return the place of axes (3, 3) among the signed permutations."""
    return int(np.flatnonzero((signed_permutations() == axes).all(axis=(1, 2)))[0])


def is_mirrored(axes: FloatArray) -> bool:
    """Return whether no rotation makes these axes (3, 3) of the body's."""
    return bool(np.linalg.det(axes) < 0.0)


def spoken(axes: FloatArray) -> str:
    """Return where the axes (3, 3) point, as "x forward, y left, z up"."""
    words = []
    for name, row in zip("xyz", axes, strict=True):
        along = int(np.argmax(np.abs(row)))
        words.append(f"{name} {DIRECTIONS[along][int(row[along] < 0.0)]}")
    return ", ".join(words)


def swapped(axes: FloatArray) -> str:
    """Say which of the axes (3, 3) are swapped and else right; empty where that is not all."""
    pairs = [(i, j) for i, j in itertools.combinations(range(3), 2) if axes[i, j] and axes[j, i]]
    if not pairs or np.any(axes < 0.0):
        return ""
    i, j = pairs[0]
    return f"{'xyz'[i]} and {'xyz'[j]} are swapped"


def likely_slip(axes: FloatArray) -> str:
    """Return what a driver most likely did to make axes (3, 3) that are mirrored."""
    if exchanged := swapped(axes):
        return f"{exchanged} in the driver"
    turned = [np.diag(np.where(np.arange(3) == axis, -1.0, 1.0)) @ axes for axis in range(3)]
    likely = "xyz"[min(range(3), key=lambda axis: _strangeness(turned[axis]))]
    return f"one axis has the wrong sign in the driver, most likely {likely}"


def _strangeness(axes: FloatArray) -> tuple[int, float, int, int]:
    """Order by what people do: mountings, then few degrees, then upside down about x first."""
    mirrored = is_mirrored(axes)
    angle = rotation_angle(-axes if mirrored else axes)
    upside_down = int(axes[2, 2] == -1.0 and axes[0, 0] == 1.0)
    flips = int((np.diag(axes) != 1.0).sum())
    kept = flips if mirrored else 0
    return int(mirrored), kept if mirrored else round(angle, 6), -upside_down, int(axes[0, 0] < 1.0)
