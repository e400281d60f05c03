"""The one form every calibration has: `m_body = A (m_raw - h)`, twelve numbers."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from magcal_ros.core.geometry.arrays import FloatArray, frozen_array

PARAMETERS = 12
"""A row by row (9, dimensionless), then h (3, tesla): the order of every 12 x 12 covariance."""


@dataclass(frozen=True, eq=False)
class Correction:
    """Takes the raw field to the field in body axes, `A (m_raw - h)`.

    Raises
    ------
    ValueError
        If a number is not finite, or if `matrix` is singular or mirrors the axes.
    """

    matrix: FloatArray
    """A, dimensionless; must be invertible and keep handedness. Shape (3, 3)."""
    hard_iron: FloatArray
    """h in tesla, in the magnetometer's own axes. Shape (3,)."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "matrix", frozen_array(self.matrix, (3, 3), "correction matrix"))
        object.__setattr__(self, "hard_iron", frozen_array(self.hard_iron, (3,), "hard iron"))
        if np.linalg.det(self.matrix) <= 1e-9:
            raise ValueError("the correction matrix is singular or mirrors the axes")

    @classmethod
    def identity(cls) -> Correction:
        """Return the correction that changes nothing."""
        return cls(np.eye(3), np.zeros(3))

    @classmethod
    def from_parameters(cls, parameters: npt.ArrayLike) -> Correction:
        """Build from the twelve numbers in the order of `parameters`."""
        numbers = np.asarray(parameters, dtype=np.float64)
        return cls(numbers[:9].reshape(3, 3), numbers[9:])

    @property
    def parameters(self) -> FloatArray:
        """The twelve numbers: A row by row, then h; shape (12,)."""
        return np.concatenate([self.matrix.ravel(), self.hard_iron])

    def is_same(self, other: Correction) -> bool:
        """Whether all twelve numbers are equal."""
        return np.array_equal(self.parameters, other.parameters)

    def apply(self, field: FloatArray) -> FloatArray:
        """Correct fields (..., 3) in tesla; returns body axes, same shape and unit."""
        return np.asarray((field - self.hard_iron) @ self.matrix.T)

    def undo(self, field_body: FloatArray) -> FloatArray:
        """Return the raw fields (..., 3) that `apply` would take to `field_body`."""
        return np.asarray(field_body @ np.linalg.inv(self.matrix).T + self.hard_iron)

    def covariance(self, sigma: FloatArray) -> FloatArray:
        """Carry the covariance (3, 3) of one raw field sample into body axes, `A S A^T`."""
        return np.asarray(self.matrix @ sigma @ self.matrix.T)

    def after(self, first: Correction) -> Correction:
        """Return the correction equal to applying `first` and then this one."""
        matrix = self.matrix @ first.matrix
        return Correction(matrix, first.hard_iron + np.linalg.solve(first.matrix, self.hard_iron))
