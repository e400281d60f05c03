"""Planes (the three fits of the ST design tip DT0103) and circles through points of space.

The sign of a normal is arbitrary; it depends on the sense of rotation, which the caller knows.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import Enum

import numpy as np

from magcal_ros.core.errors import Reason, Refusal
from magcal_ros.core.geometry.arrays import FloatArray, centred, freeze
from magcal_ros.core.geometry.conics import THINNEST, taubin_circle

ROBUST_ROUNDS = 4  # rounds of reweighting


@dataclass(frozen=True, eq=False)
class Circle:
    """A circle in space."""

    centre: FloatArray  # in the unit of the points. Shape (3,).
    basis: FloatArray
    """Rows: two axes in the plane and the normal, unit, right-handed. Shape (3, 3)."""
    radius: float  # in the unit of the points

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
    """Fit a circle, its normal towards `upwards` (3,); a `Refusal` of few points or of a line."""
    away = centred(points, 3, "circle")[1]
    spread = np.linalg.svd(away, compute_uv=False)
    _refuse_degenerate(np.asarray(spread[::-1]), points.mean(axis=0))
    circle = fit_circle_robustly(points)
    # Turned by half a turn about the first axis: the basis stays right-handed.
    flipped = circle.basis * np.array([[1.0], [-1.0], [-1.0]])
    return circle if circle.normal @ upwards >= 0.0 else replace(circle, basis=flipped)


def fit_circle_robustly(points: FloatArray) -> Circle:
    """Fit plane and circle to points (n, 3) by Cauchy weights; the normal has either sign."""
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
    share = weight / weight.sum()
    mean = share @ points
    away = points - mean
    normal, first, second = np.linalg.eigh((away * share[:, None]).T @ away)[1].T
    plane = np.stack([first, second], axis=1)
    centre, radius = taubin_circle(away @ plane, share)
    return Circle(mean + plane @ centre, np.stack([first, np.cross(normal, first), normal]), radius)


SMALLEST = 1e-9  # clouds smaller than this share of their distance from the origin are one point


@dataclass(frozen=True, eq=False)
class Plane:
    """A plane through a cloud."""

    normal: FloatArray  # unit, of either sign, shape (3,)
    scatter: FloatArray
    """Mean outer product of the centred points, in the points' unit squared. Shape (3, 3)."""
    count: int  # number of points

    def __post_init__(self) -> None:
        freeze(self, normal=(3,), scatter=(3, 3))

    @property
    def spread(self) -> FloatArray:
        """Standard deviations along the principal axes, smallest first, shape (3,)."""
        return np.asarray(np.sqrt(np.maximum(np.linalg.eigvalsh(self.scatter), 0.0)))

    @property
    def thickness(self) -> float:
        """Root mean square distance of the points from the plane."""
        return float(np.sqrt(max(float(self.normal @ self.scatter @ self.normal), 0.0)))

    def normal_information(self, least_noise: float) -> FloatArray:
        """Return the inverse covariance of the normal's direction, shape (3, 3), per rad².

        For an in-plane principal axis of variance l and a variance t across the plane it is
        n (l - t)² / (l t): perturbation theory of the eigenvectors. It falls smoothly to zero
        where the cloud becomes round.

        `least_noise` is the floor of the noise's standard deviation, in the points' unit; positive.
        """
        across = max(self.thickness, least_noise) ** 2
        in_plane = np.eye(3) - np.outer(self.normal, self.normal)
        variances, axes = np.linalg.eigh(in_plane @ self.scatter @ in_plane)
        excess = np.maximum(variances - across, 0.0)
        information = self.count * excess**2 / (np.maximum(variances, across) * across)
        return np.asarray((axes * information) @ axes.T)

    def normal_sigma(self, least_noise: float) -> float:
        """Return the normal's larger sigma, radians; infinite where the cloud is not flat."""
        middle = float(np.linalg.eigvalsh(self.normal_information(least_noise))[1])
        return float(1.0 / np.sqrt(middle)) if middle > 0.0 else np.inf


class PlaneFit(str, Enum):
    """The plane fits by name; the two by eigenvalues are the same here."""

    LEAST_SQUARES = "least_squares"
    EIGEN = "eigen"
    EIGEN_SIMPLE = "eigen_simple"

    def __call__(self, points: FloatArray) -> Plane:
        """Fit a plane.

        Raises `Refusal` if the points (n, 3) are not finite, or are one point or a line.
        """
        centre, moved = centred(points, 3, "plane")
        values, axes = np.linalg.svd(moved, full_matrices=False)[1:]
        _refuse_degenerate(values[::-1] / np.sqrt(len(points)), centre)
        scatter = moved.T @ moved / len(points)
        normal = _regressed(scatter) if self is PlaneFit.LEAST_SQUARES else axes[2]
        return Plane(normal, scatter, len(points))


def _regressed(scatter: FloatArray) -> FloatArray:
    """Return the normal by regression along the axis on which it is longest, unit, shape (3,)."""
    # Noise along the other two biases it towards that axis in a thin cloud (regression dilution).
    minors = [np.linalg.det(np.delete(np.delete(scatter, k, 0), k, 1)) for k in range(3)]
    main = int(np.argmax(minors))
    others = [k for k in range(3) if k != main]
    normal = np.ones(3)
    normal[others] = -np.linalg.solve(scatter[np.ix_(others, others)], scatter[others, main])
    return normal / np.linalg.norm(normal)


def _refuse_degenerate(spread: FloatArray, centre: FloatArray) -> None:
    if spread[2] <= SMALLEST * float(np.linalg.norm(centre)) or spread[2] == 0.0:
        words = "All samples are the same point. Turn while the samples are taken."
        raise Refusal(Reason.NO_MOTION, words)
    if spread[1] <= THINNEST * spread[2]:
        words = "The samples lie on a line, which has no plane. Turn further round."
        raise Refusal(Reason.FIELD_ON_A_LINE, words)


def plane_normal(points: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the direction of least spread, unit, and the variances, ascending."""
    centred = points - points.mean(axis=0)
    values, vectors = np.linalg.eigh(centred.T @ centred / len(points))
    return vectors[:, 0], values
