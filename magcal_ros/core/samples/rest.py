"""The rests of a robot before and after a turn, and the turn without them.

A robot rests, or drives straight, where neither its field nor its turn rate changes. The field is
needed, because the rate is constant in a steady turn, too. Rests are not samples of the turn; they
show the gyro's bias, and the field while the motors are off.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from magcal_ros.core.geometry.arrays import (
    BoolArray,
    FloatArray,
    IntArray,
    block_means,
    freeze,
    runs,
)
from magcal_ros.core.geometry.attitude import usual_size
from magcal_ros.core.geometry.rotations import exp_rotation
from magcal_ros.core.geometry.vec3 import Triple, length
from magcal_ros.core.samples.samples_tuning import BIAS_AT_REST
from magcal_ros.core.samples.spikes import spikes_replaced

FIELD, FORCE, RATE = slice(1, 4), slice(4, 7), slice(7, 10)
ANGLE, INTERVALS, SPAN, SPEED, COLUMNS = slice(10, 13), 16, slice(10, 17), 17, 18
"""Columns of samples in rows; the first column is the stamp. `SPAN` is the `ImuSpan` since the
previous row, NaN if unknown; `ANGLE` and `INTERVALS` are parts of it. `SPEED` is NaN if unknown."""
USUAL_LEVEL = 0.3  # usual level field over the raw field, with inclination and hard iron
BIAS_CHANGE = 0.03
"""Relative change of a bias from rest to rest: 3.38 and 3.55 °/s within 40 s in a car."""


class GyroAtRest(NamedTuple):
    """A gyro's bias, measured at a rest."""

    rate: Triple  # rad/s, body axes
    sigma: float  # of the bias during the rest, rad/s per axis

    @property
    def later_sigma(self) -> float:
        """Sigma of the remaining bias if this one is subtracted later, rad/s per axis."""
        return math.hypot(self.sigma, BIAS_CHANGE * length(self.rate))


class LongestRest(NamedTuple):
    """The longest rest."""

    rate: FloatArray  # mean rate of the gyro, rad/s. Shape (3,).
    sigma: float  # of the mean, per axis, rad/s
    is_certain: bool  # whether a turn at this rate would have changed the field, which was constant


@dataclass(frozen=True, eq=False)
class AttachedRest:
    """Measurements at a rest right before or after a turn."""

    seconds: float  # duration
    field: FloatArray  # mean raw field, tesla, shape (3,)
    force: FloatArray  # mean specific force in body axes, m/s². Shape (3,).
    rate: FloatArray  # mean rate, rad/s: the gyro's bias; zero without a gyro. Shape (3,).
    rate_sigma: float  # of the mean rate, per axis; infinite without a gyro
    beside: float  # stamp of the turn's nearest sample, seconds
    turned: FloatArray
    """Rotation from the nearest sample's body axes to those at rest, by the gyro. Shape (3, 3)."""

    def __post_init__(self) -> None:
        freeze(self, field=(3,), force=(3,), rate=(3,), turned=(3, 3))

    def in_axes(self, rotation: FloatArray) -> AttachedRest:
        """Return the rest in body axes that are rotated by `rotation` (3, 3)."""
        turned = rotation @ self.turned @ rotation.T
        force, rate = rotation @ self.force, rotation @ self.rate
        return replace(self, force=force, rate=rate, turned=turned)


def without_rests(
    rows: FloatArray, known: GyroAtRest | None = None
) -> tuple[FloatArray, tuple[AttachedRest, ...], float]:
    """Subtract the gyro's bias, and separate the rests before and after the turn.

    The rows (n, COLUMNS) hold samples; the rates are all finite, or none is. `known` is the bias at
    an earlier rest; a rest among the rows has priority. Returns the rows of the turn, the rests,
    and the sigma (rad/s) of the known bias if it was subtracted; else infinity.
    """
    steady = rows.copy()
    steady[:, FIELD] = spikes_replaced(rows[:, FIELD])
    time, field, rate = rows[:, 0], steady[:, FIELD], _mean_rates(rows)
    has_gyro = bool(np.isfinite(rate).all())
    first, end, bias = rests_around(time, field, rate if has_gyro else None)
    if end - first < BIAS_AT_REST.fewest:
        first, end = 0, len(rows)
    # In a long, thinned recording a rest may end long before the turn's first row, and is not used.
    before = steady[:first][time[:first] > time[first] - BIAS_AT_REST.longest]
    after = steady[end:][time[end:] < time[end - 1] + BIAS_AT_REST.longest]
    rests = [_rest(before, before[-1], rows[first], has_gyro)] if len(before) else []
    rests += [_rest(after, after[0], rows[end - 1], has_gyro)] if len(after) else []
    sigma = math.inf
    if bias is None and known is not None:
        bias, sigma = np.array(known.rate), known.later_sigma
    turn = rows[first:end].copy()
    if bias is not None:
        turn[:, RATE] -= bias
        turn[1:, ANGLE] -= bias * np.diff(turn[:, :1], axis=0)
    return turn, tuple(rests), sigma


