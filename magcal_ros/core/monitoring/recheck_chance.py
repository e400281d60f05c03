"""How much the figures of a recheck vary although the calibration still holds.

There are two causes. The calibration was uncertain when it was made, and the error of its hard iron
shows as a swing around the turn. And the field differs from place to place: headings that were seen
in other places have other means, as repeated visits to one heading show.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from magcal_ros.core.assessment.grading import Aspect, Bound, Check, Grade, shown
from magcal_ros.core.calibration.calibration import Calibration, GyroSwing, by_twelve
from magcal_ros.core.calibration.figure import Figure
from magcal_ros.core.calibration.heading_sigma import HEADINGS, rms_sigma
from magcal_ros.core.geometry.arrays import FloatArray, IntArray
from magcal_ros.core.geometry.attitude import wrap_angle
from magcal_ros.core.samples import STREAMS, Window
from magcal_ros.core.samples.coverage import COVERAGE, Coverage

MOVED = "the hard iron has changed, or the field is distorted here"

RECHECK_BOUNDS: tuple[Bound, ...] = (
    Bound(Figure.HEADING_SWING, 4.0, 7.0, "heading swing that the level field shows", MOVED),
    Bound(
        Figure.GYRO_COMPASS_DIFFERENCE,
        4.0,
        7.0,
        "gyro against compass",
        "the compass does not turn as the robot does",
    ),
    Bound(
        Figure.STRENGTH_SPREAD, 3.0, 6.0, "field strength varies with heading by", MOVED, unit="%"
    ),
    Bound(Figure.DIP_SPREAD, 2.0, 4.0, "angle between field and up varies with heading by", MOVED),
    Bound(
        Figure.STRENGTH_OFFSET,
        5.0,
        15.0,
        "field strength is off the calibrated one by",
        "another place, or the hard iron along the turn's axis has changed",
        unit="%",
    ),
    Bound(
        Figure.DIP_OFFSET,
        3.0,
        8.0,
        "inclination is off the calibrated one by",
        "another place, or the hard iron along the turn's axis has changed",
    ),
    Bound(
        Figure.ARC,
        270.0,
        0.0,
        "the turn covers",
        "the headings that were not seen are not checked",
        aspect=Aspect.CONFIDENCE,
        at_least=True,
    ),
)
"""Nothing is better than good: that a calibration holds is all that a recheck can say."""


@dataclass(frozen=True)
class RecheckTuning:
    """How a recheck looks."""

    bounds: tuple[Bound, ...] = RECHECK_BOUNDS
    bins: int = 36
    """Sectors of heading over which a mean is taken: narrow against two swings a turn."""
    longest_piece: float = 60.0
    """Seconds over which the gyro's drift is taken as steady."""
    visit: float = 12.0
    """Seconds within which a robot that drives meets the same disturbance: streets are alike for 25
    to 30 m."""
    own_share: float = 0.25
    """Of the bound of what is stale: so much of a swing the calibration's own sigma explains."""
    steepest_nose: float = 0.75
    """Squared share of up along body x (60°) beyond which yaw is not compared."""


HARMONICS = 4
"""Numbers of a swing: cosine and sine of the heading and of twice the heading."""
LIKELY = 0.95


def chances(
    seen: dict[Figure, FloatArray],
    visit: IntArray,
    around: IntArray,
    compared: tuple[GyroSwing, IntArray] | None,
    own: dict[Figure, float],
    most: dict[Figure, float],
    bins: int,
) -> dict[Figure, float]:
    """Return how large each figure may be by chance, in its own unit.

    `seen` holds the values (n,) that a figure is the spread of. `visit` (n,) numbers the stretches
    of time within which places are alike, `around` (n,) the sector of the heading. `compared` is
    compass less gyro with its rows: what does not repeat with the heading is not the calibration's.
    `own` is of `own_swings`; at most `most` of it is accepted, because a rough calibration that
    swings is to be made again whether or not anything has changed. `bins` is the number of sectors.
    """
    found = {
        figure: math.hypot(min(own[figure], most[figure]), scatter_of_means(values, around, visit))
        for figure, values in seen.items()
    }
    if compared is not None:
        swing, rows = compared
        figure = Figure.GYRO_COMPASS_DIFFERENCE
        elsewhere = math.hypot(
            _unrepeated(swing, bins),
            scatter_of_means(swing.deviation, sectors(swing.heading, bins), visit[rows]),
        )
        found[figure] = math.hypot(
            min(own[figure], most[figure]),
            max(elsewhere, _of_one_visit(swing.deviation, visit[rows])),
        )
    return found


