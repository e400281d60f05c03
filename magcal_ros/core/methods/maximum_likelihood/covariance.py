"""From the information on the globals to the covariance of the twelve numbers."""

from __future__ import annotations

import numpy as np

from magcal_ros.core.arrays import FloatArray
from magcal_ros.core.correction import PARAMETERS, Correction
from magcal_ros.core.methods.maximum_likelihood import parameters as p
from magcal_ros.core.methods.maximum_likelihood.parameters import Globals


def correction_from(shared: Globals, mounting: FloatArray, scale: float) -> Correction:
    """Return `m_body = A (m_raw - h)` in tesla; `scale` is the tesla of one field scale."""
    matrix = np.asarray(np.linalg.inv(shared.distortion(mounting)), dtype=np.float64)
    return Correction(matrix, scale * shared.hard_iron)


def correction_jacobian(shared: Globals, mounting: FloatArray, scale: float) -> FloatArray:
    """Return the derivative of A (row by row) and h by all globals, shape (12, 18).

    `A = D^-1`, so `dA = -A dD A`.
    """
    inverse = np.linalg.inv(shared.distortion(mounting))
    moves = -inverse @ shared.distortion_derivatives(mounting) @ inverse
    jacobian = np.zeros((PARAMETERS, p.COUNT))
    jacobian[:9, p.MATRIX_PARAMETERS] = moves.reshape(len(moves), 9).T
    jacobian[9:, p.HARD_IRON] = scale * np.eye(3)
    return jacobian


def inverse_information(information: FloatArray) -> FloatArray:
    """Invert a symmetric information matrix whose parameters differ in size.

    Directions without information get a huge variance instead of a failure.
    """
    size = np.sqrt(np.maximum(np.diag(information), 1e-12))
    values, vectors = np.linalg.eigh(information / np.outer(size, size))
    values = np.maximum(values, 1e-13)
    return np.asarray((vectors / values) @ vectors.T / np.outer(size, size))
