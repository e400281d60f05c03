"""A movement as few averaged samples, with the gyro's turns between them."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import numpy as np

from magcal_ros.core.geometry.arrays import FloatArray, IntArray
from magcal_ros.core.samples.window import Window


@dataclass(frozen=True)
class StretchTuning:
    """How far samples are averaged."""

    largest: int = 120
    """Neighbouring samples are averaged until no more than this number remain."""
    most: int = 240
    """Where the turn is too fast to average so many, the liveliest part of this length is used."""
    widest_block: float = math.radians(5.0)
    """Radians of turn over which samples are averaged."""


TUNING = StretchTuning()


@dataclass(frozen=True, eq=False)
class Stretch:
    """Averaged samples with the turns between them."""

    field: FloatArray
    """Over `size`. Shape (n, 3)."""
    up: FloatArray
    """Specific force over its own usual size. Shape (n, 3)."""
    turn: FloatArray
    """The gyro's rate integrated from each sample to the next, radians. Shape (n - 1, 3)."""
    coning: FloatArray
    """What must be added for rotation vectors, because turns do not commute: second order. Shape (n
    - 1, 3)."""
    seconds: FloatArray
    """Shape (n - 1,)."""
    rate: FloatArray
    """The gyro's mean rate, rad/s. Shape (n, 3)."""
    size: float
    """Of the field's changing part, tesla."""


def field_size(field: FloatArray) -> float:
    """Return how large the changing part of a field (n, 3) is, in its unit; never zero."""
    span = np.ptp(np.quantile(field, (0.02, 0.98), axis=0), axis=0)
    return max(float(np.linalg.norm(span)) / 2.0, 1e-12)


def stretch_of(window: Window, tuning: StretchTuning = TUNING) -> Stretch:
    """Average neighbours and propagate the gyro between them; `window` has a gyro."""
    rate = window.angular_rate
    assert rate is not None
    vectors = 0.5 * (rate[1:] + rate[:-1]) * np.diff(window.time)[:, None]
    usual = float(np.mean(np.linalg.norm(vectors, axis=1))) + 1e-9
    wanted = min(-(-len(window) // tuning.largest), max(1, int(tuning.widest_block / usual)))
    block = max(1, wanted - (wanted + 1) % 2)
    if len(window) > block * tuning.most:
        return stretch_of(window.take(_liveliest(vectors, block * tuning.most)), tuning)
    count = len(window) // block
    middle = np.arange(count) * block + block // 2
    field, force, mean = (
        values[: block * count].reshape(count, block, 3).mean(axis=1)
        for values in (window.field, window.specific_force, rate)
    )
    size = field_size(field)
    gravity = float(np.median(np.linalg.norm(force, axis=1)))
    between = [vectors[i:j] for i, j in itertools.pairwise(middle)]
    return Stretch(
        field / size,
        force / max(gravity, 1e-12),
        np.array([part.sum(axis=0) for part in between]),
        np.array([_coning(part) for part in between]),
        np.diff(window.time[middle]),
        mean,
        size,
    )


def _liveliest(vectors: FloatArray, length: int) -> IntArray:
    """Return the rows of the part of this length that turns most."""
    turned = np.concatenate([[0.0], np.cumsum(np.linalg.norm(vectors, axis=1))])
    first = int(np.argmax(turned[length - 1 :] - turned[: len(turned) - length + 1]))
    return np.arange(first, first + length)


def _coning(vectors: FloatArray) -> FloatArray:
    """Return what rotation vectors (n, 3) one after another are more than their sum."""
    before = np.cumsum(vectors, axis=0) - vectors
    return np.asarray(0.5 * np.cross(before, vectors).sum(axis=0))
