"""What the gyro reads while nothing else sees the robot turn."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from magcal_ros.core.geometry.arrays import FloatArray, runs
from magcal_ros.core.samples.window import SensorLog


@dataclass(frozen=True)
class QuietTuning:
    """When a robot is called at rest."""

    block: float = 0.5
    """Seconds that are averaged."""
    blocks: int = 3
    """So many in a row."""
    rate: float = math.radians(0.6)
    """rad/s by which the gyro's means may differ from one to the next."""
    lean: float = 0.015
    """Share of gravity by which its means may differ."""
    field: float = 0.008
    """Share of its size by which the field's may, on top of their noise."""
    wanders: float = 0.1
    """Share of what a turn would move the field by that it may wander by at rest."""


TUNING = QuietTuning()


@dataclass(frozen=True, eq=False)
class Rest:
    """The longest rest."""

    rate: FloatArray
    """What the gyro read, rad/s. Shape (3,)."""
    is_certain: bool
    """Whether a turn at that rate would have moved the field, which did not move."""


def longest_rest(log: SensorLog) -> Rest | None:
    """Return the longest rest; None if there was none.

    Parameters
    ----------
    log : SensorLog
        Finite numbers, increasing stamps, rates in rad/s.
    """
    begin = max(float(log.imu_time[0]), float(log.field_time[0]))
    end = min(float(log.imu_time[-1]), float(log.field_time[-1]))
    count = int((end - begin) / TUNING.block)
    if count < TUNING.blocks:
        return None
    edges: FloatArray = begin + TUNING.block * np.arange(count + 1, dtype=np.float64)
    rate, force = (block_means(log.imu_time, values, edges) for values in (log.rate, log.force))
    field = block_means(log.field_time, log.field, edges)
    per_block = max(len(log.field) * TUNING.block / max(end - begin, 1e-9), 1.0)
    noise = np.median(np.abs(np.diff(log.field, axis=0))) / 0.95 / math.sqrt(per_block)
    size = float(np.median(np.linalg.norm(log.field, axis=1)))
    gravity = float(np.median(np.linalg.norm(log.force, axis=1)))
    stays = (
        (_step(rate) < TUNING.rate)
        & (_step(force) < TUNING.lean * gravity)
        & (_step(field) < TUNING.field * size + 4.0 * float(noise))
    )
    found = [run for run in runs(stays) if run[1] - run[0] >= TUNING.blocks - 1]
    if not found:
        return None
    first, last = max(found, key=lambda run: run[1] - run[0])
    # A slow turn passes from block to block; over the whole of a rest it shows.
    moved = float(np.linalg.norm(field[last] - field[first]))
    turned = float(np.linalg.norm(rate[first : last + 1].sum(axis=0))) * TUNING.block
    limit = TUNING.field * size + 4.0 * float(noise)
    would = 0.3 * size * min(turned, 1.0)
    if moved > limit + would:
        return None
    still = max(limit, TUNING.wanders * would)
    return Rest(rate[first : last + 1].mean(axis=0), moved < still and would > 3.0 * limit)


def block_means(time: FloatArray, values: FloatArray, edges: FloatArray) -> FloatArray:
    """Return means (k, 3) between edges (k + 1,); not a number where nothing lies between."""
    total = np.concatenate([np.zeros((1, values.shape[1])), np.cumsum(values, axis=0)])
    rows = np.searchsorted(time, edges)
    number = np.diff(rows)
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray(np.diff(total[rows], axis=0) / number[:, None])


def _step(values: FloatArray) -> FloatArray:
    """Return how far neighbours (k, 3) are apart, shape (k - 1,); infinite where one is."""
    apart = np.linalg.norm(np.diff(values, axis=0), axis=1)
    return np.asarray(np.where(np.isfinite(apart), apart, np.inf))
