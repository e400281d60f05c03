"""The price of each sample's own lean: half the log-determinant of the information on it.

The leans are not parameters to report but are to be integrated out. To second order (Laplace)
that adds `1/2 sum log det L_i` to the cost, L_i the information on the two lean angles of sample
i. Leaving it out biases the hard iron along the axis as soon as strength or dip are loose and the
axis wobbles.

The turn angles are not integrated but taken at their optimum: a flat prior on them would say that
the samples lie all around the circle, and on a part of a turn that draws the circle small.

L_i is part of a sum over the sample's three vectors v (up, field, lean) of `[v]x^T S_v [v]x`, and
every vector moves by a cross product, so the gradient is exact and costs no more than a step.
"""

from __future__ import annotations

import numpy as np

from magcal_ros.core.arrays import FloatArray
from magcal_ros.core.methods.maximum_likelihood import parameters as p
from magcal_ros.core.methods.maximum_likelihood.linearise import Linearisation, Problem
from magcal_ros.core.methods.maximum_likelihood.model import field_by_inclination
from magcal_ros.core.rotations import skews

_WOBBLE_ROWS: FloatArray = np.diag([1.0, 1.0, 0.0])


def log_determinants(lin: Linearisation) -> FloatArray:
    """Return log det L_i of each sample, shape (n,); zero for a rigid axis."""
    blocks = lin.local_information
    if blocks.shape[1] == 1:
        return np.zeros(len(blocks))
    return np.log(blocks[:, 0, 0] * blocks[:, 1, 1] - blocks[:, 0, 1] ** 2)


def log_determinant_gradient(lin: Linearisation, problem: Problem) -> FloatArray:
    """Return the gradient of `1/2 sum log det L_i` of the counted samples, shape (g,).

    The attitudes follow the globals to their new optimum, `x = -D^-1 C^T dtheta`. Meant for a
    wobbling axis, where each sample has three local numbers.
    """
    state, prediction, noise = lin.state, lin.prediction, problem.noise
    counted = problem.weights.sample
    data = (problem.weights.data * counted)[:, None]
    matrix = prediction.field_matrix
    inverse = _lean_inverse(lin)
    by_up, _ = _by_vector(prediction.up, np.eye(3), inverse)
    by_field, spread = _by_vector(prediction.field, matrix.T @ matrix, inverse)
    by_lean, _ = _by_vector(state.lean, _WOBBLE_ROWS, inverse)
    by_up *= data / noise.up**2
    by_field *= data / noise.field**2
    by_lean *= (problem.weights.wobble * counted)[:, None] / noise.wobble**2
    spread = np.tensordot(data[:, 0] / noise.field**2, spread, axes=1)

    turn_data = np.cross(prediction.up, by_up) + np.cross(prediction.field, by_field)
    full = np.zeros(p.COUNT)
    full[p.WORLD_AXIS] = -np.einsum("nji,nj->i", state.attitude, turn_data)[:2]
    full[p.STRENGTH] = np.sum(by_field * prediction.field) / state.shared.strength
    full[p.INCLINATION] = np.sum(by_field * field_by_inclination(state))
    full += _through_field_matrix(lin, problem, matrix @ spread)

    turn = turn_data + np.cross(state.lean, by_lean)
    following = (lin.local_covariance @ turn[:, :, None])[:, :, 0]
    return np.asarray(0.5 * (full[problem.prior.free] - lin.through_attitudes(following)))


def _lean_inverse(lin: Linearisation) -> FloatArray:
    """Return L^-1 of each sample, with a row and column of zeros for the turn; (n, 3, 3)."""
    block = lin.local_information
    xx, xy, yy = block[:, 0, 0], block[:, 0, 1], block[:, 1, 1]
    inverse = np.zeros_like(block)
    inverse[:, 0, 0], inverse[:, 1, 1] = yy, xx
    inverse[:, 0, 1] = inverse[:, 1, 0] = -xy
    return np.asarray(inverse / (xx * yy - xy * xy)[:, None, None])


def _by_vector(
    vector: FloatArray, metric: FloatArray, inverse: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Differentiate `log det L` by a vector of the sample and by its metric.

    Returns the gradient (n, 3) for `[v]x^T metric [v]x`, and `[v]x L^-1 [v]x^T` (n, 3, 3).
    """
    cross = skews(vector)
    half = cross @ inverse
    product = metric @ half
    gradient = np.stack(
        [
            product[:, 2, 1] - product[:, 1, 2],
            product[:, 0, 2] - product[:, 2, 0],
            product[:, 1, 0] - product[:, 0, 1],
        ],
        axis=1,
    )
    return 2.0 * gradient, -half @ cross


def _through_field_matrix(lin: Linearisation, problem: Problem, weighted: FloatArray) -> FloatArray:
    """Return the gradient by the parameters that shape the matrix P in `S = P^T P`."""
    shared = lin.state.shared
    full = np.zeros(p.COUNT)
    matrices = shared.distortion_derivatives(problem.samples.mounting) @ shared.body_axis
    full[p.MATRIX_PARAMETERS] = 2.0 * np.tensordot(matrices, weighted, axes=2)
    tilts = lin.prediction.field_matrix @ skews(np.eye(3)[:2])
    full[p.BODY_AXIS] = 2.0 * np.tensordot(tilts, weighted, axes=2)
    return full
