"""A circle in space: where the field of a turning robot lies."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from magcal_ros.core.arrays import FloatArray
from magcal_ros.core.attitude import unit
from magcal_ros.core.conics import fit_circle_taubin


@dataclass(frozen=True, eq=False)
class Circle:
    """A circle in space.

    Parameters
    ----------
    centre : ndarray, shape (3,)
        In the unit of the points.
    basis : ndarray, shape (3, 3)
        Rows: two axes in the plane and the normal, unit, right-handed.
    radius : float
        In the unit of the points.
    """

    centre: FloatArray
    basis: FloatArray
    radius: float

    def phase(self, points: FloatArray) -> FloatArray:
        """Return the angles (n,) of points (n, 3) about the normal, radians."""
        across = (points - self.centre) @ self.basis[:2].T
        return np.asarray(np.arctan2(across[:, 1], across[:, 0]))

    def at(self, phase: FloatArray) -> FloatArray:
        """Return the points (n, 3) at angles (n,)."""
        around = np.stack([np.cos(phase), np.sin(phase)], axis=-1)
        return np.asarray(self.centre + self.radius * around @ self.basis[:2])


def fit_circle_in_space(points: FloatArray, upwards: FloatArray) -> Circle:
    """Fit the plane of least spread and Taubin's circle in it.

    Parameters
    ----------
    points : ndarray, shape (n, 3)
        In any unit.
    upwards : ndarray, shape (3,)
        The side to which the normal shall point.

    Returns
    -------
    Circle

    Raises
    ------
    Refusal
        If the points are too few, on a line, or one point.
    """
    middle = points.mean(axis=0)
    centred = points - middle
    axes = np.linalg.eigh(centred.T @ centred)[1]
    normal = axes[:, 0] if axes[:, 0] @ upwards >= 0.0 else -axes[:, 0]
    first = unit(np.cross(normal, axes[:, 1]))
    basis = np.stack([first, np.cross(normal, first), normal])
    flat = fit_circle_taubin(centred @ basis[:2].T)
    return Circle(middle + flat.centre @ basis[:2], basis, flat.radius)
