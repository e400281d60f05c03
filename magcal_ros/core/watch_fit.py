"""What the corrected field of a drive says about the calibration behind it.

On records of many headings three patterns part what may have changed. With n the level direction
of magnetic north in body axes, B, H and V the strength and its level and downward parts:

- hard iron b swings the strength by (H/B) b.n, once a turn, and not the field's rise above level;
- a mounting that moved by a small rotation d swings the rise by H (d_x n_y - d_y n_x), once a
  turn, and not the strength; a robot that drives curves leans its accelerometer outwards, which
  swings the rise by the yaw rate times n_y: the fit knows of that, too;
- soft iron e swings the strength by e H²/B, twice a turn;
- another place, or another reference, shifts both alike at all headings, and so does hard iron
  along the vertical.

The first three move the yaw. Strength needs no up vector, so acceleration cannot feign hard iron.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from magcal_ros.core.arrays import FloatArray, IntArray
from magcal_ros.core.calibration import Calibration
from magcal_ros.core.coverage import Coverage
from magcal_ros.core.holds import BOUNDS, LONGEST_PIECE, Bound, Finding, State, compass_less_gyro

SECTORS = 12
FEWEST_SECTORS = 8
"""Of so many sectors of heading must have been driven before swings can be told."""

WIDEST_HOLE = math.radians(100.0)
FEWEST_RECORDS = 40
SHORTEST_SPAN = 150.0
"""Seconds that the records must span: a disturbance that passes is shorter."""

CLEARLY = 4.0
FEW = 10.0
"""A swing counts when it is `CLEARLY (1 + FEW/n)` times its own standard deviation, of which n
independent stretches of driving know little when they are few."""

PROMISE = 3.0
"""Standard deviations of what the calibration promised that are no change."""

ALIKE_FOR = 30.0
"""Seconds over which the records' errors are taken to be alike, less and less."""

HUBER = 1.5
ROUNDS = 8
SMALLEST_SCATTER = 0.002
"""Of the field; records are never believed to agree better."""

FASTEST_CURVE = 0.15
"""s/m, standard deviation of driving speed over gravity: how far curves may lean up, per rad/s."""

LOST = math.radians(20.0)
"""Compass against gyro, from which a compass that shows few headings is not to be believed."""

FEWEST_TURNED = 0.9 * math.tau
"""Radians that the gyro must have turned to be compared with the compass."""

AGAIN = "calibrate again"
WATCH_BOUNDS: tuple[Bound, ...] = (
    Bound(
        "hard_iron_change",
        3.5,
        10.0,
        "%",
        "the level hard iron has changed, in the field's strength, by",
        f"something magnetic was added to the robot, taken off or moved; {AGAIN}",
    ),
    Bound(
        "soft_iron_change",
        4.0,
        10.0,
        "%",
        "the field's strength swings twice a turn, as soft iron makes it, by",
        f"iron near the sensor or a gain of the sensor has changed; {AGAIN}",
    ),
    Bound(
        "mounting_change",
        3.0,
        8.0,
        "°",
        "the field has tilted against gravity by",
        f"the magnetometer or the IMU was moved on the robot; {AGAIN}",
    ),
    Bound(
        "strength_shift",
        8.0,
        15.0,
        "%",
        "at all headings the field's strength is off the calibrated one by",
        "the robot has moved to another place, or iron above or below the sensor has changed; "
        "give the reference field of this place and calibrate here",
    ),
    Bound(
        "dip_shift",
        4.0,
        8.0,
        "°",
        "at all headings the inclination is off the calibrated one by",
        "the robot has moved to another place, or iron above or below the sensor has changed; "
        "give the reference field of this place and calibrate here",
    ),
    next(bound for bound in BOUNDS if bound.figure == "gyro_compass_rms"),
)
"""The one table of bounds."""


class Record(NamedTuple):
    """One visit to a heading.

    `stamp` in seconds; `yaw` (rad) by the compass; `strength` and `rise` (tesla) of the corrected
    field, the rise upwards; `turned` (rad) by the gyro since its path began, `path` its number;
    `rate` (rad/s) of yaw.
    """

    stamp: float
    yaw: float
    strength: float
    rise: float
    turned: float
    path: int
    rate: float


class Measured(NamedTuple):
    """Findings on a set of records, the hard iron's change (tesla, body x and y), and doubts.

    `lacking` says what more would have to be seen; empty if everything could be judged.
    """

    findings: tuple[Finding, ...]
    hard_iron: tuple[float, float]
    lacking: str

    @property
    def contradicts(self) -> bool:
        """Whether anything is not as the calibration promised."""
        return any(finding.state is not State.HOLDS for finding in self.findings)


