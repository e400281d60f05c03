"""Normal equations of the turn, and their step with the samples' attitudes eliminated.

The attitudes enter block by block, so they leave by a Schur complement and the cost of a step is
linear in the samples (Triggs et al., "Bundle adjustment: a modern synthesis", 2000, section 6).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from magcal_ros.core.arrays import FloatArray
from magcal_ros.core.methods.maximum_likelihood import parameters as p
from magcal_ros.core.methods.maximum_likelihood.model import (
    Prediction,
    Samples,
    State,
    global_jacobian,
    local_jacobian,
    predict,
)
from magcal_ros.core.methods.maximum_likelihood.prior import Prior
from magcal_ros.core.rotations import skews

SMALLEST_CURVATURE = 1e-9
LARGEST_DAMPING = 1e6
LARGEST_STEP = 3.0


@dataclass(frozen=True)
class Noise:
    """Standard deviations: up (radians), field (field scales), wobble (radians), per axis."""

    up: float
    field: float
    wobble: float


@dataclass(frozen=True, eq=False)
class Weights:
    """How much each sample counts; each array of shape (n,).

    Parameters
    ----------
    data, wobble : ndarray
        Soft weights of the sample's measurements and of its lean, 0 to about 2.
    sample : ndarray
        What the sample as a whole says about the globals, 0 or 1. The attitude of a sample that
        counts nothing still follows its measurements, so a gate can take it back.
    """

    data: FloatArray
    wobble: FloatArray
    sample: FloatArray

    @classmethod
    def ones(cls, n: int) -> Weights:
        """Believe everything."""
        return cls(np.ones(n), np.ones(n), np.ones(n))


@dataclass(frozen=True, eq=False)
class Problem:
    """One weighted least-squares problem.

    Parameters
    ----------
    samples : Samples
    prior : Prior
    noise : Noise
    weights : Weights
    rigid : bool
        Whether the axis is rigid; otherwise each sample may lean.
    kappa : float
        Samples per independent sample. It multiplies the prior instead of dividing the data.
    """

    samples: Samples
    prior: Prior
    noise: Noise
    weights: Weights
    rigid: bool = False
    kappa: float = 1.0

    def with_noise(self, noise: Noise) -> Problem:
        """Return the problem with other standard deviations."""
        return replace(self, noise=noise)

    def with_weights(self, weights: Weights) -> Problem:
        """Return the problem with other weights."""
        return replace(self, weights=weights)


@dataclass(frozen=True, eq=False)
class ChiSquares:
    """Squared whitened residuals per sample: up, field, wobble; each shape (n,)."""

    up: FloatArray
    field: FloatArray
    wobble: FloatArray

    @property
    def data(self) -> FloatArray:
        """Up and field together."""
        return self.up + self.field


def chi_squares(state: State, prediction: Prediction, noise: Noise) -> ChiSquares:
    """Return the squared whitened residuals of a state."""
    return ChiSquares(
        np.sum(prediction.up_residual**2, axis=1) / noise.up**2,
        np.sum(prediction.field_residual**2, axis=1) / noise.field**2,
        np.sum(state.lean[:, :2] ** 2, axis=1) / noise.wobble**2,
    )


def cost(state: State, problem: Problem, prediction: Prediction | None = None) -> float:
    """Return the weighted sum of squares, prior included; a known prediction saves its cost."""
    if prediction is None:
        prediction = predict(state, problem.samples)
    chi = chi_squares(state, prediction, problem.noise)
    weights = problem.weights
    each = weights.data * chi.data
    if not problem.rigid:
        each += weights.wobble * chi.wobble
    return float(weights.sample @ each + problem.kappa * problem.prior.cost(state.shared))


@dataclass(frozen=True, eq=False)
class Linearisation:
    """The normal equations at one state; g free globals, l local numbers a sample (1 or 3).

    Parameters
    ----------
    state, prediction
        Where.
    residual : ndarray, shape (n, 6)
        Whitened, not weighted.
    local : ndarray, shape (n, 6, l)
        Whitened derivative by the local step, not weighted.
    information, gradient : ndarray, shape (g, g) and (g,)
        Of the globals, prior included, attitudes held.
    coupling : ndarray, shape (n, l, g)
    local_information : ndarray, shape (n, l, l)
    local_covariance : ndarray, shape (n, l, l)
        Its inverse.
    local_gradient : ndarray, shape (n, l)
    counted : ndarray, shape (n,)
        What each sample says about the globals, 0 or 1.
    """

    state: State
    prediction: Prediction
    residual: FloatArray
    local: FloatArray
    information: FloatArray
    gradient: FloatArray
    coupling: FloatArray
    local_information: FloatArray
    local_covariance: FloatArray
    local_gradient: FloatArray
    counted: FloatArray

    @property
    def reduced_information(self) -> FloatArray:
        """Information on the globals after the attitudes are eliminated, shape (g, g)."""
        return self._without_attitudes(self.information, self.local_covariance)

    def solve(
        self, damping: float, extra_gradient: FloatArray
    ) -> tuple[FloatArray, FloatArray, float]:
        """Solve the damped equations.

        Returns
        -------
        move : ndarray, shape (g,)
            Step of the globals.
        follow : ndarray, shape (n, l)
            Steps of the attitudes.
        promised : float
            By how much the globals' step should lower the weighted sum of squares.
        """
        blocks = self.local_information.copy()
        index = np.arange(blocks.shape[1])
        blocks[:, index, index] *= 1.0 + damping
        inverse = inverse_blocks(blocks) if damping > 1e-9 else self.local_covariance
        diagonal = np.diag(np.diag(self.information) + SMALLEST_CURVATURE)
        reduced = self._without_attitudes(self.information + damping * diagonal, inverse)
        pulled = (inverse @ self.local_gradient[:, :, None])[:, :, 0]
        right = self.gradient - extra_gradient - self.through_attitudes(pulled)
        try:
            move = np.asarray(np.linalg.solve(reduced, right), dtype=np.float64)
        except np.linalg.LinAlgError:
            return np.full(len(right), np.nan), np.zeros_like(pulled), 0.0
        follow = (inverse @ (self.coupling @ move)[:, :, None])[:, :, 0]
        return move, pulled - follow, float(right @ move)

    def through_attitudes(self, local: FloatArray) -> FloatArray:
        """Carry local vectors (n, l) to the globals, `sum C_i^T x_i`, shape (g,)."""
        flat = self.coupling.reshape(-1, self.coupling.shape[2])
        return np.asarray((local * self.counted[:, None]).ravel() @ flat)

    def _without_attitudes(self, information: FloatArray, inverse: FloatArray) -> FloatArray:
        counted = inverse * self.counted[:, None, None]
        flat = self.coupling.reshape(-1, self.coupling.shape[2])
        return np.asarray(information - flat.T @ (counted @ self.coupling).reshape(flat.shape))


def linearise(
    state: State, problem: Problem, prediction: Prediction | None = None
) -> Linearisation:
    """Build the normal equations of `problem` at `state`; a known prediction saves its cost."""
    if prediction is None:
        prediction = predict(state, problem.samples)
    free = problem.prior.free
    whitening = _whitening(problem.noise)
    full, here = _local_equations(state, problem, prediction)
    jacobian = global_jacobian(state, prediction, full, problem.samples)[:, :, free]
    jacobian *= whitening[:, None]
    weighted_local = np.swapaxes(here.jacobian * problem.weights.data[:, None, None], 1, 2)
    counted = problem.weights.sample
    row_weight = (problem.weights.data * counted)[:, None, None]
    weighted_rows = (jacobian * row_weight).reshape(-1, len(free)).T
    prior_information = problem.kappa * problem.prior.information
    deviation = problem.prior.deviation(state.shared)
    return Linearisation(
        state=state,
        prediction=prediction,
        residual=here.residual,
        local=here.jacobian,
        information=weighted_rows @ jacobian.reshape(-1, len(free))
        + np.diag(prior_information[free]),
        gradient=weighted_rows @ here.residual.ravel() + (prior_information * deviation)[free],
        coupling=weighted_local @ jacobian,
        local_information=here.information,
        local_covariance=inverse_blocks(here.information),
        local_gradient=here.gradient,
        counted=counted,
    )


def best_local_step(state: State, problem: Problem) -> FloatArray:
    """Return each sample's step (n, l) to its best attitude, globals held."""
    _, here = _local_equations(state, problem, predict(state, problem.samples))
    return np.asarray((inverse_blocks(here.information) @ here.gradient[:, :, None])[:, :, 0])


