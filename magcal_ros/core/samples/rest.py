"""What the sensors measure while their robot does not turn.

A robot rests, or rolls straight on, where neither its field nor its turn rate moves. The field is
needed: a robot that turns evenly has a steady rate, too.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from magcal_ros.core.geometry.arrays import (
    BoolArray,
    FloatArray,
    IntArray,
    block_means,
    frozen_array,
    runs,
)
from magcal_ros.core.geometry.vec3 import Triple, length

CHANGES_BY = 0.03
"""Share of itself that a bias changes by from rest to rest: 3.38 and 3.55 °/s within 40 s, of a car
whose gyro had 4.5 °/s."""


class GyroAtRest(NamedTuple):
    """A gyro's bias as a rest has shown it."""

    rate: Triple  # rad/s, body axes
    sigma: float  # of it, per axis, rad/s, while the robot stood

    @property
    def later_sigma(self) -> float:
        """Sigma of the bias that is left when this is taken off later on, rad/s per axis."""
        return math.hypot(self.sigma, CHANGES_BY * length(self.rate))


class LongestRest(NamedTuple):
    """The longest rest."""

    rate: FloatArray
    """What the gyro read, rad/s. Shape (3,)."""
    is_certain: bool  # whether a turn at that rate would have moved the field, which did not move


@dataclass(frozen=True)
class BiasAtRestTuning:
    """When a robot is taken to have rested."""

    block: float = 0.5  # seconds of samples that are averaged before anything is compared
    at_least: int = 4  # blocks in a row that make a rest
    clear: float = 4.0  # sigmas of a block's mean by which two blocks at rest may differ
    smallest_turn: float = 0.004
    """Share of the field's swing that noise of another kind may move it by during a rest."""
    shown: float = 3.0
    """Times what a rest may move by that a turn at the gyro's rate must have moved the field by."""
    most_moved: float = 0.4
    """Share of that turn's way by which the field may seem to move during a rest."""
    loose_rate: float = 0.01  # rad/s by which an engine or a person may rock a robot at rest
    next_to_nothing: float = 0.05
    """Share of a turn's own rate at which no robot turns steadily for seconds beforehand."""
    turned: float = 5.0
    """Times what a rest may move by that the field must move in all to tell a rest by itself."""


TUNING = BiasAtRestTuning()


@dataclass(frozen=True, eq=False)
class RestBeside:
    """What the sensors measured while a robot stood right before or after its turn."""

    seconds: float  # how long
    field: FloatArray  # mean raw field, tesla, shape (3,)
    field_sigma: float  # of that mean, per axis
    force: FloatArray
    """Mean specific force in body axes, m/s². Shape (3,)."""
    rate: FloatArray
    """What the gyro read, rad/s: its bias; zero without a gyro. Shape (3,)."""
    rate_sigma: float  # of that mean, per axis; infinite without a gyro
    beside: float  # stamp of the turn's sample that is nearest, seconds
    turned: FloatArray
    """Rotation from the body axes of that sample to those at rest, by the gyro. Shape (3,
    3)."""

    def __post_init__(self) -> None:
        for name, shape in (("field", (3,)), ("force", (3,)), ("rate", (3,)), ("turned", (3, 3))):
            object.__setattr__(self, name, frozen_array(getattr(self, name), shape, name))


def rests_around(
    time: FloatArray, field: FloatArray, rate: FloatArray | None
) -> tuple[slice | None, slice | None]:
    """Return the rows at which a robot stands before its turn, and after it; None for no rest.

    It stood if the field did, and turned later, far faster than the gyro then read, if there is
    one.

    `time` (n,) is in seconds, `field` (n, 3) raw and in any unit, `rate` (n, 3) in rad/s; None
    without a gyro.
    """
    blocks = _split(time)
    if len(blocks[0]) <= 2 * TUNING.at_least:
        return None, None
    found: list[slice | None] = [None, None]
    ends = [*blocks[0], len(time)]
    for start, end in _stands(field, rate, blocks):
        # The block in which the robot sets off, or comes to stand, counts on neither side.
        if start == 0 and end < len(blocks[0]):
            found[0] = slice(0, ends[end - 1])
        elif start > 0 and end == len(blocks[0]):
            found[1] = slice(ends[start + 1], len(time))
    return found[0], found[1]


def _stands(
    field: FloatArray, rate: FloatArray | None, blocks: tuple[IntArray, IntArray]
) -> list[tuple[int, int]]:
    """Return first block and end of every stretch in which the robot stood."""
    swing = float(np.ptp(field, axis=0).max())
    if rate is None:
        alone = _Blocks.of(field, *blocks, TUNING.smallest_turn * swing)
        if not alone.moves_by(TUNING.turned):
            return []
        return [run for run in _runs(alone.stays) if alone.is_one(slice(*run))]
    fields, rates = _still(field, rate, blocks)
    fastest = np.sort(np.linalg.norm(rates.mean, axis=1))[-TUNING.at_least]
    found = []
    for start, end in _runs(fields.stays & rates.stays):
        inside = rates.mean[start:end]
        creeps = float(np.linalg.norm(inside.mean(axis=0))) > TUNING.next_to_nothing * fastest
        if not creeps or all(_stood(fields, rates, slice(start, end), 0.5 * swing)):
            found.append((start, end))
    return found