def _mean_rates(rows: FloatArray) -> FloatArray:
    """Return mean rates since the previous row, where the IMU has samples between, shape (n, 3).

    Single rates of a shaking robot may look like those of a rest.
    """
    rate = rows[:, RATE].copy()
    seen = np.flatnonzero(rows[1:, INTERVALS] > 1.0) + 1
    rate[seen] = rows[seen, ANGLE] / (rows[seen, :1] - rows[seen - 1, :1])
    return rate


def _rest(rows: FloatArray, last: FloatArray, beside: FloatArray, has_gyro: bool) -> AttachedRest:
    """Return the rest from its rows; `last` is the row next to the turn's row `beside`."""
    time = rows[:, 0]
    rate, rate_sigma, step = np.zeros(3), math.inf, np.zeros(3)
    if has_gyro:
        rate, rate_sigma = _mean_and_sigma(time, _mean_rates(rows))
        # Rotation by the gyro over the step between them, which may go back in time.
        way, later = last[0] - beside[0], max(last, beside, key=lambda row: float(row[0]))
        gained = 0.5 * (last[RATE] + beside[RATE]) * way
        if np.isfinite(later[ANGLE]).all():
            gained = math.copysign(1.0, way) * later[ANGLE]
        step = gained - rate * way
    seconds, stamp, turned = float(time[-1] - time[0]), float(beside[0]), exp_rotation(-step)
    field, force = rows[:, FIELD].mean(axis=0), rows[:, FORCE].mean(axis=0)
    return AttachedRest(seconds, field, force, rate, rate_sigma, stamp, turned)


def rests_around(
    time: FloatArray, field: FloatArray, rate: FloatArray | None
) -> tuple[int, int, FloatArray | None]:
    """Return first row and end of the turn between the rests, and the gyro's bias, rad/s.

    The robot rests if the field is constant and the rate is far below that of the turn. The bias is
    the median rate at rests, of those that the field proves if there are any; None without a rest
    or a gyro.

    `time` (n,) is in seconds, `field` (n, 3) raw and in any unit, `rate` (n, 3) in rad/s; None
    without a gyro.
    """
    blocks = _split(time)
    starts, count = blocks[0], len(blocks[0])
    first, end = 0, len(time)
    if count <= BIAS_AT_REST.at_least:
        return first, end, None
    rests = _rests_by_field(field, blocks) if rate is None else _rests(field, rate, blocks)
    for rest in rests if count > 2 * BIAS_AT_REST.at_least else []:
        # The block in which the robot starts or stops belongs to neither.
        if rest.first == 0 and rest.end < count:
            first = int(starts[rest.end - 1])
        elif rest.first > 0 and rest.end == count:
            end = int(starts[rest.first + 1])
    shown = [each.rates for each in rests if each.rests] or [each.rates for each in rests]
    has_bias = rate is not None and bool(shown)
    return first, end, np.median(np.concatenate(shown), axis=0) if has_bias else None


def longest_rest(time: FloatArray, field: FloatArray, rate: FloatArray) -> LongestRest | None:
    """Return the longest rest; None if there was none. Parameters as for `rests_around`."""
    if not len(time) or time[-1] - time[0] < BIAS_AT_REST.block * (BIAS_AT_REST.at_least + 1):
        return None
    # At rest the field shows no circle: its radius is assumed.
    found = _steady(spikes_replaced(field), rate, _split(time), USUAL_LEVEL * usual_size(field))
    if not found:
        return None
    longest = max(found, key=lambda each: each.end - each.first)
    if longest.rests is False:
        return None
    rates = longest.rates
    sigma = math.sqrt(float(rates.var(axis=0, ddof=1).mean()) / len(rates))
    return LongestRest(rates.mean(axis=0), sigma, bool(longest.rests))


def _mean_and_sigma(time: FloatArray, values: FloatArray) -> tuple[FloatArray, float]:
    """Return the mean of values (n, 3) at rest and its sigma per axis, slow noise included."""
    first, _ = _split(time)
    means = block_means(values, first)
    between = float(np.mean(means.var(axis=0, ddof=1))) / len(means) if len(means) > 1 else 0.0
    within = float(np.mean(values.var(axis=0))) / len(values)
    return values.mean(axis=0), math.sqrt(max(between, within))


