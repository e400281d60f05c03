"""The assumptions of the methods: each number with its unit and its reason."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class TipTuning:
    """Which turns the geometry determines."""

    largest_normal_sigma: float = math.radians(10.0)
    """Largest sigma of the field plane's normal, radians."""
    largest_thickness: float = 0.25
    """RMS distance from the plane over the radius of the circle; a tumble has more."""
    smallest_axial_gravity: float = math.cos(math.radians(75.0))
    """Cosine between axis and vertical. The error of the inclination is divided by it."""
    clear_sense: float = 20.0
    """Standard errors from which gravity determines the sense of rotation. It is large because
    wobble is correlated; below it, the smaller installation is chosen."""
    smallest_lever: float = math.sin(math.radians(10.0))
    """Length of the axis perpendicular to body y; below it the pitch is a rotation about the axis
    and not observable."""
    strength_margin: float = 0.1
    """Relative misfit of the strength, above the best one, up to which an installation fits; and
    the largest relative excess of the circle's radius over the strength."""
    rival_margin: float = math.radians(2.0)
    """Difference of size up to which a rival installation counts as equally likely, radians."""
    axial_sigma: float = 50e-6
    """Tesla, prior of the hard iron along the axis if neither strength nor inclination is known."""


@dataclass(frozen=True)
class EllipsoidTuning:
    """Which clouds count as an ellipsoid."""

    least_extent: float = 0.9
    """Extent of the unit sphere, 2 for all of it, that must be seen in every direction."""
    largest_ratio: float = 3.0
    """Longest over shortest radius; larger soft iron makes a compass unusable."""


@dataclass(frozen=True)
class MinMaxTuning:
    """Bounds of the ranges, and the cells in which robust extremes are counted."""

    smallest_range: float = 0.5
    """Smallest over largest range of an axis; below it one axis was never along the field."""
    least_extent: float = 1.6
    """Extent of the unit sphere, 2 for all of it, that must be seen in every direction."""
    cells: float = 12.0  # number of cells along the longest range of an axis
    starting_quantile: float = 0.05
    """Fraction of the cells left out at either end of an axis at the start."""


@dataclass(frozen=True)
class CloudTuning:
    """Bounds of the field samples of a tumbled sensor."""

    fewest_samples: int = 40
    thinnest_cloud: float = 0.15
    """Smallest over largest standard deviation of a cloud; below it is a plane with noise."""
    outlier_deviations: float = 5.0
    """Robust standard deviations from the median distance beyond which a sample is an outlier."""
    rounds: int = 10  # most times that outliers are left out and the rest is fitted again
    installation_sigma: float = math.radians(3.0)
    """Prior of the magnetometer's rotation against the IMU, radians per axis."""


TIP = TipTuning()
ELLIPSOID = EllipsoidTuning()
MIN_MAX = MinMaxTuning()
CLOUD = CloudTuning()