def _of_one_visit(deviation: FloatArray, visit: IntArray) -> float:
    """Return what the visit that deviates most adds to the RMS of all, radians.

    A calibration that has changed shows in every place; iron beside the way shows in one. With two
    visits it cannot be decided which of them it is.
    """
    visits, index, counts = np.unique(visit, return_inverse=True, return_counts=True)
    if len(visits) < 3:
        return 0.0
    squares = np.bincount(index.ravel(), deviation**2)
    others = (squares.sum() - squares) / (counts.sum() - counts)
    return math.sqrt(max(float(np.mean(deviation**2) - others.min()), 0.0))


def sectors(heading: FloatArray, bins: int) -> IntArray:
    """Return the sector of each heading, shape (n,)."""
    return np.asarray((np.mod(heading, math.tau) * (bins / math.tau)).astype(np.int64) % bins)


def _unrepeated(swing: GyroSwing, bins: int) -> float:
    """Return the RMS of compass less gyro about its mean at each heading, radians."""
    sector = sectors(swing.heading, bins)
    count = np.maximum(np.bincount(sector, minlength=bins), 1)
    middle = np.bincount(sector, swing.deviation, bins) / count
    return math.sqrt(float(np.mean((swing.deviation - middle[sector]) ** 2)))


def own_swings(calibration: Calibration, up: FloatArray) -> dict[Figure, float]:
    """Return the swings around a turn by the calibration's own uncertainty, one sigma.

    Hard iron and installation are correlated: a shift along the turn's axis by one is compensated
    by the other, and neither swings. What is the same at all headings is no swing. `up` (3,) is
    unit in body axes: the turn's plane is across it.
    """
    angles = np.arange(HEADINGS) * (math.tau / HEADINGS)
    across = np.linalg.svd(up[None])[2][1:]
    ahead = np.column_stack([np.cos(angles), np.sin(angles)]) @ across
    level, upright = math.cos(calibration.inclination), -math.sin(calibration.inclination)
    towards = level * ahead + upright * up
    around = np.cross(up, ahead)
    field = calibration.strength * towards

    def swing(gradient: FloatArray) -> float:
        rows = by_twelve(calibration.correction, field, gradient / calibration.strength)
        return rms_sigma(rows - rows.mean(axis=0), calibration.covariance)

    steepest = max(level, 1e-3)
    return {
        Figure.HEADING_SWING: swing(ahead / steepest),
        Figure.GYRO_COMPASS_DIFFERENCE: swing(around / steepest),
        Figure.STRENGTH_SPREAD: swing(towards),
        Figure.DIP_SPREAD: swing(upright * ahead - level * up),
    }


def scatter_of_means(values: FloatArray, around: IntArray, visit: IntArray) -> float:
    """Return by how much the means over headings may vary because each was seen so rarely.

    Zero where no heading was visited twice. A few visits estimate the variation between places with
    an uncertainty of its own: this is its upper 95% bound by an F test, with the first two
    harmonics of the heading as the swing, and all headings of one visit as a single observation.
    `values`, `around` (sector) and `visit` are (n,).
    """
    cells, index, counts = np.unique(
        np.column_stack([around, visit]), axis=0, return_inverse=True, return_counts=True
    )
    means = np.bincount(index.ravel(), values) / counts
    sector = cells[:, 0]
    visits = np.bincount(sector)
    middle = np.bincount(sector, means) / np.maximum(visits, 1)
    squares = float(np.sum((means - middle[sector]) ** 2))
    filled = visits[visits > 0]
    freedom = int(np.sum(filled - 1))
    independent = freedom * len(np.unique(visit)) / len(cells)
    if independent < 1.0:
        return 0.0
    # The node loads this module for its watch, and does without scipy.
    from scipy.special import fdtri

    quantile = float(fdtri(HARMONICS, independent, LIKELY))
    return math.sqrt(quantile * squares / freedom * float(np.mean(1.0 / filled)))