def _split(time: FloatArray) -> tuple[IntArray, IntArray]:
    """Return the first row and the number of rows of each block."""
    block = ((time - time[0]) / BIAS_AT_REST.block).astype(int)
    _, first, count = np.unique(block, return_index=True, return_counts=True)
    return first, count


class _SteadyInterval(NamedTuple):
    """Consecutive blocks without a change from one to the next."""

    first: int
    end: int
    rates: FloatArray  # mean rates of the blocks, rad/s, shape (b, 3)
    rests: bool | None = None
    """Whether the field changed far less over the whole stretch than by a turn at the gyro's rate:
    from block to block, a slow turn is not visible. None if such a turn would not exceed the limits
    of the field."""


def _rests(
    field: FloatArray, rate: FloatArray, blocks: tuple[IntArray, IntArray]
) -> list[_SteadyInterval]:
    """Return every stretch in which the robot rested."""
    rates = np.linalg.norm(block_means(rate, blocks[0]), axis=1)
    creeps = BIAS_AT_REST.slow_share * float(np.sort(rates)[-BIAS_AT_REST.at_least])
    found = _steady(field, rate, blocks, 0.5 * float(np.ptp(field, axis=0).max()))
    means = [float(np.linalg.norm(each.rates.mean(axis=0))) for each in found]
    return [s for s, mean in zip(found, means, strict=True) if s.rests or mean <= creeps]


def _rests_by_field(field: FloatArray, blocks: tuple[IntArray, IntArray]) -> list[_SteadyInterval]:
    """Return every rest without a gyro: the field is constant over the whole stretch."""
    allowed = BIAS_AT_REST.smallest_turn * float(np.ptp(field, axis=0).max())
    mean, limit, stays = _means(field, blocks, allowed)
    turned = np.ptp(mean, axis=0) > BIAS_AT_REST.shown * np.median(limit, axis=0)
    return [
        _SteadyInterval(start, end, np.zeros((end - start, 3)))
        for start, end in (_runs(stays) if turned.any() else [])
        if (np.ptp(mean[start:end], axis=0) <= limit[start:end].max(axis=0)).all()
    ]


def _steady(
    field: FloatArray, rate: FloatArray, blocks: tuple[IntArray, IntArray], radius: float
) -> list[_SteadyInterval]:
    """Return where field and rate are constant; `radius` is that of the field's circle."""
    allowed = BIAS_AT_REST.smallest_turn * float(np.ptp(field, axis=0).max())
    fields, limit, field_stays = _means(field, blocks, allowed)
    rates, _, rate_stays = _means(rate, blocks, BIAS_AT_REST.loose_rate)
    found = []
    for start, end in _runs(field_stays & rate_stays):
        inside, seen = rates[start:end], fields[start:end]
        # The change of the field by a turn at the mean rate.
        turned = float(np.linalg.norm(inside.mean(axis=0))) * BIAS_AT_REST.block * (len(inside) - 1)
        chord = 2.0 * radius * math.sin(0.5 * min(turned, math.pi))
        moved = float(np.linalg.norm(seen - seen[0], axis=1).max())
        shows = chord > BIAS_AT_REST.shown * float(limit[start:end].max())
        rests = moved < BIAS_AT_REST.most_moved * chord if shows else None
        found.append(_SteadyInterval(start, end, inside, rests))
    return found


def _means(
    values: FloatArray, blocks: tuple[IntArray, IntArray], allowed: float
) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Return means over blocks (b, 3), limits of changes at rest (b, 3), and which rest (b,).

    Each block is compared with the next `BIAS_AT_REST.at_least` - 1 blocks.
    """
    first, count = blocks
    mean = block_means(values, first)
    noise = np.median(np.abs(np.diff(values, axis=0)), axis=0) / 0.954
    limit = allowed + BIAS_AT_REST.clear * noise * np.sqrt(2.0 / np.maximum(count, 1))[:, None]
    stays = np.zeros(len(mean), dtype=bool)
    stays[: 1 - BIAS_AT_REST.at_least] = True
    for k in range(1, BIAS_AT_REST.at_least):
        apart = np.abs(mean[k:] - mean[:-k]) > limit[k:]
        stays[: len(apart)] &= ~apart.any(axis=1)
    return mean, limit, stays


def _runs(stays: BoolArray) -> list[tuple[int, int]]:
    """Return first block and end of every stretch without a change from block to block."""
    return [(first, end + BIAS_AT_REST.at_least - 1) for first, end in runs(stays)]
