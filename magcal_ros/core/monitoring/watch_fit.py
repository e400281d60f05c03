"""What the corrected field of a drive shows of the calibration.

On records of many headings three patterns separate what may have changed. With n the level
direction of magnetic north in body axes, B, H and V the strength and its level and downward parts:

- hard iron b swings the strength by (H/B) b.n, once a turn, and not the field's rise above level;
- a mounting that moved by a small rotation d swings the rise by H (d_x n_y - d_y n_x), once a
  turn, and not the strength; in curves the accelerometer leans outwards, which swings the rise by
  the yaw rate times n_y: the fit contains that term, too;
- soft iron e swings the strength by e H²/B, twice a turn;
- another place, or another reference, shifts both alike at all headings, and so does hard iron
  along the vertical.

The first three move the yaw. Strength needs no up vector, so acceleration cannot mimic hard iron.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from magcal_ros.core.assessment.grading import Bound, Check, Grade
from magcal_ros.core.calibration import Calibration, Figure
from magcal_ros.core.geometry.arrays import FloatArray, IntArray
from magcal_ros.core.monitoring.recheck_chance import RecheckTuning, compass_less_gyro, sectors
from magcal_ros.core.samples.coverage import Coverage

AGAIN = "calibrate again"
WATCH_BOUNDS: tuple[Bound, ...] = (
    Bound(
        Figure.HARD_IRON_CHANGE,
        3.5,
        10.0,
        "the level hard iron has changed, in the field's strength, by",
        f"something magnetic was added to the robot, taken off or moved; {AGAIN}",
        unit="%",
    ),
    Bound(
        Figure.SOFT_IRON_CHANGE,
        4.0,
        10.0,
        "the field's strength swings twice a turn, as soft iron makes it, by",
        f"iron near the sensor or a gain of the sensor has changed; {AGAIN}",
        unit="%",
    ),
    Bound(
        Figure.MOUNTING_CHANGE,
        3.0,
        8.0,
        "the field has tilted against gravity by",
        f"the magnetometer or the IMU was moved on the robot; {AGAIN}",
    ),
    Bound(
        Figure.STRENGTH_SHIFT,
        8.0,
        15.0,
        "at all headings the field's strength is off the calibrated one by",
        "the robot has moved to another place, or iron above or below the sensor has changed; "
        "give the reference field of this place and calibrate here",
        unit="%",
    ),
    Bound(
        Figure.DIP_SHIFT,
        4.0,
        8.0,
        "at all headings the inclination is off the calibrated one by",
        "the robot has moved to another place, or iron above or below the sensor has changed; "
        "give the reference field of this place and calibrate here",
    ),
    Bound(
        Figure.GYRO_COMPASS_HARMONIC,
        4.0,
        7.0,
        "gyro against compass",
        "the compass does not turn as the robot does",
    ),
)
"""As those of a recheck; the records of a drive show what has changed."""


@dataclass(frozen=True)
class WatchTuning:
    """How a drive is watched."""

    bounds: tuple[Bound, ...] = WATCH_BOUNDS
    memory: float = 600.0
    """Seconds of driving that are looked at."""
    most_records: int = 400
    """Visits that are kept at most."""
    aside: float = math.radians(12.0)
    """Radians; a robot that has turned so far from where a visit began looks to another heading."""
    longest_visit: float = 4.0
    """Seconds after which a visit is recorded, though the robot has not turned away."""
    most_in_a_row: int = 3
    """Records of one heading; the next one takes the place of the last."""
    sampling: float = 0.08
    """Seconds between samples of a visit: more would only cost."""
    look_every: float = 15.0
    """Seconds between two looks at the records."""
    confirm: float = 60.0
    """Seconds for which every look must agree before the state changes."""
    steepest_nose: float = RecheckTuning.steepest_nose
    """Squared share of up along body x (60°) beyond which yaw is not compared."""
    longest_piece: float = RecheckTuning.longest_piece
    """Seconds over which the gyro's drift is taken as steady."""
    sectors: int = 12
    fewest_sectors: int = 8
    """Sectors of heading, and how many must have been driven before swings are fitted."""
    widest_hole: float = math.radians(100.0)
    """Radians of heading that may be missing in one stretch."""
    fewest_records: int = 40
    """Before anything is judged."""
    shortest_span: float = 150.0
    """Seconds that the records must span: a disturbance that passes is shorter."""
    clearly: float = 4.0
    few: float = 10.0
    """A swing counts when it is `clearly (1 + few/n)` times its own standard deviation, of which n
    independent stretches of driving know little when they are few."""
    promise: float = 3.0
    """Predicted standard deviations of the heading that are no change."""
    largest_promise: float = 0.1
    """Radians; a larger predicted sigma widens no bound any further."""
    correlation_time: float = 30.0
    """Seconds over which the records' errors are taken to be alike, less and less."""
    huber: float = 1.5
    """Scatters from which a record weighs less."""
    rounds: int = 8
    """Of reweighting."""
    smallest_scatter: float = 0.002
    """Of the field; the least scatter that is assumed for records."""
    fastest_curve: float = 0.15
    """s/m, standard deviation of driving speed over gravity: how far curves may lean up, per
    rad/s."""
    lost: float = math.radians(20.0)
    """Radians of compass against gyro, from which a compass that shows few headings is not to be
    believed."""
    fewest_turned: float = 0.9 * math.tau
    """Radians that the gyro must have turned to be compared with the compass."""


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
    """Findings on a set of records, and the hard iron's change (tesla, body x and y).

    `lacking` says what has not been seen yet; empty if everything could be judged.
    """

    findings: tuple[Check, ...]
    hard_iron: tuple[float, float]
    lacking: str

    @property
    def contradicts(self) -> bool:
        """Whether anything differs from what the calibration predicts."""
        return any(finding.grade.rank >= Grade.WARN.rank for finding in self.findings)


