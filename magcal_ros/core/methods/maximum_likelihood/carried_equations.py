"""One round of the fit whose attitudes the gyro carries: equations, step, cost, noise and drift."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from magcal_ros.core.arrays import FloatArray
from magcal_ros.core.methods.maximum_likelihood import parameters as p
from magcal_ros.core.methods.maximum_likelihood.gyro import Carrier
from magcal_ros.core.methods.maximum_likelihood.linearise import (
    Noise,
    Problem,
    Weights,
    chi_squares,
)
from magcal_ros.core.methods.maximum_likelihood.model import (
    Prediction,
    State,
    global_jacobian,
    local_jacobian,
    predict,
)
from magcal_ros.core.methods.maximum_likelihood.sigmas import FIELD_FLOOR, UP_FLOOR
from magcal_ros.core.rotations import exp_rotations

SMALLEST_DRIFT = 2e-4
LARGEST_DRIFT = 0.05
"""Radians per root second."""


@dataclass(frozen=True, eq=False)
class Task:
    """What one round solves: the weighted problem, the gyro, and its drift (rad per root s)."""

    problem: Problem
    carrier: Carrier
    drift: float

    @cached_property
    def believed_of_gyro(self) -> FloatArray:
        """Prior information on the gyro's coefficients, shape (c, c)."""
        return self.carrier.prior_information(self.drift)

    def with_weights(self, weights: Weights) -> Task:
        """Return the task with other weights."""
        return replace(self, problem=self.problem.with_weights(weights))


@dataclass(frozen=True, eq=False)
class Place:
    """Where the iteration stands."""

    state: State
    prediction: Prediction
    coefficients: FloatArray


@dataclass(frozen=True, eq=False)
class Equations:
    """Normal equations over free globals and gyro coefficients.

    Parameters
    ----------
    residual : ndarray, shape (n, 6)
        Whitened, not weighted.
    information, gradient : ndarray, shape (g + c, g + c) and (g + c,)
        Prior included.
    prior : ndarray, shape (g + c, g + c)
    free : int
        Number of free globals, which come first.
    """

    residual: FloatArray
    information: FloatArray
    gradient: FloatArray
    prior: FloatArray
    free: int

    @cached_property
    def covariance(self) -> FloatArray:
        """Inverse of the information; nothing along directions without any."""
        return np.asarray(np.linalg.pinv(self.information, rcond=1e-14, hermitian=True))

    @property
    def spent(self) -> float:
        """Degrees of freedom that the data paid for the parameters."""
        return len(self.gradient) - float(np.sum(self.covariance * self.prior))

    @property
    def of_globals(self) -> FloatArray:
        """Information on the free globals, the gyro's errors eliminated, shape (g, g)."""
        block, free = self.information, self.free
        # Without a believed sample the gyro's own errors are not determined either.
        shared = np.linalg.lstsq(block[free:, free:], block[free:, :free], rcond=1e-14)[0]
        return np.asarray(block[:free, :free] - block[:free, free:] @ shared)


def at(state: State, coefficients: FloatArray, task: Task) -> Place:
    """Return the place of a state and the gyro's errors that led there."""
    samples = task.problem.samples
    if task.carrier.sideways:
        samples = replace(samples, up=samples.up - task.carrier.offset(coefficients))
    return Place(state, predict(state, samples), coefficients)


def normal_equations(place: Place, task: Task) -> Equations:
    """Build the normal equations of a task at a place.

    The gyro's many errors act through three numbers a sample, so everything of theirs is summed
    over those three instead of the six residuals.
    """
    prediction, problem, carrier = place.prediction, task.problem, task.carrier
    whitening = np.repeat([1.0 / problem.noise.up, 1.0 / problem.noise.field], 3)
    local = local_jacobian(prediction)
    free = problem.prior.free
    direct = global_jacobian(place.state, prediction, local, problem.samples)[:, :, free]
    if carrier.sideways:
        by_offset = np.zeros_like(local)
        by_offset[:, :3] = place.state.shared.body_axis.T
        direct = np.concatenate([direct, by_offset], axis=2)
    direct *= whitening[:, None]
    residual = np.concatenate([prediction.up_residual, prediction.field_residual], axis=1)
    residual *= whitening
    weight = (problem.weights.data * problem.weights.sample)[:, None, None]
    turning = (local * whitening[:, None]) @ _to_frame(place, carrier)
    by_turning = np.ascontiguousarray(np.swapaxes(turning * weight, 1, 2))
    basis = carrier.basis.reshape(-1, carrier.basis.shape[2])
    size = direct.shape[2]
    rows = (direct * weight).reshape(-1, size)
    among = rows.T @ direct.reshape(-1, size)
    across = (by_turning @ direct).reshape(-1, size).T @ basis
    within = basis.T @ ((by_turning @ turning) @ carrier.basis).reshape(basis.shape)
    # Globals come first, then the basis, then the offset.
    count = len(free)
    order = np.concatenate(
        [np.arange(count), size + np.arange(basis.shape[1]), np.arange(count, size)]
    )
    data = np.block([[among, across], [across.T, within]])[np.ix_(order, order)]
    gradient = np.concatenate(
        [rows.T @ residual.ravel(), basis.T @ (by_turning @ residual[:, :, None]).ravel()]
    )[order]
    return _with_prior(Equations(residual, data, gradient, np.zeros_like(data), count), place, task)