@dataclass(frozen=True, eq=False)
class _Local:
    """Whitened residual (n, 6) and its derivative (n, 6, l); information and gradient (n, l)."""

    residual: FloatArray
    jacobian: FloatArray
    information: FloatArray
    gradient: FloatArray


def _whitening(noise: Noise) -> FloatArray:
    return np.repeat([1.0 / noise.up, 1.0 / noise.field], 3)


def _local_equations(
    state: State, problem: Problem, prediction: Prediction
) -> tuple[FloatArray, _Local]:
    """Return the plain derivative by the local step (n, 6, 3), and the samples' own equations."""
    whitening = _whitening(problem.noise)
    full = local_jacobian(prediction)
    jacobian = (full[:, :, 2:] if problem.rigid else full) * whitening[:, None]
    residual = np.concatenate([prediction.up_residual, prediction.field_residual], axis=1)
    residual *= whitening
    weighted = np.swapaxes(jacobian * problem.weights.data[:, None, None], 1, 2)
    information = weighted @ jacobian
    gradient = (weighted @ residual[:, :, None])[:, :, 0]
    if not problem.rigid:
        _add_wobble(information, gradient, state, problem)
    return full, _Local(residual, jacobian, information, gradient)


def _add_wobble(
    local_information: FloatArray, local_gradient: FloatArray, state: State, problem: Problem
) -> None:
    """Add the belief that the axis leans little: residual -(A z)_xy, derivative -[A z]x."""
    by_step = -skews(state.lean)[:, :2]
    strength = problem.weights.wobble / problem.noise.wobble**2
    weighted = np.swapaxes(by_step, 1, 2) * strength[:, None, None]
    local_information += weighted @ by_step
    local_gradient -= (weighted @ state.lean[:, :2, None])[:, :, 0]


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