def measure(records: FloatArray, calibration: Calibration) -> Measured:
    """Look at the records of a drive through what the calibration promised.

    Parameters
    ----------
    records : ndarray, shape (n, 7)
        Columns as in `Record`, in the order of their stamps.
    calibration : Calibration
        What is in force.

    Returns
    -------
    Measured
    """
    lacking = what_lacks(records)
    figures = _gyro_figure(records, not lacking) if len(records) >= FEWEST_RECORDS else {}
    iron = (0.0, 0.0)
    if not lacking:
        swings, iron = _swings(records, calibration)
        figures |= swings
    # A swing that does not stand out of its noise is no finding, of zero least of all.
    figures = {name: figure for name, figure in figures.items() if figure > 0.0}
    bounds = (_as_promised(bound, calibration) for bound in WATCH_BOUNDS)
    findings = tuple(b.find(0.0, figures[b.figure]) for b in bounds if b.figure in figures)
    return Measured(findings, iron, lacking)


def what_lacks(records: FloatArray) -> str:
    """Say what the records do not show yet; empty if they are enough to judge swings."""
    if len(records) < 2:
        return "the robot has not driven yet"
    yaw = np.mod(records[:, 1], math.tau)
    seen = len(np.unique((yaw * (SECTORS / math.tau)).astype(int)))
    if seen < FEWEST_SECTORS or Coverage.of(records[:, 1]).gap > WIDEST_HOLE:
        return f"not enough headings: {seen} of {SECTORS} sectors of heading were driven"
    if len(records) < FEWEST_RECORDS or np.ptp(records[:, 0]) < SHORTEST_SPAN:
        return "not enough driving yet"
    return ""


def onset(records: FloatArray, calibration: Calibration) -> float:
    """Return the stamp from which the records contradict the calibration.

    The one change point that best parts records that fit the promise from records that fit what
    was measured, by the sum of their squared misfits, each cut off so that no single one rules.
    """
    design, strength, rise = _equations(records, calibration)
    promised = np.stack([strength - 1.0, rise + math.sin(calibration.inclination)])
    late = records[:, 0] >= np.median(records[:, 0])
    found = [
        values - columns @ _robust_fit(columns[late], values[late], _alike(records[late, 0]))[0]
        for columns, values in ((design[0], strength), (design[1], rise))
    ]
    scatter = max(1.5 * float(np.median(np.abs(found))), SMALLEST_SCATTER)
    cut = [np.minimum((np.abs(x) / scatter) ** 2, 9.0).sum(axis=0) for x in (promised, found)]
    believed = np.concatenate([[0.0], np.cumsum(cut[0] - cut[1])])
    return float(records[min(int(np.argmin(believed)), len(records) - 1), 0])


def _as_promised(bound: Bound, calibration: Calibration) -> Bound:
    """Widen a bound by the heading error that the calibration itself predicts."""
    sigma = min(calibration.evidence.figures.get("heading_sigma", 0.0), 0.1)
    level = math.cos(calibration.inclination)
    promised = {
        "hard_iron_change": 100.0 * PROMISE * sigma * level,
        "soft_iron_change": 100.0 * PROMISE * sigma,
        "gyro_compass_rms": math.degrees(PROMISE * sigma),
    }.get(bound.figure, 0.0)
    return replace(
        bound, holds=max(bound.holds, promised), doubtful=max(bound.doubtful, 1.5 * promised)
    )


def _equations(
    records: FloatArray, calibration: Calibration
) -> tuple[tuple[FloatArray, FloatArray], FloatArray, FloatArray]:
    """Return the columns for strength and rise, and both over the calibrated strength."""
    yaw, rate = records[:, 1], records[:, 6]
    one, x, y = np.ones(len(yaw)), np.sin(yaw), np.cos(yaw)
    strength = np.column_stack([one, x, y, np.cos(2.0 * yaw), np.sin(2.0 * yaw)])
    rise = np.column_stack([one, x, y, rate * y])
    scaled = records[:, 2:4] / calibration.strength
    return (strength, rise), scaled[:, 0], scaled[:, 1]


