"""What a gyro reads while its robot does not turn.

A robot rests, or rolls straight on, where neither its field nor its turn rate moves. The field is
needed: a robot that turns evenly has a steady rate, too.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from magcal_ros.core.geometry.arrays import BoolArray, FloatArray, IntArray


@dataclass(frozen=True)
class BiasAtRestTuning:
    """When a robot is taken to have rested.

    Parameters
    ----------
    block : float
        Seconds of samples that are averaged before anything is compared.
    at_least : int
        Blocks in a row that make a rest.
    clear : float
        Sigmas of a block's mean by which two blocks at rest may differ.
    smallest_turn : float
        Share of the field's swing that noise of another kind may move it by during a rest.
    shown : float
        Times what a rest may move by that a turn at the gyro's rate must have moved the
        field by.
    most_moved : float
        Share of that turn's way by which the field may seem to move during a rest.
    loose_rate : float
        rad/s by which an engine or a person may rock a robot at rest.
    """

    block: float = 0.5
    at_least: int = 4
    clear: float = 4.0
    smallest_turn: float = 0.004
    shown: float = 3.0
    most_moved: float = 0.4
    loose_rate: float = 0.01


TUNING = BiasAtRestTuning()


def bias_at_rest(time: FloatArray, field: FloatArray, rate: FloatArray) -> FloatArray | None:
    """Return the mean turn rate while the robot did not turn, rad/s.

    None if it never rested, or if the field could not have told a turn at that rate from a rest.

    Parameters
    ----------
    time : ndarray, shape (n,)
        Seconds, increasing.
    field, rate : ndarray, shape (n, 3)
        Raw field in any unit, and rad/s.
    """
    block = ((time - time[0]) / TUNING.block).astype(int)
    _, first, count = np.unique(block, return_index=True, return_counts=True)
    if len(first) <= TUNING.at_least:
        return None
    swing = float(np.ptp(field, axis=0).max())
    fields = _Blocks.of(field, first, count, TUNING.smallest_turn * swing)
    rates = _Blocks.of(rate, first, count, TUNING.loose_rate)
    rests = [
        rates.mean[start:end]
        for start, end in _runs(fields.stays & rates.stays)
        if _stood(rates.mean[start:end], fields.mean[start:end], 0.5 * swing)
        and _would_show(rates.mean[start:end], 0.5 * swing, float(fields.limit[start:end].max()))
    ]
    return np.median(np.concatenate(rests), axis=0) if rests else None


@dataclass(frozen=True, eq=False)
class _Blocks:
    """Means over blocks (b, 3), by how much two of rest may differ (b, 3), and which stay (b,)."""

    mean: FloatArray
    limit: FloatArray
    stays: BoolArray

    @classmethod
    def of(cls, values: FloatArray, first: IntArray, count: IntArray, allowed: float) -> _Blocks:
        """Average, and compare each block with those after it, `TUNING.at_least` with itself."""
        mean = np.add.reduceat(values, first, axis=0) / count[:, None]
        noise = np.median(np.abs(np.diff(values, axis=0)), axis=0) / 0.954
        limit = allowed + TUNING.clear * noise * np.sqrt(2.0 / np.maximum(count, 1))[:, None]
        stays = np.zeros(len(mean), dtype=bool)
        stays[: 1 - TUNING.at_least] = True
        for k in range(1, TUNING.at_least):
            apart = np.abs(mean[k:] - mean[:-k]) > limit[k:]
            stays[: len(apart)] &= ~apart.any(axis=1)
        return cls(mean, limit, stays)


def _runs(stays: BoolArray) -> list[tuple[int, int]]:
    """Return first block and end of every stretch in which each block stays with the next ones."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], stays, [False]]).astype(int)))
    return [(int(a), int(b) + TUNING.at_least - 1) for a, b in edges.reshape(-1, 2)]


def _chord(rates: FloatArray, radius: float) -> float:
    """Return how far a turn at the mean rate would have moved the field, in its unit."""
    turned = float(np.linalg.norm(rates.mean(axis=0))) * TUNING.block * (len(rates) - 1)
    return 2.0 * radius * math.sin(0.5 * min(turned, math.pi))


def _stood(rates: FloatArray, fields: FloatArray, radius: float) -> bool:
    """Return whether the field moved far less than a turn at the gyro's rate would have it.

    A slow turn passes from block to block; over the whole of a stretch it shows.
    """
    moved = float(np.linalg.norm(fields - fields[0], axis=1).max())
    return moved < TUNING.most_moved * _chord(rates, radius)


def _would_show(rates: FloatArray, radius: float, limit: float) -> bool:
    """Return whether a turn at the rate of a rest would have moved the field out of its limits."""
    return _chord(rates, radius) > TUNING.shown * limit