def _with_prior(data: Equations, place: Place, task: Task) -> Equations:
    problem, count = task.problem, data.free
    believed = problem.prior.information
    prior = np.zeros_like(data.information)
    prior[:count, :count] = np.diag(believed[problem.prior.free])
    prior[count:, count:] = task.believed_of_gyro
    prior *= problem.kappa
    pull = (believed * problem.prior.deviation(place.state.shared))[problem.prior.free]
    gradient = data.gradient.copy()
    gradient[:count] += problem.kappa * pull
    gradient[count:] -= prior[count:, count:] @ place.coefficients
    return replace(data, information=data.information + prior, gradient=gradient, prior=prior)


def _to_frame(place: Place, carrier: Carrier) -> FloatArray:
    """Return what takes the first sample's axes to each sample's local step, shape (n, 3, 3)."""
    return np.asarray(place.state.shared.body_axis.T @ carrier.relative)


def step(place: Place, equations: Equations, task: Task) -> tuple[Place, float]:
    """Take a damped step that lowers the cost; return where it led and how far."""
    before = cost(place, task)
    free = task.problem.prior.free
    diagonal = np.diag(np.diag(equations.information) + 1e-9)
    for damping in (0.0, 1e-4, 1e-2, 1.0, 100.0):
        if damping == 0.0:
            move = equations.covariance @ equations.gradient
        else:
            damped = equations.information + damping * diagonal
            move = np.asarray(np.linalg.solve(damped, equations.gradient))
        full = np.zeros(p.COUNT)
        full[free] = move[: len(free)]
        moved = advanced(place, task, full, move[len(free) :])
        if cost(moved, task) <= before * (1.0 + 1e-12) + 1e-9:
            return moved, float(np.abs(move[: len(free)]).max())
    return place, 0.0


def advanced(place: Place, task: Task, full: FloatArray, errors: FloatArray) -> Place:
    """Return the place after a step of all globals (18,) and of the gyro's errors (c,)."""
    carrier = task.carrier
    turned = carrier.basis @ errors[: carrier.basis.shape[2]]
    turns = exp_rotations((_to_frame(place, carrier) @ turned[:, :, None])[:, :, 0])
    state = State(place.state.shared.moved(full), turns @ place.state.attitude)
    return at(state, place.coefficients + errors, task)


def cost(place: Place, task: Task) -> float:
    """Return the weighted sum of squares, priors included."""
    problem = task.problem
    chi = chi_squares(place.state, place.prediction, problem.noise)
    weights = problem.weights
    errors = place.coefficients @ task.believed_of_gyro @ place.coefficients
    beliefs = problem.prior.cost(place.state.shared) + float(errors)
    return float((weights.sample * weights.data) @ chi.data) + problem.kappa * beliefs


def noise_from(equations: Equations, problem: Problem) -> Noise:
    """Return the sigmas that the residuals ask for."""
    weights, noise = problem.weights, problem.noise
    squares = (weights.data * weights.sample)[:, None] * equations.residual**2
    # Where no sample is believed the noise shrinks no further than below; the fit is refused.
    count = max(float(weights.sample.sum()), 1.0)
    left = max(1.0 - equations.spent / (5.0 * count), 0.1)
    up = noise.up * math.sqrt(float(squares[:, :3].sum()) / (2.0 * count * left))
    field = noise.field * math.sqrt(float(squares[:, 3:].sum()) / (3.0 * count * left))
    return Noise(
        max(min(up, 2.0 * noise.up), 0.5 * noise.up, UP_FLOOR),
        max(min(field, 2.0 * noise.field), 0.5 * noise.field, FIELD_FLOOR),
        noise.wobble,
    )


def drift_from(place: Place, equations: Equations, task: Task) -> float:
    """Return the random walk that the knots ask for (the fixed point of their evidence).

    The knots were found under the drift of the round before, so the full change would swing
    between two values for ever; the geometric mean settles.
    """
    carrier, drift = task.carrier, task.drift
    if carrier.knots == 0:
        return drift
    size = 3 * carrier.knots
    first = equations.free + 9
    rows = slice(first, first + size)
    walk = task.believed_of_gyro[9 : 9 + size, 9 : 9 + size]
    seen = size - task.problem.kappa * float(np.sum(equations.covariance[rows, rows] * walk))
    moved = float(np.sum(carrier.knot_steps(place.coefficients) ** 2)) / carrier.spacing
    new = math.sqrt(drift * math.sqrt(moved / max(seen, 0.5)))
    return min(max(new, SMALLEST_DRIFT, 0.5 * drift), LARGEST_DRIFT, 2.0 * drift)