def measure(
    records: FloatArray, calibration: Calibration, tuning: WatchTuning = WatchTuning()
) -> Measured:
    """Compare the records of a drive with what the calibration predicts.

    The records (n, 7) have the columns of `Record`, in the order of their stamps.
    """
    lacking = what_lacks(records, tuning)
    enough = len(records) >= tuning.fewest_records
    figures = _gyro_figure(records, not lacking, tuning) if enough else {}
    iron = (0.0, 0.0)
    if not lacking:
        swings, iron = _swings(records, calibration, tuning)
        figures |= swings
    # A swing that does not stand out of its noise is no finding, of zero least of all.
    figures = {name: figure for name, figure in figures.items() if figure > 0.0}
    bounds = (_as_promised(bound, calibration, tuning) for bound in tuning.bounds)
    findings = tuple(b.check(figures[b.figure]) for b in bounds if b.figure in figures)
    return Measured(findings, iron, lacking)


def what_lacks(records: FloatArray, tuning: WatchTuning) -> str:
    """Say what the records do not show yet; empty if they are enough to judge swings."""
    if len(records) < 2:
        return "the robot has not driven yet"
    seen = len(np.unique(sectors(records[:, 1], tuning.sectors)))
    if seen < tuning.fewest_sectors or Coverage.of(records[:, 1]).gap > tuning.widest_hole:
        return f"not enough headings: {seen} of {tuning.sectors} sectors of heading were driven"
    if len(records) < tuning.fewest_records or np.ptp(records[:, 0]) < tuning.shortest_span:
        return "not enough driving yet"
    return ""


def onset(records: FloatArray, calibration: Calibration, tuning: WatchTuning) -> float:
    """Return the stamp from which the records contradict the calibration.

    It is the change point that best separates records that fit the prediction from records that fit
    what was measured, by the sum of their squared misfits, each limited so that no single one
    decides.
    """
    design, strength, rise = _equations(records, calibration)
    promised = np.stack([strength - 1.0, rise + math.sin(calibration.inclination)])
    late = records[:, 0] >= np.median(records[:, 0])
    correlations = _correlations(records[late, 0], tuning)
    found = [
        values - columns @ _robust_fit(columns[late], values[late], correlations, tuning)[0]
        for columns, values in ((design[0], strength), (design[1], rise))
    ]
    scatter = max(1.5 * float(np.median(np.abs(found))), tuning.smallest_scatter)
    cut = [np.minimum((np.abs(x) / scatter) ** 2, 9.0).sum(axis=0) for x in (promised, found)]
    believed = np.concatenate([[0.0], np.cumsum(cut[0] - cut[1])])
    return float(records[min(int(np.argmin(believed)), len(records) - 1), 0])


def _as_promised(bound: Bound, calibration: Calibration, tuning: WatchTuning) -> Bound:
    """Widen a bound by the heading error that the calibration itself predicts."""
    sigma = calibration.evidence.figure(Figure.HEADING_SIGMA, 0.0)
    sigma = min(sigma, tuning.largest_promise)
    level = math.cos(calibration.inclination)
    promised = {
        Figure.HARD_IRON_CHANGE: 100.0 * tuning.promise * sigma * level,
        Figure.SOFT_IRON_CHANGE: 100.0 * tuning.promise * sigma,
        Figure.GYRO_COMPASS_HARMONIC: math.degrees(tuning.promise * sigma),
    }.get(bound.figure, 0.0)
    return replace(bound, good=max(bound.good, promised), warn=max(bound.warn, 1.5 * promised))


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
    records: FloatArray, calibration: Calibration, tuning: WatchTuning
) -> tuple[dict[Figure, float], tuple[float, float]]:
    """Return the figures that a fit over headings gives, and the hard iron's change, tesla."""
    (by_strength, by_rise), strength, rise = _equations(records, calibration)
    level = math.cos(calibration.inclination)
    stamp = records[:, 0]
    correlations = _correlations(stamp, tuning)
    s, s_noise = _robust_fit(by_strength, strength, correlations, tuning)
    r, r_noise = _robust_fit(by_rise, rise, correlations, tuning, (3, level * tuning.fastest_curve))
    dip = math.atan2(-r[0], math.sqrt(max(s[0] ** 2 - r[0] ** 2, 0.0)))
    figures = {
        Figure.HARD_IRON_CHANGE: _clear(s[1:3], s_noise[1:3], stamp, tuning) / level,
        Figure.SOFT_IRON_CHANGE: _clear(s[3:5], s_noise[3:5], stamp, tuning) / level**2,
        Figure.MOUNTING_CHANGE: _clear(r[1:3], r_noise[1:3], stamp, tuning) / level,
        Figure.STRENGTH_SHIFT: abs(float(s[0]) - 1.0),
        Figure.DIP_SHIFT: abs(dip - calibration.inclination),
    }
    scale = calibration.strength / level
    return figures, (float(s[1]) * scale, float(s[2]) * scale)