def mean_and_sigma(time: FloatArray, values: FloatArray) -> tuple[FloatArray, float]:
    """Return the mean of values (n, 3) at rest and its sigma per axis, slow noise included."""
    first, _ = _split(time)
    means = block_means(values, first)
    between = float(np.mean(means.var(axis=0, ddof=1))) / len(means) if len(means) > 1 else 0.0
    within = float(np.mean(values.var(axis=0))) / len(values)
    return values.mean(axis=0), math.sqrt(max(between, within))


def bias_at_rest(time: FloatArray, field: FloatArray, rate: FloatArray) -> FloatArray | None:
    """Return the mean turn rate while the robot did not turn, rad/s.

    None if it never rested, or if a turn at that rate would not have shown in the field.

    `time` (n,) is in seconds, `field` (n, 3) raw and in any unit, `rate` (n, 3) in rad/s.
    """
    blocks = _split(time)
    if len(blocks[0]) <= TUNING.at_least:
        return None
    swing = float(np.ptp(field, axis=0).max())
    fields, rates = _still(field, rate, blocks)
    rests = [
        rates.mean[start:end]
        for start, end in _runs(fields.stays & rates.stays)
        if all(_stood(fields, rates, slice(start, end), 0.5 * swing))
    ]
    return np.median(np.concatenate(rests), axis=0) if rests else None


def longest_stand(time: FloatArray, field: FloatArray, rate: FloatArray) -> LongestRest | None:
    """Return the longest rest; None if there was none. Takes the same as `bias_at_rest`."""
    if not len(time) or time[-1] - time[0] < TUNING.block * (TUNING.at_least + 1):
        return None
    fields, rates = _still(field, rate, _split(time))
    found = _runs(fields.stays & rates.stays)
    if not found:
        return None
    longest = slice(*max(found, key=lambda run: run[1] - run[0]))
    # A robot that stands all the time has not swung its field; its level part is about so large.
    radius = 0.3 * float(np.median(np.linalg.norm(field, axis=1)))
    stood, shows = _stood(fields, rates, longest, radius)
    # A slow turn passes from block to block.
    return None if shows and not stood else LongestRest(rates.mean[longest].mean(axis=0), shows)


def _split(time: FloatArray) -> tuple[IntArray, IntArray]:
    """Return the first row of each block, and how many rows it has."""
    block = ((time - time[0]) / TUNING.block).astype(int)
    _, first, count = np.unique(block, return_index=True, return_counts=True)
    return first, count


def _still(
    field: FloatArray, rate: FloatArray, blocks: tuple[IntArray, IntArray]
) -> tuple[_Blocks, _Blocks]:
    """Return the blocks of field and rate, and where each stays with the next."""
    swing = float(np.ptp(field, axis=0).max())
    return _Blocks.of(field, *blocks, TUNING.smallest_turn * swing), _Blocks.of(
        rate, *blocks, TUNING.loose_rate
    )


@dataclass(frozen=True, eq=False)
class _Blocks:
    """Means over blocks (b, 3), by how much two of rest may differ (b, 3), and which stay (b,)."""

    mean: FloatArray
    limit: FloatArray
    stays: BoolArray

    @classmethod
    def of(cls, values: FloatArray, first: IntArray, count: IntArray, allowed: float) -> _Blocks:
        """Average, and compare each block with those after it, `TUNING.at_least` with itself."""
        mean = block_means(values, first)
        noise = np.median(np.abs(np.diff(values, axis=0)), axis=0) / 0.954
        limit = allowed + TUNING.clear * noise * np.sqrt(2.0 / np.maximum(count, 1))[:, None]
        stays = np.zeros(len(mean), dtype=bool)
        stays[: 1 - TUNING.at_least] = True
        for k in range(1, TUNING.at_least):
            apart = np.abs(mean[k:] - mean[:-k]) > limit[k:]
            stays[: len(apart)] &= ~apart.any(axis=1)
        return cls(mean, limit, stays)

    def moves_by(self, times: float) -> bool:
        """Return whether all of them together move by so many times what a rest may move by."""
        return bool((np.ptp(self.mean, axis=0) > times * np.median(self.limit, axis=0)).any())

    def is_one(self, rows: slice) -> bool:
        """Return whether nothing moved over all of these; a robot that creeps does."""
        return bool((np.ptp(self.mean[rows], axis=0) <= self.limit[rows].max(axis=0)).all())


def _runs(stays: BoolArray) -> list[tuple[int, int]]:
    """Return first block and end of every stretch in which each block stays with the next ones."""
    return [(first, end + TUNING.at_least - 1) for first, end in runs(stays)]


def _stood(fields: _Blocks, rates: _Blocks, rows: slice, radius: float) -> tuple[bool, bool]:
    """Return whether the field moved far less than a turn at the gyro's rate would have moved it.

    A slow turn passes from block to block; over the whole of a stretch it shows. And whether such a
    turn would have moved the field, of this radius, out of what a rest may move by.
    """
    inside, field = rates.mean[rows], fields.mean[rows]
    turned = float(np.linalg.norm(inside.mean(axis=0))) * TUNING.block * (len(inside) - 1)
    chord = 2.0 * radius * math.sin(0.5 * min(turned, math.pi))
    moved = float(np.linalg.norm(field - field[0], axis=1).max())
    return moved < TUNING.most_moved * chord, chord > TUNING.shown * float(fields.limit[rows].max())
