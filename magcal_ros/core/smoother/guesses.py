"""Where the iterations begin without a gyro: every way axis, circle and dip can fit together."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from magcal_ros.core.geometry.arrays import FloatArray
from magcal_ros.core.geometry.attitude import unit
from magcal_ros.core.geometry.planes import Circle, fit_circle_robustly, plane_normal
from magcal_ros.core.geometry.rotations import (
    minimal_rotation,
    roll_pitch_between,
    rotation_about,
    rotation_from_rpy,
)
from magcal_ros.core.knowledge import ReferenceField
from magcal_ros.core.smoother.unknowns import MICROTESLA

VISIBLE_CONE = 4.0
"""A circle of up vectors is seen where its variance exceeds its thickness by this factor."""
THINNEST_CONE = 0.005
"""Standard deviation, of unit vectors, that its thickness is taken for at least."""
DIP = math.radians(60.0)
"""Either way: tried where neither the field's strength nor its dip is known."""
Z = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True, eq=False)
class Guess:
    """One way in which axis, circle and dip fit together."""

    attitude: FloatArray
    """Magnetic ENU to body axes. Shape (n, 3, 3)."""
    axis: FloatArray
    """Of the turn, in body axes. Shape (3,)."""
    iron: FloatArray
    """Hard iron, µT. Shape (3,)."""
    roll: float
    pitch: float
    """Of the installation, radians."""
    strength: float
    inclination: float
    """µT, radians."""


def starts(field: FloatArray, up: FloatArray, reference: ReferenceField) -> list[Guess]:
    """Return first guesses in no particular order.

    Parameters
    ----------
    field : ndarray, shape (n, 3)
        In nominal body axes, µT.
    up : ndarray, shape (n, 3)
        Unit vectors in body axes.
    reference : ReferenceField
    """
    circle = fit_circle_robustly(field)
    dips = _Dips(reference)
    found: list[Guess] = []
    for axis in _axes(up):
        normal = circle.normal * math.copysign(1.0, float(circle.normal @ axis))
        for tilt in roll_pitch_between(axis, normal, or_nearest=True):
            found.extend(_with_dips(field, up, circle, normal, axis, tilt, dips))
    level = _level_start(field, up, dips)
    return [*found, level] if level is not None else found


def _axes(up: FloatArray) -> list[FloatArray]:
    """Return candidates for the turn's axis in body axes: mean of up, and normal of its circle."""
    mean = unit(up.mean(axis=0))
    normal, variances = plane_normal(up)
    if variances[1] < VISIBLE_CONE * max(variances[0], THINNEST_CONE**2):
        return [mean]
    return [mean, normal * math.copysign(1.0, float(normal @ mean))]


class _Dips:
    """Strength (µT) and dip as far as they are known before the fit."""

    def __init__(self, reference: ReferenceField) -> None:
        strength, inclination = reference.strength, reference.inclination
        self.strength = None if strength.is_unknown else strength.value * MICROTESLA
        self.inclination = None if inclination.is_unknown else inclination.value

    def elevations(
        self, up: FloatArray, circle: Circle, height: float
    ) -> Iterator[tuple[float, float]]:
        """Yield (angle of the field over the turn's plane, strength), radians and µT.

        `up` is in the turn's frame with the field at angle zero, `height` the circle's centre
        along the axis, hard iron included.
        """
        if self.inclination is not None:
            reach, phase = math.hypot(up[0], up[2]), math.atan2(up[2], up[0])
            ratio = -math.sin(self.inclination) / max(reach, 1e-9)
            opening = math.acos(min(1.0, max(-1.0, ratio)))
            angles = [phase + opening, phase - opening]
        elif self.strength is not None:
            opening = math.acos(min(1.0, circle.radius / self.strength))
            angles = [-opening, opening]
        else:
            angles = [-DIP, math.atan2(height, circle.radius), DIP]
        for angle in angles:
            level = math.cos(angle)
            if level > 0.02:
                known = self.strength
                yield angle, known if known is not None else circle.radius / max(level, 0.05)

    def guess(
        self,
        turned: FloatArray,
        up: FloatArray,
        field: FloatArray,
        tilt: tuple[float, float],
        iron: FloatArray,
    ) -> Guess:
        """Return the guess whose world fits `up` and `field` in the turn's frame.

        `turned` (n, 3, 3) leads from the turn's frame to body axes.
        """
        strength = float(np.linalg.norm(field))
        sine = -float(up @ field) / max(strength, 1e-12)
        seen = math.asin(min(1.0, max(-1.0, sine)))
        east = unit(np.cross(field, up))
        world = np.stack([east, np.cross(up, east), up])
        return Guess(
            turned @ world.T,
            turned[0, :, 2],
            iron,
            *tilt,
            self.strength if self.strength is not None else strength,
            self.inclination if self.inclination is not None else seen,
        )


def _with_dips(
    field: FloatArray,
    up: FloatArray,
    circle: Circle,
    normal: FloatArray,
    axis: FloatArray,
    tilt: tuple[float, float],
    dips: _Dips,
) -> Iterator[Guess]:
    """Yield a guess for each way the field can stand over the turn's plane."""
    body_axis = minimal_rotation(Z, axis)
    installed = (field - circle.centre) @ rotation_from_rpy(*tilt).T @ body_axis
    turned = body_axis @ _turned_to(installed)
    shown = unit(np.einsum("nji,nj->i", turned, up) / len(up))
    height = float(circle.centre @ normal)
    for angle, strength in dips.elevations(shown, circle, height):
        above = strength * np.array([math.cos(angle), 0.0, math.sin(angle)])
        yield dips.guess(turned, shown, above, tilt, circle.centre - above[2] * normal)


def _turned_to(field: FloatArray) -> FloatArray:
    """Return rotations about z (n, 3, 3) that take x to where vectors (n, 3) point."""
    return rotation_about(Z, np.arctan2(field[:, 1], field[:, 0]))


def _level_start(field: FloatArray, up: FloatArray, dips: _Dips) -> Guess | None:
    """Guess without installation error: `m.u = c + h.u` and `|m|^2 = 2 m.h + k`, linear in h.

    It needs no circle, so it survives a turn that wobbles too much to draw one.
    """
    if dips.strength is None or dips.inclination is None:
        return None
    n = len(field)
    vertical = -dips.strength * math.sin(dips.inclination)
    size = 2.0 * dips.strength
    rows = np.block(
        [
            [up, np.zeros((n, 1))],
            [2.0 * field / size, np.full((n, 1), 1.0 / size)],
            [1e-3 * math.sqrt(n) * np.eye(3), np.zeros((3, 1))],
        ]
    )
    along = np.sum(field * up, axis=1) - vertical
    right = np.concatenate([along, np.sum(field**2, axis=1) / size, np.zeros(3)])
    centre = np.linalg.lstsq(rows, right, rcond=None)[0][:3]
    body_axis = minimal_rotation(Z, unit(up.mean(axis=0)))
    turned = body_axis @ _turned_to((field - centre) @ body_axis)
    shown = unit(np.einsum("nji,nj->i", turned, up))
    above = np.einsum("nji,nj->i", turned, field - centre) / n
    if np.linalg.norm(np.cross(shown, above)) < 1e-6 * dips.strength:
        return None
    return dips.guess(turned, shown, above, (0.0, 0.0), centre)
