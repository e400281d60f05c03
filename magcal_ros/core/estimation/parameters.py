"""The numbers that all samples of a turn share, and how they move on their manifold."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from magcal_ros.core.geometry.arrays import FloatArray
from magcal_ros.core.geometry.rotations import exp_rotation, rotation_from_rpy, skew

BODY_AXIS = slice(0, 2)
WORLD_AXIS = slice(2, 4)
ROLL = 4
PITCH = 5
HARD_IRON = slice(6, 9)
STRENGTH = 9
INCLINATION = 10
SOFT_IRON = slice(11, 17)
YAW = 17
COUNT = 18
"""Length of a step: the order of the slices above."""

MATRIX_PARAMETERS = np.array([ROLL, PITCH, *range(11, 17), YAW])
"""The parameters that, with the hard iron, make up a correction."""

SOFT_IRON_BASIS: FloatArray = np.zeros((6, 3, 3))
"""Symmetric matrices that the six soft-iron numbers multiply: xx, yy, zz, xy, xz, yz."""
for _index, (_row, _column) in enumerate([(0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)]):
    SOFT_IRON_BASIS[_index, _row, _column] = SOFT_IRON_BASIS[_index, _column, _row] = 1.0
SOFT_IRON_BASIS.setflags(write=False)


@dataclass(frozen=True, eq=False)
class Globals:
    """What every sample of the turn shares; field quantities in units of the field scale.

    Parameters
    ----------
    body_axis : ndarray, shape (3, 3)
        Rotation whose last column is the turn's axis in body axes.
    world_axis : ndarray, shape (3, 3)
        Rotation whose last column is the turn's axis in magnetic ENU.
    roll, pitch : float
        Installation error, radians.
    hard_iron : ndarray, shape (3,)
    strength : float
    inclination : float
        Radians.
    soft_iron : ndarray, shape (6,)
        Elements xx, yy, zz, xy, xz, yz of E.
    yaw : float
        Of the installation, radians. One turn cannot show it and leaves it at zero.
    """

    body_axis: FloatArray
    world_axis: FloatArray
    roll: float
    pitch: float
    hard_iron: FloatArray
    strength: float
    inclination: float
    soft_iron: FloatArray = field(default_factory=lambda: np.zeros(6))
    yaw: float = 0.0

    @property
    def installation(self) -> FloatArray:
        """Body to installed axes, shape (3, 3)."""
        return np.asarray(rotation_from_rpy(self.roll, self.pitch, self.yaw).T)

    @property
    def soft_iron_matrix(self) -> FloatArray:
        """I + E, shape (3, 3)."""
        xx, yy, zz, xy, xz, yz = self.soft_iron.tolist()
        return np.array([[1.0 + xx, xy, xz], [xy, 1.0 + yy, yz], [xz, yz, 1.0 + zz]])

    @property
    def field_enu(self) -> FloatArray:
        """The reference field in magnetic ENU."""
        level, down = math.cos(self.inclination), math.sin(self.inclination)
        return np.array([0.0, self.strength * level, -self.strength * down])

    @property
    def field_enu_by_inclination(self) -> FloatArray:
        """Derivative of `field_enu` by the inclination."""
        level, down = math.cos(self.inclination), math.sin(self.inclination)
        return np.array([0.0, -self.strength * down, -self.strength * level])

    def distortion(self, mounting: FloatArray) -> FloatArray:
        """Return the matrix from the field in body axes to the raw field, shape (3, 3)."""
        return np.asarray(mounting @ self.soft_iron_matrix @ self.installation)

    def distortion_derivatives(self, mounting: FloatArray) -> FloatArray:
        """Return d(distortion) by `MATRIX_PARAMETERS`, in their order, shape (9, 3, 3)."""
        turn = self.installation
        iron = self.soft_iron_matrix
        by_roll = -mounting @ iron @ skew(np.array([1.0, 0.0, 0.0])) @ turn
        about_y = rotation_from_rpy(0.0, 0.0, self.yaw) @ np.array([0.0, 1.0, 0.0])
        by_pitch = -mounting @ iron @ turn @ skew(about_y)
        by_yaw = -mounting @ iron @ turn @ skew(np.array([0.0, 0.0, 1.0]))
        by_soft_iron = mounting @ SOFT_IRON_BASIS @ turn
        return np.concatenate([by_roll[None], by_pitch[None], by_soft_iron, by_yaw[None]])

    def moved(self, step: FloatArray) -> Globals:
        """Return the globals after a step of `COUNT` numbers, on the manifold for both axes.

        Strength and inclination move the field in a straight line: a circle shows the part of it
        that is level, and a step in which the two make up for each other must leave that alone.
        """
        strength, inclination = self._moved_field(float(step[STRENGTH]), float(step[INCLINATION]))
        return Globals(
            self.body_axis @ exp_rotation(np.array([*step[BODY_AXIS], 0.0])),
            self.world_axis @ exp_rotation(np.array([*step[WORLD_AXIS], 0.0])),
            self.roll + float(step[ROLL]),
            self.pitch + float(step[PITCH]),
            self.hard_iron + step[HARD_IRON],
            strength,
            inclination,
            self.soft_iron + step[SOFT_IRON],
            self.yaw + float(step[YAW]),
        )

    def _moved_field(self, longer: float, steeper: float) -> tuple[float, float]:
        # A strength that is known exactly is not moved at all, and a straight line would.
        if longer == 0.0:
            return self.strength, self.inclination + steeper
        ahead, aside = self.strength + longer, self.strength * steeper
        return math.hypot(ahead, aside), self.inclination + math.atan2(aside, ahead)