def _swings(
    records: FloatArray, calibration: Calibration
) -> tuple[dict[str, float], tuple[float, float]]:
    """Return the figures that a fit over headings gives, and the hard iron's change, tesla."""
    (by_strength, by_rise), strength, rise = _equations(records, calibration)
    level = math.cos(calibration.inclination)
    stamp = records[:, 0]
    alike = _alike(stamp)
    s, s_noise = _robust_fit(by_strength, strength, alike)
    r, r_noise = _robust_fit(by_rise, rise, alike, (3, level * FASTEST_CURVE))
    dip = math.atan2(-r[0], math.sqrt(max(s[0] ** 2 - r[0] ** 2, 0.0)))
    figures = {
        "hard_iron_change": _clear(s[1:3], s_noise[1:3], stamp) / level,
        "soft_iron_change": _clear(s[3:5], s_noise[3:5], stamp) / level**2,
        "mounting_change": _clear(r[1:3], r_noise[1:3], stamp) / level,
        "strength_shift": abs(float(s[0]) - 1.0),
        "dip_shift": abs(dip - calibration.inclination),
    }
    scale = calibration.strength / level
    return figures, (float(s[1]) * scale, float(s[2]) * scale)


def _clear(swing: FloatArray, noise: FloatArray, stamp: FloatArray) -> float:
    """Return the size of a swing; zero unless it stands out of its own noise."""
    stretches = float(np.ptp(stamp)) / ALIKE_FOR
    size, sigma = float(np.hypot(*swing)), float(np.hypot(*noise)) / math.sqrt(2.0)
    return size if size > CLEARLY * (1.0 + FEW / max(stretches, 1.0)) * sigma else 0.0


def _robust_fit(
    columns: FloatArray,
    values: FloatArray,
    alike: FloatArray,
    prior: tuple[int, float] | None = None,
) -> tuple[FloatArray, FloatArray]:
    """Return coefficients by Huber's weights, and their standard deviations.

    Neighbours err alike, for steel is passed slowly: the covariance is that of Newey and West
    (1987) with the weights of `alike`, and never smaller than that of independent records.
    `prior` names a column and the standard deviation of its coefficient about zero.
    """
    weight = np.ones(len(values))
    for _ in range(ROUNDS):
        normal = columns.T @ (weight[:, None] * columns)
        if prior is not None:
            normal[prior[0], prior[0]] += (SMALLEST_SCATTER / prior[1]) ** 2
        inverse = np.linalg.pinv(normal)
        found = inverse @ (columns.T @ (weight * values))
        misfit = values - columns @ found
        scatter = max(1.4826 * float(np.median(np.abs(misfit))), SMALLEST_SCATTER)
        weight = np.minimum(1.0, HUBER * scatter / np.maximum(np.abs(misfit), 1e-12))
    pulls = (weight * misfit)[:, None] * columns
    together = np.diag(inverse @ (pulls.T @ alike @ pulls) @ inverse)
    alone = scatter**2 * np.diag(inverse)
    return np.asarray(found), np.asarray(np.sqrt(np.maximum(together, alone)))


def _alike(stamp: FloatArray) -> FloatArray:
    """Return how alike the errors of each two records are taken to be, 0 to 1."""
    apart = np.abs(stamp[:, None] - stamp) / ALIKE_FOR
    return np.asarray(np.maximum(1.0 - apart, 0.0, out=apart))


def _gyro_figure(records: FloatArray, is_round: bool) -> dict[str, float]:
    """Return by how much compass less gyro swings with the heading, root mean square.

    Where the compass has hardly come round, there is no swing to see: then all of it counts.
    """
    pieces = _pieces(records)
    rows = np.concatenate([np.arange(0), *pieces])
    if len(rows) < FEWEST_RECORDS or np.ptp(records[rows, 4]) < FEWEST_TURNED:
        return {}
    stamp, yaw, turned = records[:, 0], records[:, 1], records[:, 4]
    error = compass_less_gyro(stamp, yaw, turned, yaw, pieces)
    if not is_round:
        usual = math.sqrt(float(np.median(error**2)))
        return {"gyro_compass_rms": usual} if usual > LOST else {}
    swing = np.column_stack([np.ones(len(rows)), np.sin(yaw[rows]), np.cos(yaw[rows])])
    found, noise = _robust_fit(swing, error, _alike(stamp[rows]))
    return {"gyro_compass_rms": _clear(found[1:], noise[1:], stamp[rows]) / math.sqrt(2.0)}


def _pieces(records: FloatArray) -> list[IntArray]:
    """Return stretches of rows that the gyro has carried through."""
    spell = np.floor((records[:, 0] - records[0, 0]) / LONGEST_PIECE)
    parted = (np.diff(records[:, 5]) != 0) | (np.diff(spell) > 0)
    pieces = np.split(np.arange(len(records)), np.flatnonzero(parted) + 1)
    return [rows for rows in pieces if len(rows) > 4]
