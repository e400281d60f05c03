"""Chords kept by place and course: repeated passes of a street add no independent information."""

from __future__ import annotations

import cmath
import math
from dataclasses import dataclass

import numpy as np

from magcal_ros.core.driving.chords import Chord
from magcal_ros.core.driving.course_tuning import CourseTuning
from magcal_ros.core.geometry.arrays import FloatArray

Key = tuple[int, int, int]


@dataclass
class _Cell:
    """Sums over the chords of a place and a course."""

    gap: complex = 0j
    course: complex = 0j
    east: float = 0.0
    north: float = 0.0
    variance: float = 0.0
    count: int = 0
    metres: float = 0.0
    first: int = 0

    @classmethod
    def of(cls, chord: Chord, order: int) -> _Cell:
        """Return the cell of one chord; `order` counts all chords."""
        gap, course = cmath.exp(1j * chord.gap), cmath.exp(1j * chord.course)
        place = chord.east, chord.north
        return cls(gap, course, *place, chord.sigma**2, 1, chord.metres, order)

    def join(self, other: _Cell) -> None:
        """Take what another cell holds."""
        self.first = min(self.first, other.first) if self.count else other.first
        self.gap += other.gap
        self.course += other.course
        self.east += other.east
        self.north += other.north
        self.variance += other.variance
        self.metres += other.metres
        self.count += other.count


@dataclass(frozen=True, eq=False)
class CellTable:
    """Cells in arrays, one row each.

    Parameters
    ----------
    gap : ndarray, shape (n,)
        Mean yaw of the compass less course, radians.
    course : ndarray, shape (n,)
        Mean course, ENU, radians.
    place : ndarray, shape (n, 2)
        Mean place, metres.
    variance : ndarray, shape (n,)
        Of a chord's course, radians squared.
    count : ndarray, shape (n,)
        Chords.
    metres : ndarray, shape (n,)
        Way.
    first : ndarray, shape (n,)
        Number of its first chord.
    """

    gap: FloatArray
    course: FloatArray
    place: FloatArray
    variance: FloatArray
    count: FloatArray
    metres: FloatArray
    first: FloatArray


class CourseCells:
    """A grid of bounded size over places and courses; it is coarsened whenever it is full.

    Parameters
    ----------
    tuning : CourseTuning, optional
        What is taken for granted.

    Attributes
    ----------
    side : float
        Metres of a cell.
    chords : int
        That were taken so far.
    """

    def __init__(self, tuning: CourseTuning | None = None) -> None:
        self._tuning = tuning or CourseTuning()
        self.side = self._tuning.cell
        self.chords = 0
        self._cells: dict[Key, _Cell] = {}

    def __len__(self) -> int:
        return len(self._cells)

    def add(self, chord: Chord) -> None:
        """Take a chord."""
        self.chords += 1
        key = self._key(chord.east, chord.north, chord.course)
        self._cells.setdefault(key, _Cell()).join(_Cell.of(chord, self.chords))
        while len(self._cells) > self._tuning.most_cells:
            self._coarsen()

    def table(self) -> CellTable:
        """Return what is kept."""
        cells = list(self._cells.values())
        count = np.array([cell.count for cell in cells], dtype=np.float64)
        return CellTable(
            np.array([cmath.phase(cell.gap) for cell in cells]),
            np.array([cmath.phase(cell.course) for cell in cells]),
            np.array([(cell.east, cell.north) for cell in cells]).reshape(-1, 2) / count[:, None],
            np.array([cell.variance for cell in cells]) / count,
            count,
            np.array([cell.metres for cell in cells]),
            np.array([cell.first for cell in cells], dtype=np.float64),
        )

    def _key(self, east: float, north: float, course: float) -> Key:
        sector = round(course / math.tau * self._tuning.sectors) % self._tuning.sectors
        return (math.floor(east / self.side), math.floor(north / self.side), sector)

    def _coarsen(self) -> None:
        self.side *= 2.0
        before, self._cells = self._cells, {}
        for cell in before.values():
            course = cmath.phase(cell.course)
            key = self._key(cell.east / cell.count, cell.north / cell.count, course)
            self._cells.setdefault(key, _Cell()).join(cell)
