"""From the optimum to the covariance of the twelve numbers (doc/estimator.md, section 10).

Three parts, and the one place for more: the inverse information on the globals times the
inefficiency factor; what the hard iron departs from its tangent; and soft iron that was left out
although it may be there.

The samples say to within a few parts in ten thousand where the middle of their arc lies in the
raw field, and much less how the sensor sits. Where the installation turns, the hard iron swings
about that middle: on a short arc so far that the straight line along which a covariance says it
moves leaves the circle by more than the middle is uncertain. What the circle departs from its
tangent is a second-order term of the estimate, and its mean square belongs to the covariance.
"""

from __future__ import annotations

import numpy as np

from magcal_ros.core.calibration.correction import PARAMETERS, Correction
from magcal_ros.core.calibration.heading_sigma import heading_jacobian
from magcal_ros.core.errors import Reason, Refusal
from magcal_ros.core.estimation import parameters as p
from magcal_ros.core.estimation.parameters import Globals
from magcal_ros.core.estimation.soft_iron_doubt import Doubt, Look
from magcal_ros.core.estimation.solver import Fit
from magcal_ros.core.geometry.arrays import FloatArray
from magcal_ros.core.geometry.attitude import field_in_enu

SWING = np.array([p.ROLL, p.PITCH])
STEP = 1e-4
"""Radians, for the second difference."""
SMALLEST_VOLUME = 1e-3
"""Share of the field's three directions that is left of a solid angle; less is no soft iron."""


def twelve_covariance(
    fit: Fit, scale: float, doubt: Doubt | None = None, axes: Look | None = None
) -> FloatArray:
    """Return the covariance of the twelve numbers in SI units, shape (12, 12).

    Parameters
    ----------
    fit : Fit
        The optimum.
    scale : float
        Tesla of one field scale.
    doubt : Doubt, optional
        Of soft iron that was not fitted.
    axes : Look, optional
        What gains and axes of the magnetometer would bring that are a little off.
    """
    jacobian = correction_jacobian(fit.shared, fit.mounting, scale)
    of_globals = fit.covariance if axes is None else axes.mean_square
    covariance = jacobian @ of_globals @ jacobian.T
    if len(fit.blocks) == 1:
        # Arcs on different tilts have middles apart, about which nothing can swing.
        block = fit.block
        turn = block.place.state.attitude[block.weighting.inliers].mean(axis=0)
        bend = bend_of_hard_iron(fit.shared, turn, fit.mounting, of_globals)
        covariance[9:, 9:] += scale**2 * bend
    if doubt is not None:
        covariance = doubt.widened(covariance, jacobian)
    return np.asarray(0.5 * (covariance + covariance.T))


def correction_from(shared: Globals, mounting: FloatArray, scale: float) -> Correction:
    """Return `m_body = A (m_raw - h)` in tesla; `scale` is the tesla of one field scale.

    Raises
    ------
    Refusal
        `NO_SOLUTION` where the fit made of soft iron what no iron does.
    """
    distortion = shared.distortion(mounting)
    if np.linalg.det(distortion) < SMALLEST_VOLUME * abs(np.linalg.det(mounting)):
        raise Refusal(
            Reason.NO_SOLUTION,
            "only iron that flattens or mirrors the field would explain this turn; check that the"
            " axes of gyro, accelerometer and magnetometer are one another's, and their signs",
        )
    matrix = np.asarray(np.linalg.inv(distortion), dtype=np.float64)
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


def heading_by_twelve(
    shared: Globals, mounting: FloatArray, scale: float, tilt: float = 0.0
) -> FloatArray:
    """Return the derivative of the yaw by the twelve numbers, as `heading_jacobian` does."""
    field = field_in_enu(scale * shared.strength, shared.inclination)
    return heading_jacobian(correction_from(shared, mounting, scale), field, tilt)


def level_heading_by_globals(fit: Fit, scale: float) -> FloatArray:
    """Return the derivative of the level yaw by all parameters, shape (24, 18)."""
    by_twelve = heading_by_twelve(fit.shared, fit.mounting, scale)
    return np.asarray(by_twelve @ correction_jacobian(fit.shared, fit.mounting, scale))


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
