"""Circles in a plane and in space, planes, spheres and ellipsoids.

All fits first move the points to their centroid and scale them to unit size. Forms with a constant
term of -1 are singular for a curve or surface through the origin, but the centroid is always inside
an ellipse or ellipsoid. The sign of a plane's normal is arbitrary; it depends on the sense of
rotation, which the caller knows.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass, replace
from enum import Enum

import numpy as np

from magcal_ros.core.errors import Reason, Refusal
from magcal_ros.core.geometry.arrays import FloatArray, centred, freeze
from magcal_ros.core.geometry.rotations import crossed

THINNEST = 1e-6  # ratio of spreads below which points are a line, or in space a plane
LARGEST_RADIUS = 1e4  # ratio of radius and size from which points are a line or a plane, too
FIELD_ON_A_LINE = "The samples lie on a line or on one point. Turn further."
FLAT = (
    "The samples lie on a plane: no ellipsoid can be fitted to them. Tumble the sensor through "
    "all orientations, or use a method for turns about one axis."
)
OPEN = (
    "The samples fit an open surface (a hyperboloid or a cylinder) better than an ellipsoid. "
    "Tumble the sensor through all orientations, away from iron."
)
STRAIGHT = "The samples are too short an arc to determine a circle. Turn further."


@dataclass(frozen=True, eq=False)
class Ellipsoid:
    """An ellipsoid."""

    centre: FloatArray  # in the points' unit, shape (3,)
    radii: FloatArray  # half axes, shape (3,)
    axes: FloatArray
    """Columns: directions of the half axes, as in `radii`; a rotation. Shape (3, 3)."""

    def __post_init__(self) -> None:
        freeze(self, centre=(3,), radii=(3,), axes=(3, 3))

    @property
    def radius(self) -> float:
        """Geometric mean of the half axes: the radius of the sphere of the same volume."""
        return float(np.exp(np.log(self.radii).mean()))

    @property
    def ratio(self) -> float:
        """Longest half axis over the shortest, 1 or more."""
        return float(self.radii.max() / self.radii.min())

    @property
    def to_unit_sphere(self) -> FloatArray:
        """The symmetric matrix from points about the centre to the unit sphere, (3, 3)."""
        return np.asarray((self.axes / self.radii) @ self.axes.T)


class QuadricFit(str, Enum):
    """The shapes: any ellipsoid, one along the axes, a sphere."""

    ROTATED = "rotated"
    ALIGNED = "aligned"
    SPHERE = "sphere"


def fit_quadric(points: FloatArray, shape: QuadricFit = QuadricFit.ROTATED) -> Ellipsoid:
    """Fit an ellipsoid by linear least squares, pᵀQp + 2bᵀp = 1 (DT0103).

    By `shape`, all elements of Q are free, or it is diagonal, or a multiple of the identity. Raises
    `Refusal` for too few points (n, 3), a plane, numbers not finite, or an open surface.
    """
    pairs = list(itertools.combinations(range(3), 2))
    free = np.eye(6, 3 if shape is QuadricFit.ALIGNED else None)
    if shape is QuadricFit.SPHERE:
        free = free[:, :3].sum(axis=1, keepdims=True)
    centroid, moved, size = _of_unit_size(points, free.shape[1] + 3, "surface")
    products = [moved**2, *(2.0 * moved[:, [i]] * moved[:, [j]] for i, j in pairs)]
    design = np.column_stack([np.column_stack(products) @ free, 2.0 * moved])
    solution, _, rank, _ = np.linalg.lstsq(design, np.ones(len(points)), rcond=1e-12)
    if rank < design.shape[1]:
        raise Refusal(Reason.PLANAR, FLAT)
    elements = free @ solution[:-3]
    form = np.diag(elements[:3])
    for (i, j), value in zip(pairs, elements[3:], strict=True):
        form[i, j] = form[j, i] = value
    values, axes = np.linalg.eigh(form)
    if shape is not QuadricFit.ROTATED:
        values, axes = np.diag(form), np.eye(3)
    if (values * values[0] <= 0.0).any():
        raise Refusal(Reason.NO_SOLUTION, OPEN)
    centre = -np.linalg.solve(form, solution[-3:])
    squares = (1.0 - float(solution[-3:] @ centre)) / values
    if not ((squares > 0.0) & (squares <= LARGEST_RADIUS**2)).all():
        raise Refusal(Reason.NO_SOLUTION, OPEN)
    radii = size * np.sqrt(squares)
    return Ellipsoid(centroid + size * centre, radii, axes * np.linalg.det(axes))


def _of_unit_size(
    points: FloatArray, least: int, shape: str
) -> tuple[FloatArray, FloatArray, float]:
    """Return the centroid of points (n, d), the points about it with unit size, and their size.

    Raises `Refusal` if the points are too few, not finite, or a line (d = 2) or a plane (d = 3).
    """
    centroid, moved = centred(points, least, shape)
    spread = np.linalg.svd(moved, compute_uv=False) / math.sqrt(len(points))
    if spread[-1] <= THINNEST * spread[0]:
        if points.shape[1] == 2:
            raise Refusal(Reason.FIELD_ON_A_LINE, FIELD_ON_A_LINE)
        raise Refusal(Reason.PLANAR, FLAT)
    size = float(np.linalg.norm(spread))
    return centroid, moved / size, size


def ellipse_ratio(points: FloatArray) -> float | None:
    """Return longest over shortest half axis of the ellipse through points (n, 2), 1 or more.

    It is fitted under the constraint that it is an ellipse (Halír and Flusser, 1998). S1 and S3 are
    the scatters of the quadratic and of the linear terms, S2 that between them. The quadratic
    coefficients are the eigenvector of C⁻¹ (S1 - S2 S3⁻¹ S2ᵀ) with 4ac - b² > 0. None if no
    eigenvector is an ellipse. Raises `Refusal` for fewer than five points, a line, or numbers not
    finite.
    """
    x, y = _of_unit_size(points, 5, "curve")[1].T
    quadratic = np.column_stack([x * x, x * y, y * y])
    linear = np.column_stack([x, y, np.ones_like(x)])
    to_linear = -np.linalg.solve(linear.T @ linear, linear.T @ quadratic)
    reduced = quadratic.T @ quadratic + quadratic.T @ linear @ to_linear
    constrained = np.array([reduced[2] / 2.0, -reduced[1], reduced[0] / 2.0])
    values, vectors = np.linalg.eig(constrained)
    # By rounding, two columns may fulfil the constraint, or a pair may be complex: each column is
    # tested separately, and the one with the smallest residual (the eigenvalue) is chosen.
    columns = np.real(vectors)
    fulfilled = 4.0 * columns[0] * columns[2] - columns[1] ** 2 > 1e-12
    if not fulfilled.any():
        return None
    a, b, c = columns[:, int(np.argmin(np.where(fulfilled, np.abs(values), np.inf)))]
    first, second = np.abs(np.linalg.eigvalsh(np.array([[a, b / 2.0], [b / 2.0, c]])))
    return float(math.sqrt(max(first, second) / min(first, second)))


def fit_circle(points: FloatArray) -> tuple[FloatArray, float]:
    """Fit a circle to points (n, 2) by `taubin_circle`; return its centre and radius.

    Raises `Refusal` for fewer than three points, a line, one point, or numbers not finite.
    """
    centroid, moved, size = _of_unit_size(points, 3, "curve")
    centre, radius = taubin_circle(moved, np.full(len(points), 1.0 / len(points)))
    if radius > LARGEST_RADIUS:
        raise Refusal(Reason.FIELD_ON_A_LINE, STRAIGHT)
    return centroid + size * centre, size * radius


def taubin_circle(points: FloatArray, weight: FloatArray) -> tuple[FloatArray, float]:
    """Fit a circle to centred points (n, 2); return its centre (2,) and radius.

    Taubin (1991) divides the algebraic distance by its mean gradient, so that it is nearly unbiased
    on short arcs; by singular values after Chernov, Circular and Linear Regression (2010). The
    weights (n,) sum to one. The radius is zero for a single point.
    """
    squares = np.sum(points**2, axis=1)
    mean = float(weight @ squares)
    if mean <= 0.0:
        return np.zeros(2), 0.0
    rows = np.column_stack([(squares - mean) / (2.0 * math.sqrt(mean)), points])
    a, b, c = np.linalg.svd(np.sqrt(weight)[:, None] * rows, full_matrices=False)[2][2]
    a = math.copysign(max(abs(a), 1e-12), a) / (2.0 * math.sqrt(mean))
    centre = np.array([-b, -c]) / (2.0 * a)
    return centre, math.sqrt(float(centre @ centre) + mean)


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
    """Return `fit_circle_robustly` with the normal on the side of `upwards` (3,).

    Raises `Refusal` if the points (n, 3) are too few, on a line, or one point.
    """
    _principal_axes(points, "circle")
    circle = fit_circle_robustly(points)
    # Half a turn about the first axis keeps the basis right-handed.
    flipped = circle.basis * np.array([[1.0], [-1.0], [-1.0]])
    return circle if circle.normal @ upwards >= 0.0 else replace(circle, basis=flipped)


def fit_circle_robustly(points: FloatArray) -> Circle:
    """Fit the plane of least spread and Taubin's circle in it, with Cauchy weights.

    The points (n, 3) are in any unit; the normal has either sign. The radius is zero for one point.
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
    share = weight / weight.sum()
    mean = share @ points
    away = points - mean
    normal, first, second = np.linalg.eigh((away * share[:, None]).T @ away)[1].T
    plane = np.stack([first, second], axis=1)
    centre, radius = taubin_circle(away @ plane, share)
    return Circle(mean + plane @ centre, np.stack([first, crossed(normal, first), normal]), radius)


