"""Information matrices: inverted, and with part of their parameters eliminated."""

from __future__ import annotations

import numpy as np

from magcal_ros.core.geometry.arrays import FloatArray


def inverse_information(information: FloatArray) -> FloatArray:
    """Invert a symmetric information matrix whose parameters differ in size.

    Directions without information get a huge variance instead of a failure.
    """
    size = np.sqrt(np.maximum(np.diag(information), 1e-12))
    values, vectors = np.linalg.eigh(information / np.outer(size, size))
    values = np.maximum(values, 1e-13)
    return np.asarray((vectors / values) @ vectors.T / np.outer(size, size))


def without_own(information: FloatArray, own: int) -> FloatArray:
    """Eliminate the first `own` parameters (Schur complement)."""
    if own == 0:
        return information
    across = information[:own, own:]
    return np.asarray(
        information[own:, own:] - across.T @ inverse_information(information[:own, :own]) @ across
    )
