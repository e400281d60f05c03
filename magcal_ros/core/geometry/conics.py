"""Circles and ellipses in a plane, spheres and ellipsoids in space, through given points.

All fits first move the points to their centroid and scale them to unit size. The forms that fix
the constant term at -1 are singular for a curve or surface through the origin; a centroid lies
inside every ellipse and ellipsoid, never on it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum

import numpy as np

from magcal_ros.core.errors import Reason, Refusal
from magcal_ros.core.geometry.arrays import FloatArray, centred, freeze

THINNEST = 1e-6
"""Width over length of points below which they are a line, or in space a plane."""
LARGEST_RADIUS = 1e4
"""Radii beyond this many times the points' own size are a line or a plane, too."""


@dataclass(frozen=True, eq=False)
class Conic:
    """A circle or an ellipse."""

    centre: FloatArray  # in the points' unit, shape (2,)
    radii: FloatArray
    """Half axes; the first lies at `angle`, the second 90° further. Shape (2,)."""
    angle: float  # radians from x to the first half axis, in (-pi/2, pi/2]

    def __post_init__(self) -> None:
        freeze(self, centre=(2,), radii=(2,))

    @property
    def radius(self) -> float:
        """Geometric mean of the half axes: the radius of the circle of the same area."""
        return math.sqrt(float(self.radii[0] * self.radii[1]))

    @property
    def ratio(self) -> float:
        """Longer half axis over the shorter, 1 or more."""
        return float(self.radii.max() / self.radii.min())


def _fit_linearly(points: FloatArray, quadratic: int) -> Conic:
    """Fit ax² + by² + 2cxy + 2dx + 2ey = 1 by linear least squares (DT0103).

    Of `quadratic` terms one makes a circle (a = b, no c), two an ellipse along the axes (no c).
    """
    frame = _Frame.of(points, least=quadratic + 2)
    x, y = frame.points.T
    squares = [x * x + y * y] if quadratic == 1 else [x * x, y * y, 2.0 * x * y][:quadratic]
    *form, d, e = _least_squares([*squares, 2.0 * x, 2.0 * y])
    a, b, c = {1: (*form, *form, 0.0), 2: (*form, 0.0), 3: form}[quadratic]
    return frame.conic(a, b, c, d, e, -1.0)


def _fit_ellipse_halir_flusser(points: FloatArray) -> Conic:
    """Fit any ellipse under the constraint that it is one (Halír and Flusser, 1998).

    With the scatter of the quadratic terms S1, of the linear terms S3 and between them S2, the
    quadratic coefficients are the eigenvector of C⁻¹ (S1 - S2 S3⁻¹ S2ᵀ) for which 4ac - b² > 0.
    """
    frame = _Frame.of(points, least=5)
    x, y = frame.points.T
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
        raise _not_an_ellipse()
    best = int(np.argmin(np.where(fulfilled, np.abs(values), np.inf)))
    a, b, c = (float(v) for v in columns[:, best])
    d, e, f = (float(v) for v in to_linear @ columns[:, best])
    return frame.conic(a, c, b / 2.0, d / 2.0, e / 2.0, f)


def _fit_circle_taubin(points: FloatArray) -> Conic:
    frame = _Frame.of(points, least=3)
    centre, radius = taubin_circle(frame.points, np.full(len(points), 1.0 / len(points)))
    if radius > LARGEST_RADIUS:
        raise _too_straight()
    return Conic(frame.centroid + frame.size * centre, np.full(2, frame.size * radius), 0.0)


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

    def __call__(self, points: FloatArray) -> Conic:
        """Fit a curve.

        Of an ellipse along the axes the first half axis lies along x. Raises `Refusal` for fewer
        points (n, 2) than the curve has parameters, a line, one point, a curve that is no ellipse,
        or numbers that are not finite.
        """
        if self is ConicFit.TAUBIN:
            return _fit_circle_taubin(points)
        if self is ConicFit.HALIR_FLUSSER:
            return _fit_ellipse_halir_flusser(points)
        linear = (ConicFit.CIRCLE, ConicFit.ELLIPSE, ConicFit.ROTATED_ELLIPSE)
        return _fit_linearly(points, linear.index(self) + 1)


