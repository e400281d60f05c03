"""Offset and scale of each axis from its smallest and largest reading.

The offset is the middle of an axis' range; the scale brings half the range of every axis to the
mean of the three, or to the field's strength where that is known. It needs a sensor that was
tumbled until each axis pointed along the field and against it, and axes that neither lean on each
other nor on the IMU's.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from magcal_ros.core.calibration.calibration import Estimate
from magcal_ros.core.calibration.figure import along
from magcal_ros.core.errors import Reason, Refusal
from magcal_ros.core.geometry.arrays import BoolArray, FloatArray
from magcal_ros.core.knowledge import Knowledge
from magcal_ros.core.methods.tumbling import (
    CLOUD,
    Shape,
    TumblingOptions,
    finish,
    nominal_field,
)
from magcal_ros.core.samples.window import Window


@dataclass(frozen=True)
class MinMaxTuning:
    """Bounds of the ranges, and the cells in which robust extremes are counted."""

    smallest_range: float = 0.5
    """Smallest over largest range of an axis; below it one axis was never along the field."""
    least_extent: float = 1.6
    """Extent of the unit sphere, 2 for all of it, that must be seen in every direction."""
    direction_cells: float = 4.0
    """Half the number of cells along an edge of the cube on which directions are sorted."""
    space_cells: float = 12.0
    """Number of cells along the range of an axis."""
    starting_quantile: float = 0.05
    """Share of the cells left out at either end of an axis at the start."""


TUNING = MinMaxTuning()


@dataclass(frozen=True)
class Options(TumblingOptions):
    """Choices of the min/max method, besides those of `TumblingOptions`."""

    robust: bool = False
    """Whether to leave out samples that are not on a common sphere. Quantiles of the samples would
    move towards the orientation in which the sensor rested longest; so samples are sorted into
    cells of direction, each of which counts once."""


def fit(
    window: Window, knowledge: Knowledge = Knowledge(), *, options: Options = Options()
) -> Estimate:
    """Calibrate by the extremes of each axis.

    The sensor has to be tumbled through all orientations. Without a known strength the correction
    keeps the mean of the half ranges. Figures are in nominal body axes. The covariance comes from
    leaving out pieces of time, and from the mounting as far as gravity shows it. Raises `Refusal`
    if the samples do not determine an answer.
    """
    remedy = "Tumble again away from iron, or fit a rotated ellipsoid."
    if not options.robust:
        remedy = "Use the robust variant if single samples are off, or fit a rotated ellipsoid."
    return finish(
        lambda part, known: solve(part, known, options),
        window,
        knowledge,
        options,
        method="min_max",
        least_extent=TUNING.least_extent,
        remedy=remedy,
    )


def solve(window: Window, knowledge: Knowledge, options: Options) -> Shape:
    """Return offset and scale of each axis. Raises `Refusal` if the range of one is too small."""
    nominal = nominal_field(window, knowledge)
    kept = (
        samples_on_ellipsoid(nominal) if options.robust else np.ones(len(nominal), dtype=np.bool_)
    )
    low, high = nominal[kept].min(axis=0), nominal[kept].max(axis=0)
    offset, half_range = 0.5 * (low + high), 0.5 * (high - low)
    if half_range.min() < TUNING.smallest_range * half_range.max():
        axis = "xyz"[int(half_range.argmin())]
        raise Refusal(
            Reason.PLANAR,
            f"The {axis} axis saw only {half_range.min() / half_range.max():.0%} of the range of "
            "another: its offset is not determined. Tumble the sensor until every axis has pointed "
            "along the field and against it, or use a method for turns about one axis.",
        )
    figures = along("offset", offset) | along("half_range", half_range)
    return Shape(offset, np.diag(1.0 / half_range), float(half_range.mean()), figures)


def samples_on_ellipsoid(nominal: FloatArray) -> BoolArray:
    """Return which samples (n,) are on one common, axis-aligned ellipsoid, however they cluster.

    The field (n, 3) is in nominal axes, tesla.
    """
    low, high = _starting_range(nominal)
    kept = np.ones(len(nominal), dtype=np.bool_)
    for _ in range(CLOUD.rounds):
        points = (nominal - 0.5 * (low + high)) / np.maximum(0.5 * (high - low), 1e-300)
        distance = np.linalg.norm(points, axis=1)
        # Each cell of direction has one vote, however full it is.
        on_cube = points / np.maximum(np.abs(points).max(axis=1, keepdims=True), 1e-300)
        believed = _near_the_usual(distance, _one_vote_each(TUNING.direction_cells * on_cube))
        if not believed.any() or (believed == kept).all():
            break
        kept = believed
        low, high = nominal[kept].min(axis=0), nominal[kept].max(axis=0)
    return kept


def _starting_range(nominal: FloatArray) -> tuple[FloatArray, FloatArray]:
    size = np.maximum(np.ptp(nominal, axis=0).max(), 1e-300) / TUNING.space_cells
    weights = _one_vote_each(nominal / size)
    ends = [
        [_weighted_quantile(axis, weights, share) for axis in nominal.T]
        for share in (TUNING.starting_quantile, 1.0 - TUNING.starting_quantile)
    ]
    return np.array(ends[0]), np.array(ends[1])


def _one_vote_each(coordinates: FloatArray) -> FloatArray:
    cells = np.unique(np.round(coordinates), axis=0, return_inverse=True)[1].ravel()
    return np.asarray(1.0 / np.bincount(cells)[cells])


def _near_the_usual(distance: FloatArray, weights: FloatArray) -> BoolArray:
    usual = _weighted_quantile(distance, weights, 0.5)
    off = np.abs(distance - usual)
    gate = CLOUD.outlier_deviations * 1.4826 * _weighted_quantile(off, weights, 0.5)
    return np.asarray(off <= max(gate, CLOUD.least_gate * usual))


def _weighted_quantile(values: FloatArray, weights: FloatArray, share: float) -> float:
    order = np.argsort(values)
    reached = np.cumsum(weights[order])
    return float(values[order][int(np.searchsorted(reached, share * reached[-1]))])
