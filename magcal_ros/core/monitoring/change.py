"""Whether the corrected field depends on the heading, and grades of figures beside chance.

A well corrected field has the same strength, rise and dip at every heading, and its yaw turns like
the gyro. Deviations are fitted robustly by harmonics of the heading. Errors within half a minute
are correlated, because the robot stays near the same steel. With n the level direction of magnetic
north in body axes, B, H and V the strength and its level and downward components:

- hard iron b changes the strength by (H/B) b.n, once per turn, and not the rise above level;
- a mounting that moved by a small rotation d changes the rise by H (d_x n_y - d_y n_x), once per
  turn, and not the strength;
- soft iron e changes the strength by e H²/B, twice per turn;
- another place or reference, and hard iron along the vertical, shift both at all headings.

The first three cause a yaw error. Strength needs no up vector, so that acceleration cannot mimic
hard iron.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from magcal_ros.core.assessment.grading import Bound, Check, Grade, shown
from magcal_ros.core.calibration.figure import Figure
from magcal_ros.core.geometry.arrays import FloatArray
from magcal_ros.core.geometry.attitude import mean_angle, wrap_angle
from magcal_ros.core.samples.coverage import BINS, COVERAGE, Coverage


@dataclass(frozen=True)
class ChangeTuning:
    """Assumptions about places, sensors and driving."""

    correlation_time: float = 30.0  # of errors, seconds
    few: float = 10.0  # independent stretches at which the allowance for chance is doubled
    huber: float = 1.5  # scatters from which a record weighs less
    smallest_scatter: float = 0.002  # of the field; the least scatter that is assumed for records
    fastest_curve: float = 0.15
    """s/m, sigma of driving speed over gravity: tilt of the measured up in curves, per rad/s."""
    longest_piece: float = 60.0  # seconds over which the gyro's drift is taken as steady
    steepest_nose: float = 0.75  # squared component of up along x (60°) beyond which no yaw is used
    widest_hole: float = math.radians(100.0)  # radians of heading that may be missing for harmonics
    chance: float = 2.0  # sigmas that chance may reach in a recheck
    clearly: float = 4.0  # the same where many tests are made, as while driving
    sectors: int = 4  # least courses, of eight, for a comparison with the compass
    longest_visit: float = 4.0  # seconds after which a visit is recorded in any case


CHANGE = ChangeTuning()
GYRO_BOUND = Bound(
    Figure.GYRO_COMPASS_DIFFERENCE,
    (None, 4.0, 7.0),
    "gyro against compass",
    "the compass does not turn as the robot does",
)
ROUNDS = 8
"""Of reweighting."""
SECTOR = math.tau / BINS  # radians of heading of one visit
ONCE, TWICE = slice(1, 3), slice(3, 5)  # columns of the first and the second harmonic


class Record(NamedTuple):
    """One visit to a heading, or one sample."""

    stamp: float  # seconds
    yaw: float  # by the compass, radians
    strength: float  # of the corrected field, tesla
    rise: float  # upward component of the corrected field, tesla
    turned: float  # by the gyro since its path began, radians; NaN without one
    path: int  # its number
    rate: float  # of yaw, rad/s


def records_of(samples: FloatArray) -> FloatArray:
    """Return one record of each visit to a sector of heading, shape (k, 7).

    The samples (n, 7) have the columns of `Record`.
    """
    visit = np.floor((samples[:, 0] - samples[0, 0]) / CHANGE.longest_visit)
    sector = np.floor(np.mod(samples[:, 1], math.tau) / SECTOR)
    rows = np.column_stack([samples[:, 5], visit, sector])
    first = np.append(0, np.flatnonzero(np.diff(rows, axis=0).any(axis=1)) + 1)
    count = np.diff(np.append(first, len(rows)))
    records = np.add.reduceat(samples, first) / count[:, None]
    records[:, 1] = np.angle(np.add.reduceat(np.exp(1j * samples[:, 1]), first))
    # Next to iron, the compass may briefly turn once too often.
    return np.asarray(records[count >= min(3.0, float(np.median(count)))])


@dataclass(frozen=True, eq=False)
class HarmonicFit:
    """Harmonics of the heading, fitted to values of records."""

    columns: FloatArray
    """Mean, sine and cosine of the heading, and of twice the heading. Shape (n, 3 or more)."""
    values: FloatArray  # of the columns
    covariance: FloatArray  # of these coefficients
    chance: float
    """Sigmas that chance may reach; more for few independent stretches of driving, whose scatter is
    uncertain."""

    def amplitude(self, part: slice) -> tuple[float, float]:
        """Return the size of one harmonic, and the largest size by chance."""
        variance = float(np.trace(self.covariance[part, part])) / 2.0
        return float(np.hypot(*self.values[part])), self.chance * math.sqrt(variance)


def harmonics(heading: FloatArray) -> FloatArray:
    """Return the columns of `HarmonicFit` for headings (n,), radians; shape (n, 5)."""
    one, twice = np.ones(len(heading)), 2.0 * heading
    return np.column_stack([one, np.sin(heading), np.cos(heading), np.cos(twice), np.sin(twice)])


def fit_harmonics(
    columns: FloatArray,
    values: FloatArray,
    stamp: FloatArray,
    sigmas: float,
    prior: tuple[int, float] | None = None,
) -> HarmonicFit:
    """Fit coefficients with Huber weights.

    Errors of neighbours are correlated: the covariance is that of Newey and West (1987), and never
    smaller than for independent records. Fewer than two independent stretches are in one place, and
    do not show how places differ.

    The columns are (n, k), values and stamps (n,). `sigmas` is the allowance for chance. `prior` is
    a column, and the sigma of its coefficient about zero.
    """
    weight = np.ones(len(values))
    for _ in range(ROUNDS):
        normal = columns.T @ (weight[:, None] * columns)
        if prior is not None:
            normal[prior[0], prior[0]] += (CHANGE.smallest_scatter / prior[1]) ** 2
        inverse = np.linalg.pinv(normal)
        found = inverse @ (columns.T @ (weight * values))
        misfit = values - columns @ found
        scatter = max(1.4826 * float(np.median(np.abs(misfit))), CHANGE.smallest_scatter)
        weight = np.minimum(1.0, CHANGE.huber * scatter / np.maximum(np.abs(misfit), 1e-12))
    alone = scatter**2 * inverse
    stretches = float(np.ptp(stamp)) / CHANGE.correlation_time
    if stretches < 2.0:
        return HarmonicFit(columns, found, np.asarray(alone, dtype=np.float64), sigmas)
    # In steps of a sixth of that time, to limit the memory for an hour of records.
    sixth = ((stamp - stamp.min()) * (6.0 / CHANGE.correlation_time)).astype(np.int64)
    scores = np.zeros((int(sixth.max()) + 1, columns.shape[1]))
    np.add.at(scores, sixth, (weight * misfit)[:, None] * columns)
    count = np.arange(len(scores))
    alike = np.maximum(1.0 - np.abs(count[:, None] - count) / 6.0, 0.0)
    together = inverse @ (scores.T @ alike @ scores) @ inverse
    covariance = np.asarray(max(together, alone, key=np.trace), dtype=np.float64)
    return HarmonicFit(columns, found, covariance, sigmas * (1.0 + CHANGE.few / stretches))


class GyroComparison(NamedTuple):
    """Compass minus gyro, radians, shape (n,), and its harmonics.

    A part of a turn has no harmonics: they cannot be separated from a bias of the gyro.
    """

    deviation: FloatArray
    waves: HarmonicFit | None


def compass_minus_gyro(
    records: FloatArray, heading: FloatArray, sigmas: float
) -> GyroComparison | None:
    """Return the deviation of the compass from the gyro; None if there is nothing to compare.

    An offset for each piece and one constant bias are removed. Deviations are angles modulo a turn:
    next to iron that cancels the level field, the compass may turn once too often. Over a single
    turn a harmonic resembles a bias: both are fitted together.

    The records (n, 7) have the columns of `Record`, with the yaw of the compass under test.
    `heading` (n,) is the best known heading, radians. `sigmas` is the allowance for chance.
    """
    stamp, yaw, turned, path = (records[:, k] for k in (0, 1, 4, 5))
    spell = np.floor((stamp - stamp[:1]) / CHANGE.longest_piece)
    parted = (np.diff(path) != 0) | (np.diff(spell) > 0)
    pieces = np.split(np.arange(len(records)), np.flatnonzero(parted) + 1)
    pieces = [rows for rows in pieces if len(rows) > 4 and np.isfinite(turned[rows]).all()]
    if not pieces:
        return None
    is_round = Coverage.of(heading).gap <= CHANGE.widest_hole
    basis = harmonics(heading)[:, : 5 if is_round else 1]
    basis[:, 0] = stamp
    columns, gaps = [], []
    for rows in pieces:
        gap = yaw[rows] - turned[rows]
        gap = wrap_angle(gap - mean_angle(gap))
        gaps.append(gap - gap.mean())
        columns.append(basis[rows] - basis[rows].mean(axis=0))
    every, gap = np.concatenate(pieces), np.concatenate(gaps)
    drift = 0, COVERAGE.largest_gyro_bias
    waves = fit_harmonics(np.concatenate(columns), gap, stamp[every], sigmas, drift)
    deviation = wrap_angle(gap - waves.columns[:, 0] * waves.values[0])
    return GyroComparison(deviation, waves if is_round else None)


def check_beside_chance(
    bound: Bound, figure: float, chance: float, before: float | None = None, decided: bool = False
) -> Check:
    """Grade the part of a figure that chance does not explain.

    If chance alone reaches the bound of stale, the turn is inconclusive: doubtful, unless the
    figure is small, or further drives will decide (`decided`).
    """
    excess = math.sqrt(max(figure**2 - chance**2, 0.0))
    seen = chance * bound.scale
    note = ""
    if seen > 0.5 * bound.good:
        left = f"{shown(excess * bound.scale)}{bound.unit} are left, by squares"
        note = f", more than the {shown(seen)}{bound.unit} that chance explains: {left}"
        note = ", no more than chance explains" if chance >= figure else note
    check = bound.check(figure, excess=excess, note=note, before=before, rule=rule_of(bound))
    is_small = figure * bound.scale <= bound.good
    if decided or is_small or seen <= bound.warn or check.grade.rank >= Grade.WARN.rank:
        return check
    return doubtful(check)


def rule_of(bound: Bound) -> str:
    """Return the limits of doubtful and stale in words; empty if larger figures are better."""
    if bound.at_least:
        return ""
    unit = bound.unit
    return f"doubtful beyond {bound.good:g}{unit}, stale beyond {bound.warn:g}{unit}"


def doubtful(check: Check) -> Check:
    """Return a check that is too uncertain to say stale."""
    words = f"{check.words}: too uncertain to judge; turn once, in one place away from iron"
    return replace(check, grade=Grade.WARN, words=words, is_judged=False)
