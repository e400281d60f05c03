"""Normal equations of a turn whose samples have attitudes of their own.

The attitudes enter block by block, so they leave by a Schur complement and the cost of a step is
linear in the samples (Triggs et al., "Bundle adjustment: a modern synthesis", 2000, section 6;
doc/estimator.md, section 8).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from magcal_ros.core.estimation.block import Reduced
from magcal_ros.core.estimation.model import Evaluation, global_jacobian, local_jacobian
from magcal_ros.core.estimation.weighting import Weighting, whitened
from magcal_ros.core.geometry.arrays import FloatArray, IntArray
from magcal_ros.core.geometry.rotations import skews

SMALLEST_CURVATURE = 1e-9
UNDAMPED = 1e-9
"""Damping up to which the attitudes' own equations are taken as they are."""


@dataclass(frozen=True, eq=False)
class LocalEquations:
    """The samples' own equations, globals held; l local numbers a sample (1 or 3).

    Parameters
    ----------
    by_step : ndarray, shape (n, 6, 3)
        Derivative of up and field by a free local step, neither whitened nor weighted.
    residual : ndarray, shape (n, 6)
        Whitened, not weighted.
    jacobian : ndarray, shape (n, 6, l)
        Whitened derivative by the local step, not weighted.
    information : ndarray, shape (n, l, l)
    gradient : ndarray, shape (n, l)
    """

    by_step: FloatArray
    residual: FloatArray
    jacobian: FloatArray
    information: FloatArray
    gradient: FloatArray

    @cached_property
    def covariance(self) -> FloatArray:
        """Inverse of the information, shape (n, l, l)."""
        return inverse_blocks(self.information)

    @property
    def best_step(self) -> FloatArray:
        """Each sample's step to its best attitude, shape (n, l)."""
        return np.asarray((self.covariance @ self.gradient[:, :, None])[:, :, 0])


def local_equations(place: Evaluation, weighting: Weighting, leans: bool) -> LocalEquations:
    """Build the samples' own equations; without leans each only turns about the axis."""
    whitening = weighting.noise.whitening
    by_step = local_jacobian(place.prediction)
    jacobian = (by_step if leans else by_step[:, :, 2:]) * whitening[:, None]
    residual = whitened(place, weighting.noise)
    weighted = np.swapaxes(jacobian * weighting.weights.data[:, None, None], 1, 2)
    information = weighted @ jacobian
    gradient = (weighted @ residual[:, :, None])[:, :, 0]
    if leans:
        _add_wobble(information, gradient, place, weighting)
    return LocalEquations(by_step, residual, jacobian, information, gradient)


def _add_wobble(
    information: FloatArray, gradient: FloatArray, place: Evaluation, weighting: Weighting
) -> None:
    """Add the prior that the axis leans little: residual -(A z)_xy, derivative -[A z]x."""
    lean = place.state.lean
    by_step = -skews(lean)[:, :2]
    strength = weighting.weights.wobble / weighting.noise.wobble**2
    weighted = np.swapaxes(by_step, 1, 2) * strength[:, None, None]
    information += weighted @ by_step
    gradient -= (weighted @ lean[:, :2, None])[:, :, 0]


@dataclass(frozen=True, eq=False)
class SchurSystem:
    """Globals and attitudes together at one place; f free globals, l local numbers a sample.

    Parameters
    ----------
    place : Evaluation
    weighting : Weighting
    free : ndarray of int, shape (f,)
    local : LocalEquations
    information, gradient : ndarray, shape (f, f) and (f,)
        Of the globals, attitudes held.
    coupling : ndarray, shape (n, l, f)
    """

    place: Evaluation
    weighting: Weighting
    free: IntArray
    local: LocalEquations
    information: FloatArray
    gradient: FloatArray
    coupling: FloatArray

    def reduced(self, damping: float) -> Reduced:
        """Eliminate the attitudes."""
        inverse = self.local.covariance
        if damping > UNDAMPED:
            blocks = self.local.information.copy()
            index = np.arange(blocks.shape[1])
            blocks[:, index, index] *= 1.0 + damping
            inverse = inverse_blocks(blocks)
        step = (inverse @ self.local.gradient[:, :, None])[:, :, 0]
        coupling = inverse @ self.coupling
        counted = self.weighting.weights.sample[:, None, None]
        flat = self.coupling.reshape(-1, len(self.free))
        return Reduced(
            np.asarray(self.information - flat.T @ (counted * coupling).reshape(flat.shape)),
            self.gradient - self.through_attitudes(step),
            step,
            coupling,
        )

    def through_attitudes(self, local: FloatArray) -> FloatArray:
        """Take local vectors (n, l) to the globals, `sum C_i^T x_i`, shape (f,)."""
        flat = self.coupling.reshape(-1, len(self.free))
        return np.asarray((local * self.weighting.weights.sample[:, None]).ravel() @ flat)


def schur_system(
    place: Evaluation, weighting: Weighting, local: LocalEquations, free: IntArray
) -> SchurSystem:
    """Build the equations of the data at a place."""
    jacobian = global_jacobian(place.state, place.prediction, local.by_step, place.samples)
    jacobian = jacobian[:, :, free] * weighting.noise.whitening[:, None]
    weights = weighting.weights
    row_weight = (weights.data * weights.sample)[:, None, None]
    weighted_rows = (jacobian * row_weight).reshape(-1, len(free)).T
    weighted_local = np.swapaxes(local.jacobian * weights.data[:, None, None], 1, 2)
    return SchurSystem(
        place,
        weighting,
        free,
        local,
        information=weighted_rows @ jacobian.reshape(-1, len(free)),
        gradient=weighted_rows @ local.residual.ravel(),
        coupling=weighted_local @ jacobian,
    )


def inverse_blocks(blocks: FloatArray) -> FloatArray:
    """Invert symmetric blocks (n, l, l), l = 1 or 3, by cofactors."""
    if blocks.shape[1] == 1:
        return np.asarray(1.0 / np.maximum(blocks, SMALLEST_CURVATURE))
    a, b, c = blocks[:, 0, 0], blocks[:, 0, 1], blocks[:, 0, 2]
    d, e, f = blocks[:, 1, 1], blocks[:, 1, 2], blocks[:, 2, 2]
    out = np.empty_like(blocks)
    out[:, 0, 0], out[:, 1, 1], out[:, 2, 2] = d * f - e * e, a * f - c * c, a * d - b * b
    out[:, 0, 1] = out[:, 1, 0] = c * e - b * f
    out[:, 0, 2] = out[:, 2, 0] = b * e - c * d
    out[:, 1, 2] = out[:, 2, 1] = b * c - a * e
    determinant = a * out[:, 0, 0] + b * out[:, 0, 1] + c * out[:, 0, 2]
    out /= np.maximum(determinant, SMALLEST_CURVATURE)[:, None, None]
    return out
