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
from magcal_ros.core.driving.driving_tuning import COURSE
from magcal_ros.core.driving.mounting_yaw import ComplexArray
from magcal_ros.core.geometry.arrays import BoolArray, FloatArray
from magcal_ros.core.geometry.attitude import wrap_angle

Key = tuple[int, int, int]


@dataclass(frozen=True, eq=False)
class CellTable:
    """Cells in arrays, one row each."""

    gap: FloatArray
    """Mean yaw of the compass less course, radians. Shape (n,)."""
    course: FloatArray
    """Mean course, ENU, radians. Shape (n,)."""
    place: FloatArray  # mean place, metres, shape (n, 2)
    variance: FloatArray
    """Of a chord's course, radians squared. Shape (n,)."""
    count: FloatArray  # chords, shape (n,)
    metres: FloatArray  # way, shape (n,)
    first: FloatArray
    """Number of its first chord. Shape (n,)."""


class CourseCells:
    """A grid of bounded size over places and courses; it is coarsened whenever it is full.

    `side` are the metres of a cell, and `chords` counts what was taken so far.
    """

    def __init__(self) -> None:
        self.side = COURSE.cell
        self.chords = 0
        self._cells: dict[Key, tuple[ComplexArray, int]] = {}

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
        east, north = (float(value) / float(sums[5].real) for value in sums[2:4].real)
        sector = round(cmath.phase(sums[1]) / math.tau * COURSE.sectors) % COURSE.sectors
        key = (math.floor(east / self.side), math.floor(north / self.side), sector)
        others, earlier = self._cells.get(key, (0.0, first))
        self._cells[key] = (sums + others, min(first, earlier))

    def table(self) -> CellTable:
        """Return what is kept."""
        sums = np.array([sums for sums, _ in self._cells.values()]).reshape(-1, 7)
        count = sums[:, 5].real
        return CellTable(
            np.angle(sums[:, 0]),
            np.angle(sums[:, 1]),
            sums[:, 2:4].real / count[:, None],
            sums[:, 4].real / count,
            count,
            sums[:, 6].real,
            np.array([first for _, first in self._cells.values()], dtype=np.float64),
        )


@dataclass(frozen=True, eq=False)
class CourseOffset:
    """What course shows of the compass."""

    offset: float
    sigma: float
    """Radians: yaw of the compass less course, as a constant."""
    harmonics: FloatArray
    """cos psi, sin psi, cos 2psi, sin 2psi, radians. Shape (4,)."""
    covariance: FloatArray
    """Of offset and harmonics. Shape (5, 5)."""
    metres: float  # straight way driven
    sectors: int  # courses seen, of eight

    def swing(self, order: int) -> tuple[float, float]:
        """Return the amplitude of the first or second harmonic, radians, and its significance.

        The latter is in sigmas: the square root of the harmonic's chi².
        """
        rows = slice(2 * order - 2, 2 * order)
        pair = self.harmonics[rows]
        own = self.covariance[2 * order - 1 : 2 * order + 1, 2 * order - 1 : 2 * order + 1]
        return float(np.hypot(*pair)), math.sqrt(float(pair @ np.linalg.solve(own, pair)))


def fit_course_offset(cells: CellTable) -> CourseOffset | None:
    """Fit the offset; None before enough places were seen."""
    if len(cells.gap) < COURSE.fewest:
        return None
    start = _cluster(cells)
    found = _Fit(cells, wrap_angle(cells.gap - start))
    for _ in range(COURSE.rounds):
        found.improve()
    variance = max(found.covariance[0, 0], found.by_first_ways())
    variance += COURSE.swing_share**2 * found.plain_swing()
    covariance = found.covariance.copy()
    covariance[0, 0] = variance
    sectors = np.round(cells.course / math.tau * COURSE.sectors) % COURSE.sectors
    return CourseOffset(
        float(wrap_angle(start + found.values[0])),
        math.sqrt(variance),
        found.values[1:],
        covariance,
        float(np.sum(cells.metres)),
        len(np.unique(sectors)),
    )