@dataclass(frozen=True, eq=False)
class _Frame:
    """Points brought to their centroid and unit size, and the way back."""

    points: FloatArray
    centroid: FloatArray
    size: float

    @classmethod
    def of(cls, points: FloatArray, least: int) -> _Frame:
        centroid, moved = centred(points, least, "curve")
        values = np.linalg.svd(moved, compute_uv=False) / math.sqrt(len(points))
        if values[1] <= THINNEST * values[0] or values[0] == 0.0:
            raise Refusal(
                Reason.FIELD_ON_A_LINE,
                "The samples lie on a line or on one point. Turn further round.",
            )
        size = float(np.hypot(values[0], values[1]))
        return cls(moved / size, centroid, size)

    def conic(self, a: float, b: float, c: float, d: float, e: float, f: float) -> Conic:
        """Return the ellipse a x² + b y² + 2c xy + 2d x + 2e y + f = 0 of the moved points."""
        form = np.array([[a, c], [c, b]])
        values, axes = np.linalg.eigh(form)
        if values[0] * values[1] <= 0.0:
            raise _not_an_ellipse()
        centre = -np.linalg.solve(form, np.array([d, e]))
        level = -(f + d * centre[0] + e * centre[1])
        squares = level / values
        if not (squares > 0.0).all():
            raise _not_an_ellipse()
        if squares.max() > LARGEST_RADIUS**2:
            raise _too_straight()
        radii, angle = np.sqrt(squares), math.atan2(float(axes[1, 0]), float(axes[0, 0]))
        if c == 0.0:
            radii, angle = np.sqrt(level / np.array([a, b])), 0.0
        return Conic(
            self.centroid + self.size * centre,
            self.size * radii,
            math.pi / 2.0 - (math.pi / 2.0 - angle) % math.pi,
        )


def _least_squares(columns: list[FloatArray]) -> list[float]:
    design = np.column_stack(columns)
    solution, _, rank, _ = np.linalg.lstsq(design, np.ones(len(design)), rcond=1e-12)
    if rank < len(columns):
        raise Refusal(
            Reason.FIELD_ON_A_LINE, "The samples do not determine a curve. Turn further round."
        )
    return [float(value) for value in solution]


def _too_straight() -> Refusal:
    return Refusal(
        Reason.FIELD_ON_A_LINE, "The samples bend too little to show a circle. Turn further round."
    )


def _not_an_ellipse() -> Refusal:
    return Refusal(
        Reason.CIRCLE_TOO_SMALL,
        "The samples fit a parabola or a hyperbola better than an ellipse. Turn further round, or "
        "fit a circle instead.",
    )


class QuadricFit(str, Enum):
    """The shapes by name."""

    ROTATED = "rotated"
    ALIGNED = "aligned"
    SPHERE = "sphere"


_FREE = {
    QuadricFit.ROTATED: np.eye(6),
    QuadricFit.ALIGNED: np.eye(6, 3),
    QuadricFit.SPHERE: np.eye(6, 3).sum(axis=1, keepdims=True),
}
"""Takes the free elements of each shape's form to xx, yy, zz, xy, xz, yz."""


@dataclass(frozen=True, eq=False)
class Ellipsoid:
    """An ellipsoid."""

    centre: FloatArray  # in the points' unit, shape (3,)
    radii: FloatArray  # half axes, shape (3,)
    axes: FloatArray
    """A rotation; its columns are the directions of the half axes, in the order of `radii`. Shape
    (3, 3)."""

    def __post_init__(self) -> None:
        freeze(self, centre=(3,), radii=(3,), axes=(3, 3))

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

    By `shape`, Q has six free elements, is diagonal, or a multiple of the identity. Raises
    `Refusal` for too few points (n, 3), a plane, numbers not finite, or another surface.
    """
    free = _FREE[shape]
    centroid, moved = centred(points, free.shape[1] + 3, "surface")
    spread = np.linalg.svd(moved, compute_uv=False) / math.sqrt(len(points))
    if spread[2] <= THINNEST * spread[0]:
        raise _planar()
    size = float(np.linalg.norm(spread))
    moved /= size
    x, y, z = moved.T
    products = np.column_stack([moved**2, 2.0 * x * y, 2.0 * x * z, 2.0 * y * z])
    design = np.column_stack([products @ free, 2.0 * moved])
    solution, _, rank, _ = np.linalg.lstsq(design, np.ones(len(points)), rcond=1e-10)
    if rank < design.shape[1]:
        raise _planar()
    xx, yy, zz, xy, xz, yz = free @ solution[:-3]
    form, linear = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]), solution[-3:]
    values, axes = np.linalg.eigh(form)
    if shape is not QuadricFit.ROTATED:
        values, axes = np.diag(form), np.eye(3)
    if np.abs(values).min() <= LARGEST_RADIUS**-2:
        raise _no_ellipsoid()
    centre = -np.linalg.solve(form, linear)
    squares = (1.0 + float(centre @ form @ centre)) / values
    if not (squares > 0.0).all() or squares.max() > LARGEST_RADIUS**2:
        raise _no_ellipsoid()
    if np.linalg.det(axes) < 0.0:
        axes = -axes
    return Ellipsoid(centroid + size * centre, size * np.sqrt(squares), axes)


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
