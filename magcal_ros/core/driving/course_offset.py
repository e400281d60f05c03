"""The offset of the compass against course, with a sigma that counts streets, not samples.

    r_i = o + a1 cos psi + b1 sin psi + a2 cos 2psi + b2 sin 2psi + g(p_i) + n_i

psi is the course, g what the street at the place p_i adds: cov = s² exp(-|p_i - p_j|/30 m).
Generalised least squares with Student's weights; the sigma counts both ways of a street as one
observation, and has a share of a plain swing.
"""

from __future__ import annotations

import cmath
import math
from dataclasses import dataclass

import numpy as np

from magcal_ros.core.driving.chords import Chord
from magcal_ros.core.driving.driving_tuning import COURSE, MOUNTING
from magcal_ros.core.geometry.arrays import ComplexArray, FloatArray
from magcal_ros.core.geometry.attitude import wrap_angle


@dataclass(frozen=True, eq=False)
class CellTable:
    """Cells in arrays, one row each."""

    gap: FloatArray  # mean yaw of the compass less course, radians, shape (n,)
    course: FloatArray  # mean, ENU, radians, shape (n,)
    place: FloatArray  # mean, metres, shape (n, 2)
    variance: FloatArray  # of a chord's course, radians squared, shape (n,)
    count: FloatArray  # chords, shape (n,)
    metres: FloatArray  # way, shape (n,)
    first: FloatArray  # number of its first chord, shape (n,)


class CourseCells:
    """A grid over places and courses, its `side` in metres, coarsened whenever it is full."""

    def __init__(self) -> None:
        self.side = COURSE.cell
        self.chords = 0
        self._cells: dict[tuple[int, int, int], tuple[ComplexArray, int]] = {}

    def __len__(self) -> int:
        return len(self._cells)

    def add(self, chord: Chord) -> None:
        """Take a chord."""
        self.chords += 1
        gap, course = cmath.exp(1j * chord.gap), cmath.exp(1j * chord.course)
        place = chord.east, chord.north
        self._put(np.array([gap, course, *place, chord.sigma**2, 1.0, chord.metres]), self.chords)
        while len(self._cells) > COURSE.most_cells:
            self.side *= 2.0
            before, self._cells = self._cells, {}
            for sums, first in before.values():
                self._put(sums, first)

    def _put(self, sums: ComplexArray, first: int) -> None:
        """Add sums over chords to their cell, with the number of the first chord."""
        east, north = (math.floor(x / (sums[5].real * self.side)) for x in sums[2:4].real)
        sector = round(cmath.phase(sums[1]) / math.tau * COURSE.sectors) % COURSE.sectors
        others, earlier = self._cells.get((east, north, sector), (0.0, first))
        self._cells[east, north, sector] = sums + others, min(first, earlier)

    def table(self) -> CellTable:
        """Return what is kept."""
        sums = np.array([sums for sums, _ in self._cells.values()]).reshape(-1, 7)
        gap, course = np.angle(sums[:, :2]).T
        count = sums[:, 5].real
        means = sums[:, 2:5].real / count[:, None]
        first = np.array([first for _, first in self._cells.values()], dtype=np.float64)
        return CellTable(gap, course, means[:, :2], means[:, 2], count, sums[:, 6].real, first)


@dataclass(frozen=True, eq=False)
class CourseOffset:
    """What course shows of the compass."""

    offset: float
    sigma: float
    """Radians: yaw of the compass less course, as a constant."""
    harmonics: FloatArray  # cos psi, sin psi, cos 2psi, sin 2psi, radians. Shape (4,).
    covariance: FloatArray  # of offset and harmonics. Shape (5, 5).
    metres: float  # straight way driven
    sectors: int  # courses seen, of eight

    def swing(self, order: int) -> tuple[float, float]:
        """Return a harmonic's amplitude, radians, and its significance in sigmas (root of chi²)."""
        rows = slice(2 * order - 2, 2 * order)
        pair = self.harmonics[rows]
        own = self.covariance[2 * order - 1 : 2 * order + 1, 2 * order - 1 : 2 * order + 1]
        return float(np.hypot(*pair)), math.sqrt(float(pair @ np.linalg.solve(own, pair)))


