"""The circle that the field draws: its plane, its centre, and the samples' phases on it."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from magcal_ros.core.errors import Reason, Refusal
from magcal_ros.core.geometry.arrays import FloatArray
from magcal_ros.core.geometry.conics import Conic
from magcal_ros.core.geometry.planes import Plane
from magcal_ros.core.geometry.rotations import rotation_from_rpy
from magcal_ros.core.methods.design_tip.options import Options
from magcal_ros.core.methods.design_tip.tip_frame import ROUNDING, TipSamples
from magcal_ros.core.samples.coverage import Coverage


@dataclass(frozen=True)
class CircleTuning:
    """What counts as a circle in space."""

    largest_normal_sigma: float = np.radians(10.0)
    """Radians of uncertainty of the plane's normal."""
    largest_thickness: float = 0.25
    """Root mean square distance from the plane as a share of the radius: more is a tumble."""


TUNING = CircleTuning()


@dataclass(frozen=True, eq=False)
class FieldCircle:
    """The field's circle in sensor axes, gains taken off."""

    basis: FloatArray
    """Columns: two axes in the plane and the normal, right-handed. Shape (3, 3)."""
    offsets: FloatArray
    """Samples relative to the centre, in sensor axes, tesla. Shape (n, 3)."""
    phasor: np.ndarray[tuple[int], np.dtype[np.complex128]]
    """Samples relative to the centre, in the plane, tesla. Shape (n,)."""
    height: float
    """Distance of the plane from the origin along the normal, tesla."""
    conic: Conic
    """The fitted curve in the plane's axes."""

    @property
    def normal(self) -> FloatArray:
        """The normal in sensor axes, unit, shape (3,)."""
        return self.basis[:, 2]

    @property
    def radius(self) -> float:
        """Tesla."""
        return self.conic.radius

    @property
    def centre(self) -> FloatArray:
        """The centre in sensor axes, shape (3,), tesla."""
        return np.asarray(self.basis @ np.append(self.conic.centre, self.height))

    @property
    def model_error(self) -> FloatArray:
        """Samples minus the nearest points of the circle, sensor axes, shape (n, 3), tesla."""
        directions = self.phasor / np.maximum(np.abs(self.phasor), 1e-300)
        nearest = np.column_stack([directions.real, directions.imag]) * self.radius
        return np.asarray(self.offsets - nearest @ self.basis[:, :2].T)

    @property
    def arc(self) -> float:
        """Radians of the circle without its largest gap."""
        return Coverage.of(np.angle(self.phasor)).arc

    def flipped(self) -> FieldCircle:
        """Return the same circle with the opposite normal."""
        mirrored = self.conic.centre * (1.0, -1.0)
        return replace(
            self,
            basis=self.basis * (1.0, -1.0, -1.0),
            phasor=self.phasor.conj(),
            height=-self.height,
            conic=replace(self.conic, centre=mirrored, angle=-self.conic.angle),
        )


def fit_field_circle(samples: TipSamples, options: Options) -> FieldCircle:
    """Fit the plane to the raw field and the circle to the field without its gains.

    Raises
    ------
    Refusal
        If the field stands still, lies on a line, or fills a space.
    """
    plane = options.plane(samples.raw)
    # A normal belongs to the dual space: it maps by the inverse transpose of what maps points.
    normal = samples.mounting.T @ plane.normal
    normal /= np.linalg.norm(normal)
    basis = derotation(normal)
    flat = samples.field @ basis
    conic = options.conic(flat[:, :2])
    _refuse_unreliable(plane, conic, samples.raw)
    height = float(flat[:, 2].mean())
    around = flat - np.append(conic.centre, height)
    phasor = around[:, 0] + 1j * around[:, 1]
    return FieldCircle(basis, around @ basis.T, phasor, height, conic)


def derotation(normal: FloatArray) -> FloatArray:
    """Return the tip's matrix of roll and pitch whose third column is `normal`, shape (3, 3)."""
    x, y, z = (float(v) for v in normal)
    return rotation_from_rpy(math.atan2(y, z), -math.asin(min(1.0, max(-1.0, x)))).T


def _refuse_unreliable(plane: Plane, conic: Conic, raw: FloatArray) -> None:
    least_noise = ROUNDING * float(np.linalg.norm(raw, axis=1).mean())
    smallest, middle, largest = plane.spread
    if plane.normal_sigma(least_noise) > TUNING.largest_normal_sigma:
        if largest < 2.0 * smallest:
            raise Refusal(
                Reason.NO_MOTION,
                "The field did not change by more than its noise. Turn while samples are taken.",
            )
        if middle < 2.0 * smallest:
            raise Refusal(
                Reason.FIELD_ON_A_LINE,
                "The field's samples lie on a line within their noise. Turn further round.",
            )
        raise _not_a_plane()
    if plane.thickness > TUNING.largest_thickness * conic.radius:
        raise _not_a_plane()


def _not_a_plane() -> Refusal:
    return Refusal(
        Reason.FIELD_NOT_ON_A_PLANE,
        "The field's samples do not lie on a plane. Turn about one axis only, on even ground and "
        "away from moving iron.",
    )
