"""The rests before and after a turn, separated from the turn.

A rest has no weight in the fit of the turn. It shows the gyro's bias, and the field while the
motors are off.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from magcal_ros.core.geometry.arrays import FloatArray
from magcal_ros.core.samples.rest import (
    GyroAtRest,
    RestBeside,
    bias_at_rest,
    mean_and_sigma,
    rests_around,
)
from magcal_ros.core.up import relative_attitudes


@dataclass(frozen=True)
class RestingTuning:
    """Which part of a rest is used."""

    longest: float = 10.0
    """Seconds of a rest that count, those nearest to the turn: before, things may have been
    moved."""
    fewest: int = 20
    """Rows that are left of a turn; where there are fewer, the robot hardly moved."""


TUNING = RestingTuning()


def apart_from_rests(
    rows: FloatArray, known: GyroAtRest | None = None
) -> tuple[FloatArray, tuple[RestBeside, ...], float]:
    """Subtract the gyro's bias, and separate the rests before and after the turn.

    The rows (n, 10) hold stamp, field, specific force and angular rate; the rates are all finite,
    or none is. `known` is from a rest before all of them; a rest among them has priority. Returns
    the rows of the turn, the rests, and the sigma (rad/s) of the known bias if it was subtracted;
    else infinity.
    """
    time, field, rate = rows[:, 0], rows[:, 1:4], rows[:, 7:10]
    has_gyro = bool(np.isfinite(rate).all())
    before, after = rests_around(time, field, rate if has_gyro else None)
    first = 0 if before is None else before.stop
    end = len(rows) if after is None else after.start
    bias = bias_at_rest(time, field, rate) if has_gyro else None
    if end - first < TUNING.fewest:
        before, after, first, end = None, None, 0, len(rows)
    rests = []
    # Of a long recording, thinned, a rest may end long before the turn's first row: it says nothing
    # of the turn then.
    if before is not None:
        near = rows[before][time[before] > time[first] - TUNING.longest]
        rests += [_rest(near, near[-1], rows[first], has_gyro)] if len(near) else []
    if after is not None:
        near = rows[after][time[after] < time[end - 1] + TUNING.longest]
        rests += [_rest(near, near[0], rows[end - 1], has_gyro)] if len(near) else []
    sigma = math.inf
    if has_gyro and bias is None and rests:
        # A simulator may publish a gyro without noise.
        weights = [max(rest.rate_sigma, 1e-9) ** -2 for rest in rests]
        bias = np.average([rest.rate for rest in rests], axis=0, weights=weights)
    if bias is None and known is not None:
        bias, sigma = np.array(known.rate), known.later_sigma
    turn = rows[first:end].copy()
    if bias is not None:
        turn[:, 7:10] -= bias
    return turn, tuple(rests), sigma


def _rest(rows: FloatArray, last: FloatArray, beside: FloatArray, has_gyro: bool) -> RestBeside:
    """Return what rows at rest show; `last` is the one of them next to the turn's row `beside`."""
    time = rows[:, 0]
    (field, field_sigma), (force, _) = (
        mean_and_sigma(time, rows[:, columns]) for columns in (slice(1, 4), slice(4, 7))
    )
    rate, rate_sigma, step = np.zeros(3), math.inf, np.zeros(3)
    if has_gyro:
        rate, rate_sigma = mean_and_sigma(time, rows[:, 7:10])
        # Turned back by what the gyro read over the step between them, which may run either way.
        step = (0.5 * (last[7:10] + beside[7:10]) - rate) * (last[0] - beside[0])
    turned = relative_attitudes(np.array([0.0, 1.0]), np.array([step, step]))[1]
    seconds = float(time[-1] - time[0])
    return RestBeside(
        seconds, field, field_sigma, force, rate, rate_sigma, float(beside[0]), turned
    )
