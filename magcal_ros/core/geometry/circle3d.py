"""A circle in space: where the field of a turning robot lies."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from magcal_ros.core.geometry.arrays import FloatArray
from magcal_ros.core.geometry.attitude import unit
from magcal_ros.core.geometry.conics import ConicFit

ROBUST_ROUNDS = 4
"""Of reweighting; what is left of an outlier after them steers nothing."""


@dataclass(frozen=True, eq=False)
class Circle:
    """A circle in space."""

    centre: FloatArray
    """In the unit of the points. Shape (3,)."""
    basis: FloatArray
    """Rows: two axes in the plane and the normal, unit, right-handed. Shape (3, 3)."""
    radius: float
    """In the unit of the points."""

    @property
    def normal(self) -> FloatArray:
        """Unit, shape (3,)."""
        return np.asarray(self.basis[2])

    def phase(self, points: FloatArray) -> FloatArray:
        """Return the angles (n,) of points (n, 3) about the normal, radians."""
        across = (points - self.centre) @ self.basis[:2].T
        return np.asarray(np.arctan2(across[:, 1], across[:, 0]))

    def at(self, phase: FloatArray) -> FloatArray:
        """Return the points (n, 3) at angles (n,)."""
        around = np.stack([np.cos(phase), np.sin(phase)], axis=-1)
        return np.asarray(self.centre + self.radius * around @ self.basis[:2])


def fit_circle_in_space(points: FloatArray, upwards: FloatArray) -> Circle:
    """Fit the plane of least spread and Taubin's circle in it.

    Parameters
    ----------
    points : ndarray, shape (n, 3)
        In any unit.
    upwards : ndarray, shape (3,)
        The side to which the normal shall point.

    Raises
    ------
    Refusal
        If the points are too few, on a line, or one point.
    """
    middle = points.mean(axis=0)
    centred = points - middle
    axes = np.linalg.eigh(centred.T @ centred)[1]
    normal = axes[:, 0] if axes[:, 0] @ upwards >= 0.0 else -axes[:, 0]
    first = unit(np.cross(normal, axes[:, 1]))
    basis = np.stack([first, np.cross(normal, first), normal])
    flat = ConicFit.TAUBIN(centred @ basis[:2].T)
    return Circle(middle + flat.centre @ basis[:2], basis, flat.radius)


def fit_circle_robustly(points: FloatArray) -> Circle:
    """Fit the plane of least spread and Taubin's circle in it; the normal's sign is open.

    A few rounds of Cauchy weights keep outliers from steering it.

    Parameters
    ----------
    points : ndarray, shape (n, 3)
        In any unit.

    Returns
    -------
    Circle
        Of radius zero where the points are one.
    """
    weight = np.ones(len(points))
    circle = _weighted_circle(points, weight)
    for _ in range(ROBUST_ROUNDS):
        away = points - circle.centre
        height = away @ circle.normal
        level = np.linalg.norm(away - height[:, None] * circle.normal, axis=1)
        square = height**2 + (level - circle.radius) ** 2
        scale = 2.0 * float(np.median(square)) + 1e-18
        weight = 1.0 / (1.0 + square / scale)
        circle = _weighted_circle(points, weight)
    return circle


def _weighted_circle(points: FloatArray, weight: FloatArray) -> Circle:
    total = weight.sum()
    mean = weight @ points / total
    centred = points - mean
    _, vectors = np.linalg.eigh((centred * weight[:, None]).T @ centred / total)
    plane = vectors[:, 1:]
    centre, radius = _taubin(centred @ plane, weight / total)
    normal, first = vectors[:, 0], vectors[:, 1]
    return Circle(mean + plane @ centre, np.stack([first, np.cross(normal, first), normal]), radius)


def _taubin(xy: FloatArray, weight: FloatArray) -> tuple[FloatArray, float]:
    """Fit a circle to centred points (Taubin 1991, in Chernov's SVD form); weights sum to one."""
    squared = np.sum(xy**2, axis=1)
    mean = float(weight @ squared)
    if mean <= 0.0:
        return np.zeros(2), 0.0
    rows = np.column_stack([(squared - mean) / (2.0 * np.sqrt(mean)), xy])
    _, vectors = np.linalg.eigh((rows * weight[:, None]).T @ rows)
    a, b, c = vectors[:, 0]
    a /= 2.0 * np.sqrt(mean)
    if abs(a) < 1e-12:
        a = 1e-12
    centre = np.array([-b, -c]) / (2.0 * a)
    return centre, float(np.sqrt(centre @ centre + mean))
