"""Plane and circle through the raw field, robustly: the ground the starts stand on."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from magcal_ros.core.arrays import FloatArray

ROBUST_ROUNDS = 4


@dataclass(frozen=True, eq=False)
class Circle:
    """A circle in space.

    Parameters
    ----------
    centre : ndarray, shape (3,)
    radius : float
    normal : ndarray, shape (3,)
        Unit; its sign is open.
    """

    centre: FloatArray
    radius: float
    normal: FloatArray


def fit_circle(points: FloatArray) -> Circle:
    """Fit a plane by principal axes and a circle in it by Taubin's method.

    A few rounds of Cauchy weights keep outliers from steering the starts.

    Parameters
    ----------
    points : ndarray, shape (n, 3)
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


def plane_normal(points: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the direction of least spread, unit, and the variances, ascending."""
    centred = points - points.mean(axis=0)
    values, vectors = np.linalg.eigh(centred.T @ centred / len(points))
    return vectors[:, 0], values


def _weighted_circle(points: FloatArray, weight: FloatArray) -> Circle:
    total = weight.sum()
    mean = weight @ points / total
    centred = points - mean
    _, vectors = np.linalg.eigh((centred * weight[:, None]).T @ centred / total)
    plane = vectors[:, 1:]
    centre, radius = _taubin(centred @ plane, weight / total)
    return Circle(mean + plane @ centre, radius, vectors[:, 0])


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
