"""The array types of the core, checks of numbers from outside, and integrals."""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
import numpy.typing as npt

from magcal_ros.core.errors import Reason, Refusal

FloatArray: TypeAlias = npt.NDArray[np.float64]
BoolArray: TypeAlias = npt.NDArray[np.bool_]
IntArray: TypeAlias = npt.NDArray[np.int64]
ComplexArray: TypeAlias = npt.NDArray[np.complex128]


def frozen_array(values: npt.ArrayLike, shape: tuple[int, ...], name: str) -> FloatArray:
    """Copy `values` into a read-only float array of a given shape.

    In `shape`, -1 stands for any length; `name` is used in error messages. Raises `ValueError` if
    the shape differs, or if a number is not finite or masked.
    """
    if np.ma.is_masked(values):
        raise ValueError(f"{name} holds a masked value: leave its row out")
    array = np.array(values, dtype=np.float64, order="C")
    fits = array.ndim == len(shape) and all(
        wanted in (-1, actual) for wanted, actual in zip(shape, array.shape, strict=True)
    )
    if not fits:
        raise ValueError(f"{name} must have the shape {shape}, not {array.shape}")
    if not np.isfinite(array).all():
        raise ValueError(f"{name} holds a value that is not finite")
    array.setflags(write=False)
    return array


def freeze(owner: object, **shapes: tuple[int, ...]) -> None:
    """Make fields of a frozen dataclass read-only arrays of given shapes, by `frozen_array`.

    A field that is None stays None.
    """
    for name, shape in shapes.items():
        values = getattr(owner, name)
        if values is not None:
            object.__setattr__(owner, name, frozen_array(values, shape, name.replace("_", " ")))


def centred(points: FloatArray, least: int, shape: str) -> tuple[FloatArray, FloatArray]:
    """Return the centroid (d,) of points (n, d), and the points about it.

    Raises `Refusal` if a point is not finite, or if there are fewer than the `least` for a `shape`.
    """
    if not np.isfinite(points).all():
        raise Refusal(Reason.NOT_FINITE, "Some samples are not numbers. Drop them before fitting.")
    if len(points) < least:
        words = f"A {shape} needs {least} points, not {len(points)}. Collect more samples."
        raise Refusal(Reason.TOO_FEW_SAMPLES, words)
    centroid = points.mean(axis=0)
    return centroid, points - centroid


def interpolated(moments: FloatArray, time: FloatArray, rows: FloatArray) -> FloatArray:
    """Return rows (n, d) of `time`, linearly interpolated at the moments (m,), shape (m, d)."""
    return np.column_stack([np.interp(moments, time, column) for column in rows.T])


def accumulated(steps: FloatArray) -> FloatArray:
    """Return the cumulative sums of steps (n, ...), beginning with zero, shape (n + 1, ...)."""
    return np.concatenate([np.zeros((1, *steps.shape[1:])), np.cumsum(steps, axis=0)])


def trapezoids(time: FloatArray, values: FloatArray) -> FloatArray:
    """Return the integrals of values (n, ...) from each moment to the next, shape (n - 1, ...)."""
    seconds = np.diff(time).reshape(-1, *[1] * (values.ndim - 1))
    return np.asarray(0.5 * (values[1:] + values[:-1]) * seconds)


def integral(time: FloatArray, values: FloatArray) -> FloatArray:
    """Return the integral of values (n, ...) up to each moment, by the trapezoid rule."""
    return accumulated(trapezoids(time, values))


def runs(flags: BoolArray) -> list[tuple[int, int]]:
    """Return first row and end of every run of true flags (n,)."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], flags, [False]]).astype(int)))
    return [(int(a), int(b)) for a, b in edges.reshape(-1, 2)]


def block_means(values: FloatArray, first: IntArray) -> FloatArray:
    """Return the means of blocks of rows (n, ...); `first` holds the first row of each block."""
    count = np.diff(np.append(first, len(values)))
    sums = np.add.reduceat(values, first, axis=0)
    return np.asarray(sums / count.reshape(-1, *[1] * (values.ndim - 1)))


def running_mean(values: FloatArray, width: int) -> FloatArray:
    """Return the mean of the `width` values around each, fewer at the ends, shape (n,)."""
    window = np.ones(min(width, len(values)))
    count = np.convolve(np.ones(len(values)), window, "same")
    return np.asarray(np.convolve(values, window, "same") / count)
