"""Offset and scale of each axis from its smallest and largest reading.

The offset is the middle of an axis' range; the scale brings half the range of every axis to the
mean of the three, or to the field's strength if that is known. The sensor must be tumbled until
each axis has pointed along the field and against it. Its axes must be orthogonal and parallel to
those of the IMU.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from magcal_ros.core.calibration.calibration import Estimate
from magcal_ros.core.calibration.figure import along
from magcal_ros.core.errors import Reason, Refusal
from magcal_ros.core.geometry.arrays import BoolArray, FloatArray
from magcal_ros.core.knowledge import Knowledge
from magcal_ros.core.methods.methods_tuning import CLOUD, MIN_MAX
from magcal_ros.core.methods.tumbling import Shape, finish, on_unit_sphere
from magcal_ros.core.samples.window import Window


@dataclass(frozen=True)
class Options:
    """Choices of the min/max method."""

    robust: bool = False
    """Whether to leave out samples that are not on a common ellipsoid along the axes. Samples are
    sorted into cells that count once each, because quantiles of all samples would depend on how
    long the sensor rested in each orientation."""


def fit(
    window: Window, knowledge: Knowledge = Knowledge(), *, options: Options = Options()
) -> Estimate:
    """Calibrate by the extremes of each axis.

    The sensor must be tumbled through all orientations. Without a known strength the correction
    keeps the mean of the half ranges. Figures are in nominal body axes. The covariance comes from a
    jackknife over pieces of time, and from the mounting as far as gravity shows it. Raises
    `Refusal` if the samples do not determine a solution.
    """
    remedy = "Tumble again away from iron, or fit a rotated ellipsoid."
    if not options.robust:
        remedy = "Use the robust variant if single samples are off, or fit a rotated ellipsoid."
    return finish(
        lambda nominal: solve(nominal, options),
        window,
        knowledge,
        method="min_max",
        least_extent=MIN_MAX.least_extent,
        remedy=remedy,
    )


def solve(nominal: FloatArray, options: Options) -> Shape:
    """Return offset and scale of each axis. Raises `Refusal` if the range of an axis is small."""
    kept = (
        samples_on_ellipsoid(nominal) if options.robust else np.ones(len(nominal), dtype=np.bool_)
    )
    low, high = nominal[kept].min(axis=0), nominal[kept].max(axis=0)
    offset, half_range = 0.5 * (low + high), 0.5 * (high - low)
    if half_range.min() < MIN_MAX.smallest_range * half_range.max():
        axis = "xyz"[int(half_range.argmin())]
        raise Refusal(
            Reason.PLANAR,
            f"The {axis} axis covered only {half_range.min() / half_range.max():.0%} of the range "
            "of another axis: its offset cannot be determined. Tumble the sensor until every "
            "axis has pointed along the field and against it, or use a method for turns about "
            "one axis.",
        )
    figures = along("offset", offset) | along("half_range", half_range)
    return Shape(offset, np.diag(1.0 / half_range), float(half_range.mean()), figures)


def samples_on_ellipsoid(nominal: FloatArray) -> BoolArray:
    """Return which samples (n,) are on a common axis-aligned ellipsoid, also if they cluster.

    The field (n, 3) is in nominal axes, tesla.
    """
    size = np.maximum(np.ptp(nominal, axis=0).max(), 1e-300) / MIN_MAX.cells
    # One sample of each cell: an orientation in which the sensor rested counts once.
    single = nominal[np.unique(np.round(nominal / size), axis=0, return_index=True)[1]]
    share = MIN_MAX.starting_quantile
    low, high = np.quantile(single, [share, 1.0 - share], axis=0)
    kept = np.ones(len(single), dtype=np.bool_)
    for _ in range(CLOUD.rounds):
        centre, half = 0.5 * (low + high), np.maximum(0.5 * (high - low), 1e-300)
        distance = np.linalg.norm((single - centre) / half, axis=1)
        near = on_unit_sphere(distance)
        if not near.any() or (near == kept).all():
            break
        kept = near
        low, high = single[kept].min(axis=0), single[kept].max(axis=0)
    return on_unit_sphere(np.linalg.norm((nominal - centre) / half, axis=1), distance)
