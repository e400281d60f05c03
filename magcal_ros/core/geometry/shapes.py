"""Circles and ellipses in a plane, spheres and ellipsoids, planes and circles in space.

All fits first move the points to their centroid and scale them to unit size. The forms that fix
the constant term at -1 are singular for a curve or surface through the origin; a centroid lies
inside every ellipse and ellipsoid, never on it. The sign of a plane's normal is arbitrary; it
depends on the sense of rotation, which the caller knows.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass, replace
from enum import Enum

import numpy as np

from magcal_ros.core.errors import Reason, Refusal
from magcal_ros.core.geometry.arrays import FloatArray, centred, freeze

THINNEST = 1e-6  # width over length of points below which they are a line, or in space a plane
LARGEST_RADIUS = 1e4  # radii beyond this many times the points' own size are a line or a plane, too
FLAT = {
    2: (Reason.FIELD_ON_A_LINE, "The samples lie on a line or on one point. Turn further round."),
    3: (
        Reason.PLANAR,
        "The samples lie on a plane: no ellipsoid can be fitted to them. Tumble the sensor through "
        "all orientations, or use a method for turns about one axis.",
    ),
}
OPEN = {
    2: (
        Reason.CIRCLE_TOO_SMALL,
        "The samples fit a parabola or a hyperbola better than an ellipse. Turn further round, or "
        "fit a circle instead.",
    ),
    3: (
        Reason.NO_SOLUTION,
        "The samples fit an open surface (a hyperboloid or a cylinder) better than an ellipsoid. "
        "Tumble the sensor through all orientations, away from iron.",
    ),
}
STRAIGHT = {
    2: (
        Reason.FIELD_ON_A_LINE,
        "The samples bend too little to show a circle. Turn further round.",
    ),
    3: OPEN[3],
}
"""Why no curve (2) and no surface (3) goes through samples."""


@dataclass(frozen=True, eq=False)
class Ellipsoid:
    """An ellipse (d = 2) or an ellipsoid (d = 3)."""

    centre: FloatArray  # in the points' unit, shape (d,)
    radii: FloatArray  # half axes, shape (d,)
    axes: FloatArray
    """Columns: directions of the half axes, as in `radii`; in space a rotation. Shape (d, d)."""

    def __post_init__(self) -> None:
        freeze(self, centre=(-1,), radii=(-1,), axes=(-1, -1))

    @property
    def radius(self) -> float:
        """Geometric mean of the half axes: that of the circle or sphere of the same content."""
        return float(np.exp(np.log(self.radii).mean()))

    @property
    def ratio(self) -> float:
        """Longest half axis over the shortest, 1 or more."""
        return float(self.radii.max() / self.radii.min())

    @property
    def to_unit_sphere(self) -> FloatArray:
        """The symmetric S that takes points from the centre onto the unit sphere, (d, d)."""
        return np.asarray((self.axes / self.radii) @ self.axes.T)


class QuadricFit(str, Enum):
    """The shapes by name: any, along the axes, round."""

    ROTATED = "rotated"
    ALIGNED = "aligned"
    SPHERE = "sphere"


def fit_quadric(points: FloatArray, shape: QuadricFit = QuadricFit.ROTATED) -> Ellipsoid:
    """Fit an ellipse or an ellipsoid by linear least squares, pᵀQp + 2bᵀp = 1 (DT0103).

    By `shape`, all elements of Q are free, or it is diagonal, or a multiple of the identity. Raises
    `Refusal` for too few points (n, d), a line or a plane, numbers not finite, or another shape.
    """
    size = points.shape[1]
    pairs = list(itertools.combinations(range(size), 2))
    free = np.eye(size + len(pairs), size if shape is QuadricFit.ALIGNED else None)
    if shape is QuadricFit.SPHERE:
        free = free[:, :size].sum(axis=1, keepdims=True)
    cloud = _Cloud.of(points, free.shape[1] + size)
    moved = cloud.points
    products = [moved**2, *(2.0 * moved[:, [i]] * moved[:, [j]] for i, j in pairs)]
    design = np.column_stack([np.column_stack(products) @ free, 2.0 * moved])
    solution, _, rank, _ = np.linalg.lstsq(design, np.ones(len(points)), rcond=1e-12)
    if rank < design.shape[1]:
        raise Refusal(*(STRAIGHT[2] if size == 2 else FLAT[3]))
    elements = free @ solution[:-size]
    form = np.diag(elements[:size])
    for (i, j), value in zip(pairs, elements[size:], strict=True):
        form[i, j] = form[j, i] = value
    return cloud.ellipsoid(form, np.asarray(solution[-size:]), -1.0)


def _fit_ellipse_halir_flusser(points: FloatArray) -> Ellipsoid:
    """Fit any ellipse under the constraint that it is one (Halír and Flusser, 1998).

    With the scatter of the quadratic terms S1, of the linear terms S3 and between them S2, the
    quadratic coefficients are the eigenvector of C⁻¹ (S1 - S2 S3⁻¹ S2ᵀ) for which 4ac - b² > 0.
    """
    cloud = _Cloud.of(points, least=5)
    x, y = cloud.points.T
    quadratic = np.column_stack([x * x, x * y, y * y])
    linear = np.column_stack([x, y, np.ones_like(x)])
    to_linear = -np.linalg.solve(linear.T @ linear, linear.T @ quadratic)
    reduced = quadratic.T @ quadratic + quadratic.T @ linear @ to_linear
    constrained = np.array([reduced[2] / 2.0, -reduced[1], reduced[0] / 2.0])
    values, vectors = np.linalg.eig(constrained)
    # Rounding may make two columns fulfil the constraint, or leave a complex pair: judge each
    # column by itself and let the residual, which is the eigenvalue, decide.
    columns = np.real(vectors)
    fulfilled = 4.0 * columns[0] * columns[2] - columns[1] ** 2 > 1e-12
    if not fulfilled.any():
        raise Refusal(*OPEN[2])
    best = columns[:, int(np.argmin(np.where(fulfilled, np.abs(values), np.inf)))]
    a, b, c = best
    d, e, f = to_linear @ best
    form, half = np.array([[a, b / 2.0], [b / 2.0, c]]), np.array([d / 2.0, e / 2.0])
    return cloud.ellipsoid(form, half, f)


def taubin_circle(points: FloatArray, weight: FloatArray) -> tuple[FloatArray, float]:
    """Fit a circle to centred points (n, 2); returns its centre (2,) and radius.

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


