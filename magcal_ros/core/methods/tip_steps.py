"""The geometric steps of the ST design tip: frame, circle of the field, axis, installation.

Inside, axes are forward-right-down and gravity reads +1 downwards. A passive tip rotation
Rx(roll) Ry(pitch) is the installation of a URDF with the same roll and the opposite pitch.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from magcal_ros.core.errors import Reason, Refusal
from magcal_ros.core.geometry.arrays import FloatArray, trapezoids
from magcal_ros.core.geometry.attitude import FRD_FROM_FLU, unit
from magcal_ros.core.geometry.rotations import (
    roll_pitch_between,
    rotation_angle,
    rotation_from_rpy,
)
from magcal_ros.core.geometry.shapes import SMALLEST, Plane, fit_circle, fit_plane
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
    def normal(self) -> FloatArray:
        """The normal in sensor axes, unit, shape (3,)."""
        return self.basis[:, 2]

    @property
    def height(self) -> float:
        """Distance of the plane from the origin along the normal, tesla."""
        return float(self.middle[2])

    @property
    def centre(self) -> FloatArray:
        """The centre in sensor axes, shape (3,), tesla."""
        return np.asarray(self.basis @ self.middle)

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
    _refuse_unreliable(plane, radius, samples.raw)
    middle = np.append(centre, flat[:, 2].mean())
    around = flat - middle
    phasor = around[:, 0] + 1j * around[:, 1]
    return FieldCircle(basis, around @ basis.T, phasor, middle, radius)


def derotation(normal: FloatArray) -> FloatArray:
    """Return the tip's matrix of roll and pitch whose third column is `normal`, shape (3, 3)."""
    x, y, z = (float(v) for v in normal)
    return rotation_from_rpy(math.atan2(y, z), -math.asin(min(1.0, max(-1.0, x)))).T


def _refuse_unreliable(plane: Plane, radius: float, raw: FloatArray) -> None:
    least_noise = SMALLEST * float(np.linalg.norm(raw, axis=1).mean())
    smallest, middle, largest = plane.spread
    is_uncertain = plane.normal_sigma(least_noise) > TIP.largest_normal_sigma
    if is_uncertain and middle < 2.0 * smallest < largest:
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
    try:
        plane = fit_plane(samples.down)
    except Refusal:
        plane = None
    direction = _weighed(centre, centre_sigma, plane)
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


def _weighed(centre: FloatArray, centre_sigma: float, plane: Plane | None) -> FloatArray:
    """Return the axis from both; from the centre alone if gravity was constant."""
    from_centre = centre / np.linalg.norm(centre)
    if plane is None:
        return np.asarray(from_centre)
    from_plane = plane.normal * (1.0 if plane.normal @ centre >= 0.0 else -1.0)
    # The plane has no information along its normal, where the centre decides.
    of_centre = float(centre @ centre) / centre_sigma**2 * np.eye(3)
    of_plane = plane.normal_information(SMALLEST)
    weighted = of_centre @ from_centre + of_plane @ from_plane
    return unit(np.asarray(np.linalg.solve(of_centre + of_plane, weighted)))


def _horizontal() -> Refusal:
    return Refusal(
        Reason.AXIS_HORIZONTAL,
        "The robot turned about a nearly horizontal axis. Turn about an axis within 75° of the "
        "vertical, best on the wheels.",
    )


@dataclass(frozen=True, eq=False)
class Candidate:
    """One installation that fits the two normals, as a rotation of the tip."""

    roll: float
    pitch: float  # of the passive rotation Rx(roll) Ry(pitch), radians
    circle: FieldCircle  # the field's circle with the normal that this installation needs
    gravity_dot_field: float  # mean product of gravity and field across the axis, tesla

    @property
    def angle(self) -> float:
        """Radians of the whole installation."""
        return rotation_angle(rotation_from_rpy(self.roll, self.pitch))


def find_candidates(samples: TipSamples, axis: TurnAxis, circle: FieldCircle) -> list[Candidate]:
    """Return every installation that fits, at least one, the smallest first.

    The field turns about its normal in the same sense as gravity about the axis. If neither gravity
    nor a gyro shows this sense, both normals are tried. Raises `Refusal` if none fits, if the pitch
    is not observable, or if gravity and gyro contradict each other.
    """
    if math.hypot(float(axis.direction[0]), float(axis.direction[2])) < TIP.smallest_lever:
        raise Refusal(
            Reason.AMBIGUOUS,
            "The robot turned about the IMU's y axis, which does not show the magnetometer's "
            "pitch. Give the mounting in the robot's frame, so that the turn is about its z axis.",
        )
    sense = _sense(samples, axis, circle)
    circles = [c for s, c in ((1, circle), (-1, circle.flipped())) if sense in (0, s)]
    found = []
    for c in circles:
        for roll, pitch in roll_pitch_between(axis.direction, c.normal):
            product = axis.across * (c.offsets @ rotation_from_rpy(roll, pitch).T)
            found.append(Candidate(roll, pitch, c, float(np.sum(product, axis=1).mean())))
    if not found:
        raise Refusal(
            Reason.NO_SOLUTION,
            "No roll and pitch of the magnetometer explain the turn. Check that the accelerometer "
            "and the magnetometer are on the same body and that their axes are right-handed.",
        )
    return sorted(found, key=lambda candidate: candidate.angle)


def _sense(samples: TipSamples, axis: TurnAxis, circle: FieldCircle) -> int:
    by_gravity = _sense_by_gravity(axis, circle)
    by_gyro = _sense_by_gyro(samples, axis, circle)
    if by_gravity * by_gyro < 0:
        raise Refusal(
            Reason.AXES_DISAGREE,
            "Gyro and gravity turn in opposite senses. Check the axes and signs of the gyro.",
        )
    return by_gravity or by_gyro


def _sense_by_gravity(axis: TurnAxis, circle: FieldCircle) -> int:
    first, second = np.linalg.svd(axis.direction[None, :])[2][1:]
    second = second * float(np.cross(first, second) @ axis.direction)
    gravity = axis.across @ first + 1j * (axis.across @ second)
    field = circle.phasor / np.abs(circle.phasor).mean()
    same, opposite = abs((gravity * field.conj()).mean()), abs((gravity * field).mean())
    standard_error = max(axis.noise, SMALLEST) / math.sqrt(len(field))
    if abs(same - opposite) < TIP.clear_sense * standard_error:
        return 0
    return 1 if same > opposite else -1


def _sense_by_gyro(samples: TipSamples, axis: TurnAxis, circle: FieldCircle) -> int:
    if samples.turned is None:
        return 0
    # A field fixed in the world turns backwards in the body. Sines, because the field does not show
    # the sense of a step of half a turn during a gap.
    expected = np.sin(-(samples.turned @ axis.direction))
    seen = np.sin(np.angle(circle.phasor[1:] * circle.phasor[:-1].conj()))
    power = float(expected @ expected)
    slope = float(expected @ seen) / power if power > 0.0 else 0.0
    if abs(slope) < TIP.least_gyro_agreement:
        return 0
    return 1 if slope > 0.0 else -1
