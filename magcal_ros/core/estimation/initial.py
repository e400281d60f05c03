"""Closed-form first guesses: every way the axis, the circle and the dip can fit together.

(doc/estimator.md, section 7.)
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from magcal_ros.core.estimation.model import Samples, State, about_z
from magcal_ros.core.estimation.parameters import Globals
from magcal_ros.core.geometry.arrays import FloatArray
from magcal_ros.core.geometry.attitude import unit
from magcal_ros.core.geometry.circle3d import Circle, fit_circle_robustly
from magcal_ros.core.geometry.planes import plane_normal
from magcal_ros.core.geometry.rotations import (
    minimal_rotation,
    roll_pitch_between,
    rotation_from_rpy,
)
from magcal_ros.core.knowledge import ReferenceField

UP: FloatArray = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True)
class GuessTuning:
    """What the first guesses rest on.

    Parameters
    ----------
    visible_cone : float
        A circle of up vectors is seen where its variance exceeds its thickness by this factor.
    thinnest_cone : float
        Standard deviation, of unit vectors, that its thickness is taken for at least.
    inclination : float
        Radians either way, tried where neither the field's strength nor its dip is known.
    """

    visible_cone: float = 4.0
    thinnest_cone: float = 0.005
    inclination: float = math.radians(60.0)


GUESS = GuessTuning()


def starts(samples: Samples, reference: ReferenceField, scale: float, sense: float) -> list[State]:
    """Return first guesses for the fit, in no particular order.

    Parameters
    ----------
    samples : Samples
    reference : ReferenceField
    scale : float
        Tesla of one field scale.
    sense : float
        +1 where the field's plane normal shall point along the axis (magnetometer less than a
        quarter turn off its nominal pose), -1 where the gyro showed it upside down.
    """
    points = samples.field @ np.linalg.inv(samples.mounting).T
    circle = fit_circle_robustly(points)
    field = _FieldGuess(reference, scale)
    found: list[State] = []
    for axis in axes(samples.up):
        normal = circle.normal * math.copysign(1.0, sense * float(circle.normal @ axis))
        for roll, pitch in roll_pitch_between(axis, normal, or_nearest=True):
            turn = _turn_angles(points, circle, axis, roll, pitch)
            found.extend(_with_dips(samples, circle, normal, axis, (roll, pitch), turn, field))
    level = _level_start(samples, points, field)
    return [*found, level] if level is not None else found


def axes(up: FloatArray) -> list[FloatArray]:
    """Return candidates for the turn's axis in body axes: mean of up, and normal of its circle."""
    mean = unit(up.mean(axis=0))
    normal, variances = plane_normal(up)
    if variances[1] < GUESS.visible_cone * max(variances[0], GUESS.thinnest_cone**2):
        return [mean]
    return [mean, normal * math.copysign(1.0, float(normal @ mean))]


def _turn_angles(
    points: FloatArray,
    circle: Circle,
    axis: FloatArray,
    roll: float,
    pitch: float,
) -> FloatArray:
    """Return each sample's turn about the axis so that the field lies at angle zero, (n,)."""
    body_axis = minimal_rotation(UP, axis)
    turned = (points - circle.centre) @ rotation_from_rpy(roll, pitch).T @ body_axis
    return np.asarray(np.arctan2(turned[:, 1], turned[:, 0]))


class _FieldGuess:
    """Strength and dip as far as they are known before the fit."""

    def __init__(self, reference: ReferenceField, scale: float) -> None:
        strength, inclination = reference.strength, reference.inclination
        self.strength = None if strength.is_unknown else strength.value / scale
        self.inclination = None if inclination.is_unknown else inclination.value

    def elevations(
        self, up: FloatArray, circle: Circle, height: float
    ) -> Iterator[tuple[float, float]]:
        """Yield (angle of the field over the turn's plane, strength), radians and field scales.

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
            angles = [-GUESS.inclination, math.atan2(height, circle.radius), GUESS.inclination]
        for angle in angles:
            level = math.cos(angle)
            if level > 0.02:
                known = self.strength
                yield angle, known if known is not None else circle.radius / max(level, 0.05)

    def globals_from(
        self,
        body_axis: FloatArray,
        up: FloatArray,
        field: FloatArray,
        installation: tuple[float, float],
        hard_iron: FloatArray,
    ) -> Globals:
        """Build the globals whose world frame fits `up` and `field` in the turn's frame."""
        strength = float(np.linalg.norm(field))
        sine = -float(up @ field) / max(strength, 1e-12)
        seen = math.asin(min(1.0, max(-1.0, sine)))
        inclination = self.inclination if self.inclination is not None else seen
        return Globals(
            body_axis,
            _world_axis(up, field),
            *installation,
            hard_iron,
            self.strength if self.strength is not None else strength,
            inclination,
        )


def _with_dips(
    samples: Samples,
    circle: Circle,
    normal: FloatArray,
    axis: FloatArray,
    installation: tuple[float, float],
    turn: FloatArray,
    guess: _FieldGuess,
) -> Iterator[State]:
    """Yield a state for each way the field can stand over the turn's plane."""
    body_axis = minimal_rotation(UP, axis)
    attitude = about_z(turn)
    up = unit(np.einsum("nji,nj->i", attitude, samples.up @ body_axis) / len(samples))
    height = float(circle.centre @ normal)
    for angle, strength in guess.elevations(up, circle, height):
        field = strength * np.array([math.cos(angle), 0.0, math.sin(angle)])
        hard_iron = samples.mounting @ (circle.centre - field[2] * normal)
        shared = guess.globals_from(body_axis, up, field, installation, hard_iron)
        yield State(shared, attitude)


def _level_start(samples: Samples, points: FloatArray, guess: _FieldGuess) -> State | None:
    """Guess without installation error: `m.u = c + h.u` and `|m|^2 = 2 m.h + k`, linear in h.

    It needs no circle, so it survives a turn that wobbles too much to draw one.
    """
    if guess.strength is None or guess.inclination is None:
        return None
    n = len(samples)
    vertical = -guess.strength * math.sin(guess.inclination)
    size = 2.0 * guess.strength
    rows = np.block(
        [
            [samples.up, np.zeros((n, 1))],
            [2.0 * points / size, np.full((n, 1), 1.0 / size)],
            [1e-3 * math.sqrt(n) * np.eye(3), np.zeros((3, 1))],
        ]
    )
    along = np.sum(points * samples.up, axis=1) - vertical
    right = np.concatenate([along, np.sum(points**2, axis=1) / size, np.zeros(3)])
    centre = np.linalg.lstsq(rows, right, rcond=None)[0][:3]
    body_axis = minimal_rotation(UP, unit(samples.up.mean(axis=0)))
    turned = (points - centre) @ body_axis
    attitude = about_z(np.arctan2(turned[:, 1], turned[:, 0]))
    up = unit(np.einsum("nji,nj->i", attitude, samples.up @ body_axis))
    field = np.einsum("nji,nj->i", attitude, turned) / n
    if np.linalg.norm(np.cross(up, field)) < 1e-6:
        return None
    shared = guess.globals_from(body_axis, up, field, (0.0, 0.0), samples.mounting @ centre)
    return State(shared, attitude)


def _world_axis(up: FloatArray, field: FloatArray) -> FloatArray:
    """Return the rotation from the turn's frame to magnetic ENU that fits up and field."""
    east = unit(np.cross(field, up))
    return np.stack([east, np.cross(up, east), up])