def check_beside_chance(
    bound: Bound, figure: float, chance: float, before: float | None, decided: bool = False
) -> Check:
    """Grade the part of a figure that chance does not explain.

    Where chance alone reaches the bound of stale, the turn is inconclusive: doubtful, unless the
    figure is small, or the drive itself has shown whether iron was added (`decided`).
    """
    excess = math.sqrt(max(figure**2 - chance**2, 0.0))
    seen = chance * bound.scale
    note = f", of which chance may be {shown(seen)}{bound.unit}" if seen > 0.5 * bound.good else ""
    if note and chance >= figure:
        note = ", no more than chance explains"
    check = bound.check(figure, excess=excess, note=note, before=before)
    is_small = figure * bound.scale <= bound.good
    if decided or is_small or seen <= bound.warn or check.grade.rank >= Grade.WARN.rank:
        return check
    words = f"{check.words}: too uncertain to judge; turn once, in one place away from iron"
    return Check(
        check.figure, check.aspect, Grade.WARN, words, check.value, check.before, check.bound
    )


def gyro_compass(
    window: Window, up: FloatArray, yaw: FloatArray, heading: FloatArray, tuning: RecheckTuning
) -> tuple[GyroSwing, IntArray] | None:
    """Return how the compass swings against the gyro, and in which rows; None without a comparison.

    `up` (n, 3) is unit in body axes. `yaw` (n,) is by the compass that is tried, `heading` (n,)
    where the robot looked as far as is known, radians.
    """
    pieces = _pieces(window, up, tuning)
    if window.angular_rate is None or not pieces:
        return None
    across = np.maximum(1.0 - up[:, 0] ** 2, 1.0 - tuning.steepest_nose)
    rate = np.sum(window.angular_rate[:, 1:] * up[:, 1:], axis=1) / across
    steps = 0.5 * np.diff(window.time) * (rate[1:] + rate[:-1])
    turned = np.concatenate([[0.0], np.cumsum(steps)])
    error = compass_less_gyro(window.time, yaw, turned, heading, pieces)
    rms = math.sqrt(float(np.mean(error**2)))
    rows = np.concatenate(pieces)
    return GyroSwing(heading[rows], error, rms), rows


def compass_less_gyro(
    time: FloatArray,
    yaw: FloatArray,
    turned: FloatArray,
    heading: FloatArray,
    pieces: list[IntArray],
) -> FloatArray:
    """Return compass less gyro, one offset a piece and one steady bias removed, in (-pi, pi].

    Each sample is compared by itself, as an angle: beside iron that cancels the level field the
    compass may go once round, and is right again afterwards. The gyro's bias turns far less than
    that within a piece. Over a single turn a periodic error resembles a bias in part: the bias is
    fitted together with two harmonics of the heading, and only the bias is removed. Less than a
    turn cannot separate them.

    `time` (s) and the angles of compass, gyro and heading are (n,); `pieces` are the rows over
    which the gyro propagates the heading.
    """
    orders = (1, 2) if Coverage.of(heading).is_complete else ()
    waves = [wave(k * heading) for k in orders for wave in (np.cos, np.sin)]
    basis = np.column_stack([time, *waves])
    design, residuals = [], []
    for rows in pieces:
        gap = yaw[rows] - turned[rows]
        residual = wrap_angle(gap - np.angle(np.mean(np.exp(1j * gap))))
        residuals.append(residual - residual.mean())
        design.append(basis[rows] - basis[rows].mean(axis=0))
    a, b = np.concatenate(design), np.concatenate(residuals)
    bias = float(np.linalg.lstsq(a, b, rcond=None)[0][0])
    bias = min(max(bias, -COVERAGE.largest_gyro_bias), COVERAGE.largest_gyro_bias)
    return wrap_angle(b - bias * a[:, 0])


def _pieces(window: Window, up: FloatArray, tuning: RecheckTuning) -> list[IntArray]:
    """Return the stretches of rows over which gyro and compass are compared."""
    good = up[:, 0] ** 2 < tuning.steepest_nose
    spell = np.floor((window.time - window.time[0]) / tuning.longest_piece)
    unheard = np.diff(window.time) > STREAMS.longest_gyro_step
    parted = unheard | (np.diff(spell) > 0) | ~good[1:] | ~good[:-1]
    pieces = np.split(np.arange(len(window)), np.flatnonzero(parted) + 1)
    return [rows for rows in pieces if len(rows) > 2]