def _cluster(cells: CellTable) -> float:
    """Return where most gaps lie: a reweighted mean from the densest place."""
    grid = np.linspace(-math.pi, math.pi, 72, endpoint=False)
    weight = np.minimum(cells.count, 3.0)
    near = np.exp(-((wrap_angle(cells.gap - grid[:, None]) / math.radians(15.0)) ** 2))
    centre = float(grid[np.argmax(near @ weight)])
    for _ in range(10):
        gap = wrap_angle(cells.gap - centre)
        own = weight / (1.0 + (gap / math.radians(7.0)) ** 2)
        centre += float(own @ gap / np.sum(own))
    return centre


class _Fit:
    """The weights, the street's size and the values of one fit."""

    def __init__(self, cells: CellTable, gap: FloatArray) -> None:
        self._cells, self._gap = cells, gap
        psi = cells.course
        ones = np.ones(len(psi))
        self._design = np.column_stack(
            [ones, np.cos(psi), np.sin(psi), np.cos(2.0 * psi), np.sin(2.0 * psi)]
        )
        first, second = COURSE.first_sigma**-2, COURSE.second_sigma**-2
        self._prior = np.diag([1e-6, first, first, second, second])
        away = cells.place[:, None] - cells.place[None]
        self._distance = np.hypot(away[..., 0], away[..., 1])
        self._alike = np.exp(-self._distance / COURSE.reach)
        self._noise = (cells.variance + COURSE.noise**2) / cells.count
        self._weight = ones
        self.street = COURSE.street
        self.values: FloatArray = np.zeros(5)
        self.covariance: FloatArray = np.eye(5)

    def improve(self) -> None:
        """One round: values by least squares, then weights and street by what is left."""
        design = self._design
        solved = self._solve(np.column_stack([design, self._gap]), slice(None))
        information = design.T @ solved[:, :5] + self._prior
        self.covariance = np.asarray(np.linalg.inv(information))
        self.values = np.asarray(self.covariance @ (design.T @ solved[:, 5]))
        self.left = self._gap - design @ self.values
        own, freedom = self.street**2 + self._noise, COURSE.freedom
        self._weight = (freedom + 1.0) / (freedom + self.left**2 / own)
        self._weigh_street()

    def _solve(self, right: FloatArray, rows: slice | BoolArray) -> FloatArray:
        """Return the inverse covariance of some rows times `right`."""
        weight = self._weight[rows]
        own = np.sqrt(weight)
        # A cell of little weight is one that its street disturbs more than others.
        spread = self.street**2 * self._alike[rows][:, rows] / np.outer(own, own)
        spread[np.diag_indices_from(spread)] += self._noise[rows] / weight
        return np.asarray(np.linalg.solve(spread, right))

    def _weigh_street(self) -> None:
        """Take the street's size from what is left, with some pseudo-observations.

        What is seen counts by its places: a street that is driven again is the same one.
        """
        own = np.sqrt(self._weight) * self.left
        shape = self._alike.copy()
        shape[np.diag_indices_from(shape)] += self._noise / self.street**2
        squares = float(own @ np.linalg.solve(shape, own))
        places = len(np.unique(np.floor(self._cells.place / COURSE.reach), axis=0))
        seen = min(places, len(own))
        total = COURSE.street_weight * COURSE.street**2 + seen * squares / len(own)
        self.street = math.sqrt(total / (COURSE.street_weight + seen))

    def plain_swing(self) -> float:
        """Return the harmonics' square, radians², beyond what is uncertain of them.

        Iron that is there for a part of the way swings the compass, and changes the offset in a
        way that the scatter of streets does not show.
        """
        uncertain = np.trace(self.covariance[1:, 1:])
        return max(0.0, float(np.sum(self.values[1:] ** 2) - uncertain))

    def by_first_ways(self) -> float:
        """Return the variance if each street counted only the way it was driven first.

        What stands on one side of a street bends the field on one way: both ways of a street
        count as one observation.
        """
        again = self._again()
        if not again.any():
            return 0.0
        kept = ~again
        design = self._design[kept]
        information = design.T @ self._solve(design, kept) + self._prior
        return float(np.linalg.inv(information)[0, 0])

    def _again(self) -> BoolArray:
        """Return which cells lie where the vehicle has been before, on another course."""
        cells = self._cells
        near = self._distance < max(1.5 * COURSE.cell, 0.5 * COURSE.reach)
        other = np.cos(cells.course[:, None] - cells.course[None]) < 0.0
        earlier = cells.first[None] < cells.first[:, None]
        return np.asarray((near & other & earlier).any(axis=1))
