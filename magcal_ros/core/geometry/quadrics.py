"""Spheres and ellipsoids through points of space.

As with the conics, points are first moved to their centroid and scaled to unit size: the form that
fixes the constant at -1 is singular for a surface through the origin, and a centroid lies inside
every ellipsoid.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum

import numpy as np

from magcal_ros.core.errors import Reason, Refusal
from magcal_ros.core.geometry.arrays import FloatArray, centred, frozen_array


@dataclass(frozen=True)
class QuadricTuning:
    """Which clouds have no ellipsoid."""

    thinnest: float = 1e-6
    """Clouds thinner than this share of their length lie on a plane, a line or a point."""
    largest_radius: float = 1e3
    """Radii beyond this many times the cloud's own size are a plane, too."""


QUADRICS = QuadricTuning()


class QuadricFit(str, Enum):
    """The shapes by name."""

    ROTATED = "rotated"
    ALIGNED = "aligned"
    SPHERE = "sphere"


@dataclass(frozen=True, eq=False)
class Ellipsoid:
    """An ellipsoid."""

    centre: FloatArray
    """In the points' unit. Shape (3,)."""
    radii: FloatArray
    """Half axes. Shape (3,)."""
    axes: FloatArray
    """A rotation; its columns are the directions of the half axes, in the order of `radii`. Shape
    (3, 3)."""

    def __post_init__(self) -> None:
        for name, shape in (("centre", (3,)), ("radii", (3,)), ("axes", (3, 3))):
            object.__setattr__(self, name, frozen_array(getattr(self, name), shape, name))

    @property
    def radius(self) -> float:
        """Geometric mean of the half axes: the radius of the sphere of the same volume."""
        return float(np.exp(np.log(self.radii).mean()))

    @property
    def to_unit_sphere(self) -> FloatArray:
        """The symmetric S that takes points from the centre onto the unit sphere, (3, 3)."""
        return np.asarray((self.axes / self.radii) @ self.axes.T)


def fit_quadric(points: FloatArray, shape: QuadricFit = QuadricFit.ROTATED) -> Ellipsoid:
    """Fit an ellipsoid by linear least squares, pᵀQp + 2bᵀp = 1.

    Parameters
    ----------
    points : ndarray, shape (n, 3)
        In any unit.
    shape : QuadricFit
        Q with six free elements, diagonal, or a multiple of one.

    Raises
    ------
    Refusal
        For too few points, a plane, numbers not finite, or a surface that is no ellipsoid.
    """
    least = {QuadricFit.ROTATED: 9, QuadricFit.ALIGNED: 6, QuadricFit.SPHERE: 4}[shape]
    centroid, moved = centred(points, least, "surface")
    spread = np.linalg.svd(moved, compute_uv=False) / math.sqrt(len(points))
    if spread[2] <= QUADRICS.thinnest * spread[0]:
        raise _planar()
    size = float(np.linalg.norm(spread))
    moved /= size
    design = np.column_stack([_quadratic_columns(moved, shape), 2.0 * moved])
    solution, _, rank, _ = np.linalg.lstsq(design, np.ones(len(points)), rcond=1e-10)
    if rank < design.shape[1]:
        raise _planar()
    form, linear = _form([float(v) for v in solution[:-3]], shape), solution[-3:]
    values, axes = np.linalg.eigh(form)
    if shape is not QuadricFit.ROTATED:
        values, axes = np.diag(form), np.eye(3)
    if np.abs(values).min() <= QUADRICS.largest_radius**-2:
        raise _no_ellipsoid()
    centre = -np.linalg.solve(form, linear)
    squares = (1.0 + float(centre @ form @ centre)) / values
    if not (squares > 0.0).all() or squares.max() > QUADRICS.largest_radius**2:
        raise _no_ellipsoid()
    if np.linalg.det(axes) < 0.0:
        axes = -axes
    return Ellipsoid(centroid + size * centre, size * np.sqrt(squares), axes)


def _quadratic_columns(points: FloatArray, shape: QuadricFit) -> FloatArray:
    squares = points**2
    if shape is QuadricFit.SPHERE:
        return np.asarray(squares.sum(axis=1, keepdims=True))
    if shape is QuadricFit.ALIGNED:
        return np.asarray(squares)
    x, y, z = points.T
    return np.column_stack([squares, 2.0 * x * y, 2.0 * x * z, 2.0 * y * z])


def _form(coefficients: list[float], shape: QuadricFit) -> FloatArray:
    if shape is QuadricFit.SPHERE:
        return np.asarray(coefficients[0] * np.eye(3))
    if shape is QuadricFit.ALIGNED:
        return np.asarray(np.diag(np.array(coefficients)))
    xx, yy, zz, xy, xz, yz = coefficients
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def _planar() -> Refusal:
    return Refusal(
        Reason.PLANAR,
        "The samples lie on a plane: no ellipsoid can be fitted to them. Tumble the sensor through "
        "all orientations, or use a method for turns about one axis.",
    )


def _no_ellipsoid() -> Refusal:
    return Refusal(
        Reason.NO_SOLUTION,
        "The samples fit an open surface (a hyperboloid or a cylinder) better than an ellipsoid. "
        "Tumble the sensor through all orientations, away from iron.",
    )
