"""How the hard iron's uncertainty bends.

The samples say to within a few parts in ten thousand where the middle of their arc lies in the
raw field, and much less how the sensor sits. Where the installation turns, the hard iron swings
about that middle: on a short arc so far that the straight line along which a covariance says it
moves leaves the circle by more than the middle is uncertain. What the circle departs from its
tangent is a second-order term of the estimate, and its mean square belongs to the covariance.
"""

from __future__ import annotations

import numpy as np

from magcal_ros.core.arrays import FloatArray
from magcal_ros.core.methods.maximum_likelihood import parameters as p
from magcal_ros.core.methods.maximum_likelihood.parameters import Globals

BENDING = np.array([*p.MATRIX_PARAMETERS, p.STRENGTH, p.INCLINATION])
"""The parameters that the middle of the raw field does not follow in a straight line."""
STEP = 1e-4


def bend_of_hard_iron(
    shared: Globals, turn: FloatArray, mounting: FloatArray, covariance: FloatArray
) -> FloatArray:
    """Return the mean square of what the hard iron departs from its tangent, shape (3, 3).

    For a second-order term `q_k = x^T H_k x / 2` of a Gaussian x with covariance C,
    `E q_k q_l = (tr(H_k C) tr(H_l C) + 2 tr(H_k C H_l C)) / 4`.

    Parameters
    ----------
    shared : Globals
        The optimum.
    turn : ndarray, shape (3, 3)
        Mean of the attitudes in the turn's frame.
    mounting : ndarray, shape (3, 3)
    covariance : ndarray, shape (18, 18)
        Of the globals; zero where not free.

    Returns
    -------
    ndarray, shape (3, 3)
        In squared field scales.
    """
    spread = covariance[np.ix_(BENDING, BENDING)]
    curved = _second_derivative(shared, turn, mounting) @ spread
    trace = np.trace(curved, axis1=1, axis2=2)
    return np.asarray(0.25 * (np.outer(trace, trace) + 2.0 * np.einsum("kij,lji", curved, curved)))


def _second_derivative(shared: Globals, turn: FloatArray, mounting: FloatArray) -> FloatArray:
    """Return the Hessians of the middle's three coordinates by `BENDING`, (3, b, b)."""
    hessian = np.zeros((3, len(BENDING), len(BENDING)))
    for row, parameter in enumerate(BENDING):
        step = np.zeros(p.COUNT)
        step[parameter] = STEP
        ahead = _first_derivative(shared.moved(step), turn, mounting)
        behind = _first_derivative(shared.moved(-step), turn, mounting)
        hessian[:, row] = (ahead - behind) / (2.0 * STEP)
    return np.asarray(0.5 * (hessian + hessian.swapaxes(1, 2)))


def _first_derivative(shared: Globals, turn: FloatArray, mounting: FloatArray) -> FloatArray:
    """Return the middle of the raw field by `BENDING`, shape (3, b)."""
    to_body = shared.body_axis @ turn @ shared.world_axis.T
    field, distortion = to_body @ shared.field_enu, shared.distortion(mounting)
    by_strength = distortion @ field / shared.strength
    by_inclination = distortion @ to_body @ shared.field_enu_by_inclination
    by_matrix = shared.distortion_derivatives(mounting) @ field
    return np.column_stack([by_matrix.T, by_strength, by_inclination])
