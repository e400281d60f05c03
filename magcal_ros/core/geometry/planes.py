"""Planes through a cloud of points: the three fits of the ST design tip DT0103.

A normal keeps whatever sign the arithmetic gave it. Which of the two is meant is a question of
the sense of rotation, and only the caller knows that.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum

import numpy as np

from magcal_ros.core.errors import Reason, Refusal
from magcal_ros.core.geometry.arrays import FloatArray, centred, frozen_array


@dataclass(frozen=True)
class PlaneTuning:
    """Which clouds have no plane."""

    smallest: float = 1e-9
    """Clouds smaller than this share of their distance from the origin are one point."""
    thinnest: float = 1e-6
    """Clouds narrower than this share of their length are a line."""


PLANES = PlaneTuning()


@dataclass(frozen=True, eq=False)
class Plane:
    """A plane through a cloud."""

    normal: FloatArray
    """Unit, of either sign. Shape (3,)."""
    centre: FloatArray
    """Mean of the points, which lies on the plane. Shape (3,)."""
    scatter: FloatArray
    """Mean outer product of the centred points, in the points' unit squared. Shape (3, 3)."""
    count: int
    """Number of points."""

    def __post_init__(self) -> None:
        for name, shape in (("normal", (3,)), ("centre", (3,)), ("scatter", (3, 3))):
            object.__setattr__(self, name, frozen_array(getattr(self, name), shape, name))

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

        Parameters
        ----------
        least_noise : float
            Floor of the noise's standard deviation, in the points' unit; positive.
        """
        across = max(self.thickness, least_noise) ** 2
        in_plane = np.eye(3) - np.outer(self.normal, self.normal)
        variances, axes = np.linalg.eigh(in_plane @ self.scatter @ in_plane)
        excess = np.maximum(variances - across, 0.0)
        information = self.count * excess**2 / (np.maximum(variances, across) * across)
        return np.asarray((axes * information) @ axes.T)

    def normal_sigma(self, least_noise: float) -> float:
        """Return the larger standard deviation of the normal's direction in radians.

        It is infinite where the cloud is not flat at all.
        """
        middle = float(np.linalg.eigvalsh(self.normal_information(least_noise))[1])
        return float(1.0 / np.sqrt(middle)) if middle > 0.0 else np.inf


def _fit_least_squares(points: FloatArray) -> Plane:
    """Fit by least squares along the axis on which the normal is longest.

    Noise across the other two axes is taken for signal, so a thin cloud pulls the normal towards
    that axis (regression dilution).
    """
    centre, moved = centred(points, 3, "plane")
    scatter = moved.T @ moved / len(points)
    _refuse_degenerate(np.sqrt(np.maximum(np.linalg.eigvalsh(scatter), 0.0)), centre)
    minors = [np.linalg.det(np.delete(np.delete(scatter, k, 0), k, 1)) for k in range(3)]
    main = int(np.argmax(minors))
    others = [k for k in range(3) if k != main]
    normal = np.ones(3)
    normal[others] = -np.linalg.solve(scatter[np.ix_(others, others)], scatter[others, main])
    return Plane(normal / np.linalg.norm(normal), centre, scatter, len(points))


def _fit_eigen(points: FloatArray) -> Plane:
    """Fit by least squares of the distances from the plane.

    The singular vectors of the centred points are the eigenvectors of their scatter, found
    without squaring the numbers.
    """
    centre, moved = centred(points, 3, "plane")
    values, axes = np.linalg.svd(moved, full_matrices=False)[1:]
    _refuse_degenerate(values[::-1] / np.sqrt(len(points)), centre)
    return Plane(axes[2], centre, moved.T @ moved / len(points), len(points))


def _fit_eigen_simple(points: FloatArray) -> Plane:
    """Fit as `_fit_eigen` does from six running sums, as a microcontroller would."""
    centre, moved = centred(points, 3, "plane")
    scatter = moved.T @ moved / len(points)
    values, axes = np.linalg.eigh(scatter)
    _refuse_degenerate(np.sqrt(np.maximum(values, 0.0)), centre)
    return Plane(axes[:, 0], centre, scatter, len(points))


class PlaneFit(str, Enum):
    """The plane fits by name."""

    LEAST_SQUARES = "least_squares"
    EIGEN = "eigen"
    EIGEN_SIMPLE = "eigen_simple"

    def __call__(self, points: FloatArray) -> Plane:
        """Fit a plane.

        Parameters
        ----------
        points : ndarray, shape (n, 3)
            The cloud, in any unit.

        Raises
        ------
        Refusal
            If the points are not finite, or are one point or a line.
        """
        return _FITS[self](points)


_FITS: dict[PlaneFit, Callable[[FloatArray], Plane]] = {
    PlaneFit.LEAST_SQUARES: _fit_least_squares,
    PlaneFit.EIGEN: _fit_eigen,
    PlaneFit.EIGEN_SIMPLE: _fit_eigen_simple,
}


def _refuse_degenerate(spread: FloatArray, centre: FloatArray) -> None:
    if spread[2] <= PLANES.smallest * float(np.linalg.norm(centre)) or spread[2] == 0.0:
        raise Refusal(
            Reason.NO_MOTION, "All samples are the same point. Turn while the samples are taken."
        )
    if spread[1] <= PLANES.thinnest * spread[2]:
        raise Refusal(
            Reason.FIELD_ON_A_LINE,
            "The samples lie on a line, which has no plane. Turn further round.",
        )


def plane_normal(points: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the direction of least spread, unit, and the variances, ascending."""
    centred = points - points.mean(axis=0)
    values, vectors = np.linalg.eigh(centred.T @ centred / len(points))
    return vectors[:, 0], values