SMALLEST = 1e-9  # ratio of size and distance from the origin below which points are one point


@dataclass(frozen=True, eq=False)
class Plane:
    """A plane through points."""

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
        n (l - t)² / (l t), by perturbation theory of the eigenvectors. It is zero for isotropic
        points.

        `least_noise` is the floor of the noise's standard deviation, in the points' unit; positive.
        """
        across = max(self.thickness, least_noise) ** 2
        in_plane = np.eye(3) - np.outer(self.normal, self.normal)
        variances, axes = np.linalg.eigh(in_plane @ self.scatter @ in_plane)
        excess = np.maximum(variances - across, 0.0)
        information = self.count * excess**2 / (np.maximum(variances, across) * across)
        return np.asarray((axes * information) @ axes.T)

    def normal_sigma(self, least_noise: float) -> float:
        """Return the larger standard deviation of the normal's direction in radians.

        It is infinite if the points are isotropic.
        """
        middle = float(np.linalg.eigvalsh(self.normal_information(least_noise))[1])
        return float(1.0 / np.sqrt(middle)) if middle > 0.0 else np.inf


def fit_plane(points: FloatArray) -> Plane:
    """Fit the plane of least squared distances.

    Raises `Refusal` if the points (n, 3) are not finite, or are one point or a line.
    """
    moved, axes = _principal_axes(points, "plane")
    return Plane(axes[2], moved.T @ moved / len(points), len(points))


def _principal_axes(points: FloatArray, shape: str) -> tuple[FloatArray, FloatArray]:
    """Return points (n, 3) about their centroid, and principal axes; refuse a point or a line."""
    centre, moved = centred(points, 3, shape)
    values, axes = np.linalg.svd(moved, full_matrices=False)[1:]
    spread = values / np.sqrt(len(points))
    if spread[0] <= SMALLEST * float(np.linalg.norm(centre)) or spread[0] == 0.0:
        words = "All samples are the same point. Turn while the samples are taken."
        raise Refusal(Reason.NO_MOTION, words)
    if spread[1] <= THINNEST * spread[0]:
        words = "The samples lie on a line, which has no plane. Turn further."
        raise Refusal(Reason.FIELD_ON_A_LINE, words)
    return moved, axes


def plane_normal(points: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the direction of least spread, unit, and the variances, ascending."""
    centred = points - points.mean(axis=0)
    values, vectors = np.linalg.eigh(centred.T @ centred / len(points))
    return vectors[:, 0], values
