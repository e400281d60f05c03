"""The geometric steps of the ST design tip: frame, circle of the field, axis.

Inside, axes are forward-right-down and gravity reads +1 downwards. A passive tip rotation
Rx(roll) Ry(pitch) is the installation of a URDF with the same roll and the opposite pitch.
"""

from __future__ import annotations

import contextlib
import math
from dataclasses import dataclass, replace

import numpy as np

from magcal_ros.core.errors import Reason, Refusal
from magcal_ros.core.geometry.arrays import FloatArray, trapezoids
from magcal_ros.core.geometry.attitude import FRD_FROM_FLU, unit
from magcal_ros.core.geometry.rotations import rotation_from_rpy
from magcal_ros.core.geometry.shapes import SMALLEST, fit_circle, fit_plane
from magcal_ros.core.knowledge import Mounting
from magcal_ros.core.methods.methods_tuning import TIP
from magcal_ros.core.samples.window import Window


@dataclass(frozen=True, eq=False)
class TipSamples:
    """A window in the axes of the design tip."""

    down: FloatArray
    """Gravity in body axes, forward-right-down, scaled to a mean length of one. Shape (n, 3)."""
    raw: FloatArray  # raw field in sensor axes, tesla. Shape (n, 3).
    field: FloatArray
    """Field in nominal body axes, forward-right-down, gains removed, tesla. Shape (n, 3)."""
    mounting: FloatArray  # from `field` to `raw`. Shape (3, 3).
    turned: FloatArray | None
    """Rotation between neighbouring samples by the gyro, body axes, radians. Shape (n - 1, 3)."""


def prepare_samples(window: Window, mounting: Mounting) -> TipSamples:
    """Return a window in the tip's frame."""
    matrix = mounting.matrix @ FRD_FROM_FLU
    down = -window.specific_force @ FRD_FROM_FLU
    turned = None
    if window.angular_rate is not None:
        turned = trapezoids(window.time, window.angular_rate @ FRD_FROM_FLU)
    return TipSamples(
        down=down / np.linalg.norm(down, axis=1).mean(),
        raw=window.field,
        field=window.field @ np.linalg.inv(matrix).T,
        mounting=matrix,
        turned=turned,
    )


@dataclass(frozen=True, eq=False)
class FieldCircle:
    """The field's circle in sensor axes, gains removed."""

    basis: FloatArray  # columns: two axes in the plane and the normal, right-handed. Shape (3, 3).
    offsets: FloatArray  # samples relative to the centre, in sensor axes, tesla. Shape (n, 3).
    phasor: np.ndarray[tuple[int], np.dtype[np.complex128]]
    """Samples relative to the centre, in the plane, tesla. Shape (n,)."""
    middle: FloatArray  # the centre in the axes of `basis`, tesla. Shape (3,).
    radius: float  # tesla

    @property
    def model_error(self) -> FloatArray:
        """Samples minus the nearest points of the circle, sensor axes, shape (n, 3), tesla."""
        directions = self.phasor / np.maximum(np.abs(self.phasor), 1e-300)
        nearest = np.column_stack([directions.real, directions.imag]) * self.radius
        return np.asarray(self.offsets - nearest @ self.basis[:, :2].T)

    def flipped(self) -> FieldCircle:
        """Return the same circle with the opposite normal."""
        flip = np.array([1.0, -1.0, -1.0])
        middle = self.middle * flip
        return replace(self, basis=self.basis * flip, phasor=self.phasor.conj(), middle=middle)


