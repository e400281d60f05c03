"""Marginalised leans: half the log-determinant of the information on each sample's own lean.

The leans are not parameters to report but are to be integrated out. To second order (Laplace)
that adds `1/2 sum log det S_i` to the cost, S_i the information on the two lean angles of sample
i. Leaving it out biases the hard iron along the axis as soon as strength or dip are loose and the
axis wobbles.

The turn angle is no more known beforehand than the leans, so S_i is what is left for them once
the turn angle took its share of the information D_i on all three: `S = D_ll - D_lz D_zz^-1 D_zl`,
`log det S = log det D - log D_zz`. Of the leans at a held turn angle the field would seem to say
more than it does, the more the stronger it is along the axis, and draw that part of it small. Of
all three the last term would be missing: it says that samples lie evenly all along the circle, and
on a part of a turn draws the circle small.

D_i is a sum over the sample's three vectors v (up, field, lean) of `[v]x^T P_v [v]x`, and every
vector moves by a cross product, so the gradient is exact and costs no more than a step
(doc/estimator.md, section 4).
"""

from __future__ import annotations

import numpy as np

from magcal_ros.core.estimation import parameters as p
from magcal_ros.core.estimation.free_equations import LocalEquations, SchurSystem
from magcal_ros.core.estimation.model import field_by_inclination
from magcal_ros.core.estimation.weighting import Noise
from magcal_ros.core.geometry.arrays import FloatArray
from magcal_ros.core.geometry.rotations import axial_vectors, skews

_WOBBLE_ROWS: FloatArray = np.diag([1.0, 1.0, 0.0])


def log_determinants(local: LocalEquations) -> FloatArray:
    """Return log det S_i of each sample, shape (n,); zero for a rigid axis."""
    if local.covariance.shape[1] == 1:
        return np.zeros(len(local.covariance))
    # The leans' block of the inverse of D is the inverse of S.
    of_leans = local.covariance
    return np.asarray(-np.log(of_leans[:, 0, 0] * of_leans[:, 1, 1] - of_leans[:, 0, 1] ** 2))


def log_turn_informations(local: LocalEquations, noise: Noise) -> FloatArray:
    """Return log of what the noise leaves of the information on each turn angle, shape (n,).

    The turn angle integrated out with a prior that is even along the path of up and field: what
    models of different noise have to be compared by, since the angle takes its share of a sample.
    """
    turn = local.jacobian[:, :, -1]
    path = turn / noise.whitening
    return np.asarray(np.log(np.sum(turn**2, axis=1) / np.sum(path**2, axis=1)))


def log_determinant_gradient(system: SchurSystem) -> FloatArray:
    """Return the gradient of `1/2 sum log det S_i` of the counted samples, shape (f,).

    The attitudes follow the globals to their new optimum, `x = -D^-1 C^T dtheta`. Meant for a
    wobbling axis, where each sample has three local numbers.
    """
    state, prediction = system.place.state, system.place.prediction
    noise, weights = system.weighting.noise, system.weighting.weights
    data = (weights.data * weights.sample)[:, None]
    matrix = prediction.field_matrix
    inverse = _inverse_beyond_turn(system)
    by_up, _ = _by_vector(prediction.up, np.eye(3), inverse)
    by_field, spread = _by_vector(prediction.field, matrix.T @ matrix, inverse)
    by_lean, _ = _by_vector(state.lean, _WOBBLE_ROWS, inverse)
    by_up *= data / noise.up**2
    by_field *= data / noise.field**2
    by_lean *= (weights.wobble * weights.sample)[:, None] / noise.wobble**2
    spread = np.tensordot(data[:, 0] / noise.field**2, spread, axes=1)

    turn_data = np.cross(prediction.up, by_up) + np.cross(prediction.field, by_field)
    full = np.zeros(p.COUNT)
    full[p.WORLD_AXIS] = -np.einsum("nji,nj->i", state.attitude, turn_data)[:2]
    full[p.STRENGTH] = np.sum(by_field * prediction.field) / state.shared.strength
    full[p.INCLINATION] = np.sum(by_field * field_by_inclination(state))
    full += _through_field_matrix(system, matrix @ spread)

    turn = turn_data + np.cross(state.lean, by_lean)
    following = (system.local.covariance @ turn[:, :, None])[:, :, 0]
    return np.asarray(0.5 * (full[system.free] - system.through_attitudes(following)))


def _inverse_beyond_turn(system: SchurSystem) -> FloatArray:
    """Return the inverse of D less that of its turn alone: d log det S = tr(this dD), (n, 3, 3)."""
    inverse = system.local.covariance.copy()
    inverse[:, 2, 2] -= 1.0 / system.local.information[:, 2, 2]
    return np.asarray(inverse)


def _by_vector(
    vector: FloatArray, metric: FloatArray, inverse: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Differentiate `log det S` by a vector of the sample and by its metric.

    Returns the gradient (n, 3) for `[v]x^T metric [v]x`, and `[v]x inverse [v]x^T` (n, 3, 3).
    """
    cross = skews(vector)
    half = cross @ inverse
    product = metric @ half
    return 4.0 * axial_vectors(product), -half @ cross


def _through_field_matrix(system: SchurSystem, weighted: FloatArray) -> FloatArray:
    """Return the gradient by the parameters that shape the field's metric, matrix^T matrix."""
    shared = system.place.state.shared
    full = np.zeros(p.COUNT)
    matrices = shared.distortion_derivatives(system.place.samples.mounting) @ shared.body_axis
    full[p.MATRIX_PARAMETERS] = 2.0 * np.tensordot(matrices, weighted, axes=2)
    tilts = system.place.prediction.field_matrix @ skews(np.eye(3)[:2])
    full[p.BODY_AXIS] = 2.0 * np.tensordot(tilts, weighted, axes=2)
    return full
