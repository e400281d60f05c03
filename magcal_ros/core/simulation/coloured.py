"""Noise that is alike over a while."""

from __future__ import annotations

import math

import numpy as np

from magcal_ros.core.geometry.arrays import FloatArray

SMALLEST = 1e-4
"""Where the tail of an exponential is cut off."""


def exponential_noise(
    rng: np.random.Generator, count: int, period: float, lasts: float
) -> FloatArray:
    """Return two columns of unit noise whose correlation falls by e over `lasts`, (count, 2)."""
    keeps = math.exp(-period / lasts)
    return _filtered(rng, count, _tail(keeps))


def smooth_noise(rng: np.random.Generator, count: int, period: float, lasts: float) -> FloatArray:
    """Return the same with a derivative: low-passed twice, shape (count, 2)."""
    tail = _tail(math.exp(-period / lasts))
    return _filtered(rng, count, np.convolve(tail, tail))


def running_mean(values: FloatArray, width: int) -> FloatArray:
    """Return the mean over so many neighbours, the ends held, shape (n,)."""
    left = (width - 1) // 2
    padded = np.pad(values, (left, width - 1 - left), mode="edge")
    return np.asarray(np.convolve(padded, np.full(width, 1.0 / width), mode="valid"))


def _tail(keeps: float) -> FloatArray:
    return np.asarray(keeps ** np.arange(math.ceil(math.log(SMALLEST) / math.log(keeps)) + 1))


def _filtered(rng: np.random.Generator, count: int, kernel: FloatArray) -> FloatArray:
    kernel = kernel / np.linalg.norm(kernel)
    noise = rng.standard_normal((2, count + len(kernel) - 1))
    return np.column_stack([np.convolve(row, kernel, mode="valid") for row in noise])