def fit_field_circle(samples: TipSamples) -> FieldCircle:
    """Fit the plane to the raw field, and the circle to the field without its gains.

    Raises `Refusal` if the field is constant, on a line, or not on a plane.
    """
    plane = fit_plane(samples.raw)
    # A normal is transformed by the inverse transpose of the matrix that transforms points.
    normal = samples.mounting.T @ plane.normal
    normal /= np.linalg.norm(normal)
    basis = derotation(normal)
    flat = samples.field @ basis
    centre, radius = fit_circle(flat[:, :2])
    least_noise = SMALLEST * float(np.linalg.norm(samples.raw, axis=1).mean())
    smallest, middling, largest = plane.spread
    is_uncertain = plane.normal_sigma(least_noise) > TIP.largest_normal_sigma
    if is_uncertain and middling < 2.0 * smallest < largest:
        raise Refusal(
            Reason.FIELD_ON_A_LINE,
            "The field's samples lie on a line within their noise. Turn further.",
        )
    if is_uncertain or plane.thickness > TIP.largest_thickness * radius:
        raise Refusal(
            Reason.FIELD_NOT_ON_A_PLANE,
            "The field's samples do not lie on a plane. Turn about one axis only, on even ground "
            "and away from moving iron.",
        )
    middle = np.append(centre, flat[:, 2].mean())
    around = flat - middle
    phasor = around[:, 0] + 1j * around[:, 1]
    return FieldCircle(basis, around @ basis.T, phasor, middle, radius)


def derotation(normal: FloatArray) -> FloatArray:
    """Return the tip's matrix of roll and pitch whose third column is `normal`, shape (3, 3)."""
    x, y, z = (float(v) for v in normal)
    return rotation_from_rpy(math.atan2(y, z), -math.asin(min(1.0, max(-1.0, x)))).T


@dataclass(frozen=True, eq=False)
class TurnAxis:
    """The axis of the turn."""

    direction: FloatArray  # in body axes, forward-right-down; unit, downwards. Shape (3,).
    axial_gravity: float  # cosine of the axis's angle from the vertical
    across: FloatArray  # gravity across the axis, body axes, gravity = 1. Shape (n, 3).
    noise: float
    """Standard deviation of the accelerometer per axis, gravity = 1, which is radians of tilt."""

    @property
    def tilt(self) -> float:
        """Radians of the axis from the vertical."""
        return float(np.arccos(min(1.0, self.axial_gravity)))


def find_axis(samples: TipSamples, circle: FieldCircle) -> TurnAxis:
    """Return the axis from the centre of gravity's circle and the normal of its plane.

    In a level turn gravity is constant, and only the centre shows the axis; in a tilted turn the
    normal shows more. Each is weighted by its information. The centre is the constant term of
    gravity in a fit with a sinusoid of the field's phase, because the mean over part of a turn is
    not on the axis. Raises `Refusal` if the axis is nearly horizontal.
    """
    centre, centre_sigma, noise = _centre_of_gravity(samples.down, circle)
    if float(np.linalg.norm(centre)) < TIP.smallest_axial_gravity:
        raise _horizontal()
    direction = centre / np.linalg.norm(centre)
    # If gravity was constant, only its centre shows the axis.
    with contextlib.suppress(Refusal):
        plane = fit_plane(samples.down)
        from_plane = plane.normal * (1.0 if plane.normal @ centre >= 0.0 else -1.0)
        # The plane has no information along its normal, where the centre decides.
        of_centre = float(centre @ centre) / centre_sigma**2 * np.eye(3)
        of_plane = plane.normal_information(SMALLEST)
        weighted = of_centre @ direction + of_plane @ from_plane
        direction = unit(np.asarray(np.linalg.solve(of_centre + of_plane, weighted)))
    axial = samples.down @ direction
    axial_gravity = float(axial.mean())
    if axial_gravity < TIP.smallest_axial_gravity:
        raise _horizontal()
    return TurnAxis(
        direction=direction,
        axial_gravity=min(1.0, axial_gravity),
        across=samples.down - axial[:, None] * direction,
        noise=noise,
    )


def _centre_of_gravity(down: FloatArray, circle: FieldCircle) -> tuple[FloatArray, float, float]:
    phase = np.angle(circle.phasor)
    design = np.column_stack([np.ones(len(phase)), np.cos(phase), np.sin(phase)])
    covariance = np.linalg.pinv(design.T @ design)
    coefficients = covariance @ (design.T @ down)
    residual = down - design @ coefficients
    noise = float(np.sqrt((residual**2).sum() / (3.0 * max(len(down) - 3, 1))))
    return coefficients[0], max(noise, SMALLEST) * float(np.sqrt(covariance[0, 0])), noise


def _horizontal() -> Refusal:
    return Refusal(
        Reason.AXIS_HORIZONTAL,
        "The robot turned about a nearly horizontal axis. Turn about an axis within 75° of the "
        "vertical, best on the wheels.",
    )
