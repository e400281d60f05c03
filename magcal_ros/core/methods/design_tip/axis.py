"""The turn's axis in the body, from the accelerometer."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from magcal_ros.core.errors import Reason, Refusal
from magcal_ros.core.geometry.arrays import FloatArray
from magcal_ros.core.geometry.planes import Plane
from magcal_ros.core.methods.design_tip.circle import FieldCircle
from magcal_ros.core.methods.design_tip.options import AxisSource, Options
from magcal_ros.core.methods.design_tip.tip_frame import ROUNDING, TipSamples

SMALLEST_AXIAL_GRAVITY = float(np.cos(np.radians(75.0)))
"""The field along the axis is known to 1/this of the inclination's own uncertainty."""


@dataclass(frozen=True, eq=False)
class TurnAxis:
    """The axis of the turn."""

    direction: FloatArray
    """In body axes, forward-right-down; unit, downwards. Shape (3,)."""
    axial_gravity: float
    """Cosine of the axis's angle from the vertical."""
    across: FloatArray
    """Gravity across the axis, body axes, gravity = 1. Shape (n, 3)."""
    noise: float
    """Standard deviation of the accelerometer per axis, gravity = 1, which is radians of tilt."""

    @property
    def tilt(self) -> float:
        """Radians of the axis from the vertical."""
        return float(np.arccos(min(1.0, self.axial_gravity)))


def find_axis(samples: TipSamples, circle: FieldCircle, options: Options) -> TurnAxis:
    """Combine the centre of gravity's circle with the normal of its plane.

    On a level turn gravity stands still and only its mean tells of the axis; on a tilted one the
    normal tells more. Each is weighed by the information it carries, so that nothing switches.
    The centre is the constant part of gravity when the field's phase explains the rest: on part
    of a turn the plain mean does not lie on the axis.

    Parameters
    ----------
    samples : TipSamples
        The turn.
    circle : FieldCircle
        Gives the phases.
    options : Options
        Plane fit and source of the axis.

    Raises
    ------
    Refusal
        If the axis is horizontal or nearly so, or the wanted source does not show it.
    """
    centre, centre_sigma, noise = _centre_of_gravity(samples.down, circle)
    if float(np.linalg.norm(centre)) < SMALLEST_AXIAL_GRAVITY:
        raise _horizontal()
    try:
        plane = options.plane(samples.down)
    except Refusal:
        plane = None
    direction = _weighed(centre, centre_sigma, plane, options.axis)
    axial = samples.down @ direction
    axial_gravity = float(axial.mean())
    if axial_gravity < SMALLEST_AXIAL_GRAVITY:
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
    return coefficients[0], max(noise, ROUNDING) * float(np.sqrt(covariance[0, 0])), noise


def _weighed(
    centre: FloatArray, centre_sigma: float, plane: Plane | None, source: AxisSource
) -> FloatArray:
    from_centre = centre / np.linalg.norm(centre)
    if source is AxisSource.MEAN or (plane is None and source is AxisSource.AUTO):
        return np.asarray(from_centre)
    if plane is None:
        raise Refusal(
            Reason.NO_MOTION,
            "Gravity stood still, as it does on level ground, so its plane does not show the axis. "
            "Take the axis from its mean as well (axis = auto).",
        )
    from_plane = plane.normal * (1.0 if plane.normal @ centre >= 0.0 else -1.0)
    if source is AxisSource.PLANE:
        return np.asarray(from_plane)
    centre_information = float(centre @ centre) / centre_sigma**2
    plane_information = plane.normal_information(ROUNDING)
    direction = from_centre
    # The two are weighed in the tangent plane of the result, which a few rounds find.
    for _ in range(3):
        tangent = np.linalg.svd(direction[None, :])[2][1:].T
        of_plane = tangent.T @ plane_information @ tangent
        weighed = centre_information * tangent.T @ from_centre + of_plane @ tangent.T @ from_plane
        step = tangent @ np.linalg.solve(of_plane + centre_information * np.eye(2), weighed)
        direction = direction + step
        direction = direction / np.linalg.norm(direction)
    return np.asarray(direction)


def _horizontal() -> Refusal:
    return Refusal(
        Reason.AXIS_HORIZONTAL,
        "The robot turned about a nearly horizontal axis. Turn about an axis within 75° of the "
        "vertical, best on the wheels.",
    )