class ConicFit(str, Enum):
    """The conic fits by name."""

    TAUBIN = "taubin"
    CIRCLE = "circle"
    ELLIPSE = "ellipse"
    ROTATED_ELLIPSE = "rotated_ellipse"
    HALIR_FLUSSER = "halir_flusser"

    def __call__(self, points: FloatArray) -> Ellipsoid:
        """Fit a curve.

        Of an ellipse along the axes the first half axis lies along x. Raises `Refusal` for fewer
        points (n, 2) than the curve has parameters, a line, one point, a curve that is no ellipse,
        or numbers that are not finite.
        """
        if self is ConicFit.TAUBIN:
            cloud = _Cloud.of(points, least=3)
            centre, radius = taubin_circle(cloud.points, np.full(len(points), 1.0 / len(points)))
            if radius > LARGEST_RADIUS:
                raise Refusal(*STRAIGHT[2])
            radii = np.full(2, cloud.size * radius)
            return Ellipsoid(cloud.centroid + cloud.size * centre, radii, np.eye(2))
        if self is ConicFit.HALIR_FLUSSER:
            return _fit_ellipse_halir_flusser(points)
        linear = (ConicFit.ROTATED_ELLIPSE, ConicFit.ELLIPSE, ConicFit.CIRCLE)
        return fit_quadric(points, list(QuadricFit)[linear.index(self)])


@dataclass(frozen=True, eq=False)
class _Cloud:
    """Points brought to their centroid and unit size, and the way back."""

    points: FloatArray
    centroid: FloatArray
    size: float

    @classmethod
    def of(cls, points: FloatArray, least: int) -> _Cloud:
        centroid, moved = centred(points, least, "curve" if points.shape[1] == 2 else "surface")
        spread = np.linalg.svd(moved, compute_uv=False) / math.sqrt(len(points))
        if spread[-1] <= THINNEST * spread[0]:
            raise Refusal(*FLAT[points.shape[1]])
        size = float(np.linalg.norm(spread))
        return cls(moved / size, centroid, size)

    def ellipsoid(self, form: FloatArray, linear: FloatArray, constant: float) -> Ellipsoid:
        """Return pᵀQp + 2bᵀp + c = 0 of the moved points; refuse what is no ellipse."""
        values, axes = np.linalg.eigh(form)
        if np.array_equal(form, np.diag(np.diag(form))):
            values, axes = np.diag(form), np.eye(len(form))
        if (values * values[0] <= 0.0).any():
            raise Refusal(*OPEN[len(form)])
        centre = -np.linalg.solve(form, linear)
        squares = -(constant + float(linear @ centre)) / values
        if not (squares > 0.0).all():
            raise Refusal(*OPEN[len(form)])
        if squares.max() > LARGEST_RADIUS**2:
            raise Refusal(*STRAIGHT[len(form)])
        axes = axes * (np.linalg.det(axes) if len(form) == 3 else 1.0)
        return Ellipsoid(self.centroid + self.size * centre, self.size * np.sqrt(squares), axes)


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
    away = centred(points, 3, "circle")[1]
    spread = np.linalg.svd(away, compute_uv=False)
    _refuse_degenerate(np.asarray(spread[::-1]), points.mean(axis=0))
    circle = fit_circle_robustly(points)
    # Turned by half a turn about the first axis: the basis stays right-handed.
    flipped = circle.basis * np.array([[1.0], [-1.0], [-1.0]])
    return circle if circle.normal @ upwards >= 0.0 else replace(circle, basis=flipped)


def fit_circle_robustly(points: FloatArray) -> Circle:
    """Fit the plane of least spread and Taubin's circle in it, by Cauchy weights.

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
        """Return the larger standard deviation of the normal's direction in radians.

        It is infinite where the cloud is not flat at all.
        """
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
