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

SWING = np.array([p.ROLL, p.PITCH])
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
    field = shared.body_axis @ turn @ shared.world_axis.T @ shared.field_enu
    hessian = np.zeros((3, len(SWING), len(SWING)))
    for row, parameter in enumerate(SWING):
        step = np.zeros(p.COUNT)
        step[parameter] = STEP
        ahead, behind = (
            shared.moved(way).distortion_derivatives(mounting)[: len(SWING)]
            for way in (step, -step)
        )
        hessian[:, row] = ((ahead - behind) @ field).T / (2.0 * STEP)
    curved = hessian @ covariance[np.ix_(SWING, SWING)]
    trace = np.trace(curved, axis1=1, axis2=2)
    return np.asarray(0.25 * (np.outer(trace, trace) + 2.0 * np.einsum("kij,lji", curved, curved)))