def _clear(swing: FloatArray, noise: FloatArray, stamp: FloatArray, tuning: WatchTuning) -> float:
    """Return the size of a swing; zero unless it stands out of its own noise."""
    stretches = float(np.ptp(stamp)) / tuning.correlation_time
    size, sigma = float(np.hypot(*swing)), float(np.hypot(*noise)) / math.sqrt(2.0)
    return size if size > tuning.clearly * (1.0 + tuning.few / max(stretches, 1.0)) * sigma else 0.0


def _robust_fit(
    columns: FloatArray,
    values: FloatArray,
    correlations: FloatArray,
    tuning: WatchTuning,
    prior: tuple[int, float] | None = None,
) -> tuple[FloatArray, FloatArray]:
    """Return coefficients by Huber's weights, and their standard deviations.

    Errors of neighbours are correlated, because steel is passed slowly: the covariance is that of
    Newey and West (1987) with the weights of `correlations`, and never smaller than for independent
    records. `prior` names a column and the standard deviation of its coefficient about zero.
    """
    weight = np.ones(len(values))
    for _ in range(tuning.rounds):
        normal = columns.T @ (weight[:, None] * columns)
        if prior is not None:
            normal[prior[0], prior[0]] += (tuning.smallest_scatter / prior[1]) ** 2
        inverse = np.linalg.pinv(normal)
        found = inverse @ (columns.T @ (weight * values))
        misfit = values - columns @ found
        scatter = max(1.4826 * float(np.median(np.abs(misfit))), tuning.smallest_scatter)
        weight = np.minimum(1.0, tuning.huber * scatter / np.maximum(np.abs(misfit), 1e-12))
    scores = (weight * misfit)[:, None] * columns
    together = np.diag(inverse @ (scores.T @ correlations @ scores) @ inverse)
    alone = scatter**2 * np.diag(inverse)
    return np.asarray(found), np.asarray(np.sqrt(np.maximum(together, alone)))


def _correlations(stamp: FloatArray, tuning: WatchTuning) -> FloatArray:
    """Return the correlation that is assumed between the errors of each two records, 0 to 1."""
    apart = np.abs(stamp[:, None] - stamp) / tuning.correlation_time
    return np.asarray(np.maximum(1.0 - apart, 0.0, out=apart))


def _gyro_figure(records: FloatArray, is_round: bool, tuning: WatchTuning) -> dict[Figure, float]:
    """Return by how much compass less gyro swings with the heading, root mean square.

    If the compass has hardly turned, no swing can be seen: then its median deviation counts.
    """
    pieces = _pieces(records, tuning)
    rows = np.concatenate([np.arange(0), *pieces])
    if len(rows) < tuning.fewest_records or np.ptp(records[rows, 4]) < tuning.fewest_turned:
        return {}
    stamp, yaw, turned = records[:, 0], records[:, 1], records[:, 4]
    error = compass_less_gyro(stamp, yaw, turned, yaw, pieces)
    if not is_round:
        usual = math.sqrt(float(np.median(error**2)))
        return {Figure.GYRO_COMPASS_HARMONIC: usual} if usual > tuning.lost else {}
    swing = np.column_stack([np.ones(len(rows)), np.sin(yaw[rows]), np.cos(yaw[rows])])
    found, noise = _robust_fit(swing, error, _correlations(stamp[rows], tuning), tuning)
    size = _clear(found[1:], noise[1:], stamp[rows], tuning)
    return {Figure.GYRO_COMPASS_HARMONIC: size / math.sqrt(2.0)}


def _pieces(records: FloatArray, tuning: WatchTuning) -> list[IntArray]:
    """Return stretches of rows through which the gyro propagates the heading."""
    spell = np.floor((records[:, 0] - records[0, 0]) / tuning.longest_piece)
    parted = (np.diff(records[:, 5]) != 0) | (np.diff(spell) > 0)
    pieces = np.split(np.arange(len(records)), np.flatnonzero(parted) + 1)
    return [rows for rows in pieces if len(rows) > 4]