def fit_course_offset(cells: CellTable) -> CourseOffset | None:
    """Fit the offset; None before enough places were seen."""
    psi, count = cells.course, len(cells.gap)
    if count < COURSE.fewest:
        return None
    start = _cluster(cells)
    gap = wrap_angle(cells.gap - start)
    waves = (np.cos(psi), np.sin(psi), np.cos(2.0 * psi), np.sin(2.0 * psi))
    design = np.column_stack([np.ones(count), *waves])
    prior = np.diag([1e-3, *4 * [1.0 / COURSE.wave_sigma]]) ** 2
    away = cells.place[:, None] - cells.place[None]
    distance = np.hypot(away[..., 0], away[..., 1])
    alike = np.exp(-distance / COURSE.reach)
    noise = (cells.variance + COURSE.noise**2) / cells.count
    # What is seen counts by its places: a street that is driven again is the same one.
    places = len(np.unique(np.floor(cells.place / COURSE.reach), axis=0))
    weight, street = np.ones(count), COURSE.street
    for _ in range(MOUNTING.rounds):
        # A cell of little weight is one that its street disturbs more than others.
        root = np.sqrt(weight)
        spread = (street**2 * alike + np.diag(noise)) / np.outer(root, root)
        solved = np.linalg.solve(spread, np.column_stack([design, gap]))
        covariance = np.linalg.inv(design.T @ solved[:, :5] + prior)
        values = covariance @ (design.T @ solved[:, 5])
        left = gap - design @ values
        weight = (COURSE.freedom + 1.0) / (COURSE.freedom + left**2 / (street**2 + noise))
        own = np.sqrt(weight) * left
        square = float(own @ np.linalg.solve(alike + np.diag(noise / street**2), own)) / count
        pseudo = COURSE.street_weight
        street = math.sqrt((pseudo * COURSE.street**2 + places * square) / (pseudo + places))
    # What stands on one side of a street bends the field on one way: of a street, only the way
    # that was driven first counts.
    near = distance < max(1.5 * COURSE.cell, 0.5 * COURSE.reach)
    is_back = near & (np.cos(psi[:, None] - psi) < 0.0) & (cells.first < cells.first[:, None])
    kept = ~is_back.any(axis=1)
    information = design[kept].T @ np.linalg.solve(spread[kept][:, kept], design[kept]) + prior
    # Iron that is there for a part of the way swings the compass, and changes the offset in a way
    # that the scatter of streets does not show.
    swing = float(np.sum(values[1:] ** 2) - np.trace(covariance[1:, 1:]))
    covariance[0, 0] = max(covariance[0, 0], np.linalg.inv(information)[0, 0])
    covariance[0, 0] += COURSE.swing_share**2 * max(0.0, swing)
    return CourseOffset(
        float(wrap_angle(start + values[0])),
        math.sqrt(covariance[0, 0]),
        values[1:],
        covariance,
        float(np.sum(cells.metres)),
        len(np.unique(np.round(psi / math.tau * COURSE.sectors) % COURSE.sectors)),
    )


def _cluster(cells: CellTable) -> float:
    """Return where most gaps lie: a reweighted mean from the densest place."""
    grid = np.linspace(-math.pi, math.pi, 72, endpoint=False)
    weight = np.minimum(cells.count, 3.0)
    near = np.exp(-((wrap_angle(cells.gap - grid[:, None]) / math.radians(15.0)) ** 2))
    centre = float(grid[np.argmax(near @ weight)])
    for _ in range(10):
        gap = wrap_angle(cells.gap - centre)
        own = weight / (1.0 + (gap / COURSE.street) ** 2)
        centre += float(own @ gap / np.sum(own))
    return centre
