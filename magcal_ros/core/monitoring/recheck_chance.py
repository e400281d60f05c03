"""How much the figures of a recheck scatter although the calibration is still good.

Two things do. The calibration was uncertain when it was made, and what its hard iron is off shows
as a swing around the turn. And fields differ from place to place: headings that were seen in other
places have other means, as the visits to one heading tell.
"""

from __future__ import annotations

import math

import numpy as np

from magcal_ros.core.assessment.grading import Bound, Check, Grade, shown
from magcal_ros.core.calibration.calibration import Calibration, GyroSwing, by_twelve
from magcal_ros.core.calibration.figure import Figure
from magcal_ros.core.calibration.heading_sigma import HEADINGS, rms_sigma
from magcal_ros.core.geometry.arrays import FloatArray, IntArray
from magcal_ros.core.geometry.attitude import wrap_angle
from magcal_ros.core.monitoring.monitoring_tuning import RecheckTuning
from magcal_ros.core.samples.coverage import COVERAGE, Coverage
from magcal_ros.core.samples.streams import STREAMS
from magcal_ros.core.samples.window import Window

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
    """Return what chance makes of each figure, in its own unit.

    Parameters
    ----------
    seen : dict of Figure to ndarray, shape (n,)
        What a figure is the spread of, over the same as it.
    visit, around : ndarray of int, shape (n,)
        Stretch of time within which places are alike, and sector of the heading.
    compared : tuple of GyroSwing and ndarray of int, or None
        Compass less gyro, and its rows: what does not come back with the heading is not the
        calibration's.
    own : dict of Figure to float
        Of `own_swings`.
    most : dict of Figure to float
        As much of it as is forgiven: a calibration that was a rough guess and swings is to be made
        again, whether or not anything has changed since.
    bins : int
        Sectors of the heading.
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

    A calibration that has changed is seen in every place; iron beside the way is in one. With two
    visits nothing tells which of them it is.
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
    """Return the swings that the calibration's own uncertainty makes around a turn, one sigma.

    Hard iron and installation are uncertain together: what one shifts along the turn's axis the
    other turns back, and neither swings by it. What is the same at all headings is no swing.

    Parameters
    ----------
    calibration : Calibration
    up : ndarray, shape (3,)
        Unit, body axes: the turn's plane is across it.
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

    Zero where headings were not visited twice: then nothing tells places apart. What few visits
    tell of places is uncertain itself: this is the largest of 19 in 20 by an F test, a swing being
    the first two harmonics of the heading, and the headings of one visit counting as one.

    Parameters
    ----------
    values : ndarray, shape (n,)
    around : ndarray of int, shape (n,)
        Sector of the heading.
    visit : ndarray of int, shape (n,)
        Stretch of time within which places are alike.
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
    """Grade what of a figure chance does not explain.

    Where chance alone reaches the bound of what is stale, the turn does not show it: doubtful,
    unless the figure is small, or the drive itself has shown whether iron was added (`decided`).
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
    """Compare gyro and compass over a window; return how the compass swings, and in which rows.

    None where there is nothing to compare.

    Parameters
    ----------
    window : Window
        The samples.
    up : ndarray, shape (n, 3)
        Unit, body axes.
    yaw, heading : ndarray, shape (n,)
        By the compass that is tried, and where the robot looked as far as is known; radians.
    tuning : RecheckTuning
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
    """Return compass less gyro, one offset a piece and one steady bias removed.

    Each sample is compared by itself, as an angle: beside iron that takes away the level field the
    compass may go once round by itself, and is right again afterwards. The gyro's bias turns far
    less than that within a piece.

    Over a single turn an error that comes and goes with the heading looks like a bias in part:
    the bias is found beside two harmonics of the heading, and only the bias is removed. Less
    than a turn cannot tell them apart.

    Parameters
    ----------
    time, yaw, turned, heading : ndarray, shape (n,)
        Seconds; radians by the compass, by the gyro, and where the robot looked as far as known.
    pieces : list of ndarray of int
        Rows over which the gyro propagates the heading.

    Returns
    -------
    ndarray
        Radians in (-pi, pi], the pieces one after another.
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