@dataclass(frozen=True, eq=False)
class Step:
    """One accepted or refused step.

    Parameters
    ----------
    state : State
        After it; the old one where no step lowered the cost.
    prediction : Prediction
        At that state.
    fall : float
        By how much the weighted sum of squares fell.
    damping : float
        Where to start next time.
    accepted : bool
    size : float
        Largest change of a global in its own units.
    promised : float
        By how much the globals' step should have lowered the sum: squared, how many sigmas they
        moved.
    """

    state: State
    prediction: Prediction
    fall: float
    damping: float
    accepted: bool
    size: float = 0.0
    promised: float = 0.0


def take_step(
    lin: Linearisation,
    problem: Problem,
    damping: float,
    extra_gradient: FloatArray | None = None,
) -> Step:
    """Take one Levenberg-Marquardt step that lowers the weighted sum of squares.

    Parameters
    ----------
    lin : Linearisation
        Of `problem`, at the state to leave.
    problem : Problem
    damping : float
        Relative addition to the diagonal.
    extra_gradient : ndarray, shape (g,), optional
        Gradient of a further term of half the cost, taken as constant over the step.
    """
    extra = np.zeros(len(lin.gradient)) if extra_gradient is None else extra_gradient
    before = cost(lin.state, problem, lin.prediction)
    while damping < LARGEST_DAMPING:
        move, local, promised = lin.solve(damping, extra)
        full = np.zeros(p.COUNT)
        full[problem.prior.free] = move
        if np.isfinite(move).all() and np.abs(full).max() < LARGEST_STEP:
            candidate = lin.state.moved(full, local)
            prediction = predict(candidate, problem.samples)
            after = cost(candidate, problem, prediction)
            if after + 2.0 * extra @ move <= before * (1.0 + 1e-12) + 1e-9:
                size = float(np.abs(move).max())
                relaxed = max(damping / 10.0, 1e-10)
                return Step(candidate, prediction, before - after, relaxed, True, size, promised)
        damping = max(10.0 * damping, 1e-7)
    return Step(lin.state, lin.prediction, 0.0, 1e-3, False)
