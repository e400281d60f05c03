"""Iterations: from a first guess to the optimum, and from soft weights to a gate."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from magcal_ros.core.arrays import BoolArray
from magcal_ros.core.methods.maximum_likelihood.correlation import samples_per_independent
from magcal_ros.core.methods.maximum_likelihood.linearise import (
    Linearisation,
    Noise,
    Problem,
    Weights,
    chi_squares,
    linearise,
    take_step,
)
from magcal_ros.core.methods.maximum_likelihood.logdet import log_determinant_gradient
from magcal_ros.core.methods.maximum_likelihood.model import (
    Prediction,
    Samples,
    State,
    predict,
)
from magcal_ros.core.methods.maximum_likelihood.prior import Prior
from magcal_ros.core.methods.maximum_likelihood.sigmas import (
    estimate_noise,
    largest_change,
    shares,
)
from magcal_ros.core.methods.maximum_likelihood.weights import (
    gate,
    hard_weights,
    student_cost,
    student_weights,
)

FIRST_NOISE = Noise(up=0.03, field=0.03, wobble=0.1)
"""Larger than any usable sensor's: estimating the noise anew each step is the annealing."""

NOTICEABLE_WOBBLE = 0.5
"""Times the noise of up. A smaller wobble creeps towards none for as long as one waits."""

STILL = 0.01
"""A step of the globals by less than a tenth of a sigma, squared."""


@dataclass(frozen=True, eq=False)
class Solution:
    """An optimum, and the problem it solves."""

    state: State
    problem: Problem

    @property
    def believed(self) -> BoolArray:
        """Samples inside the gate, shape (n,)."""
        return self.problem.weights.sample > 0.5


def first_steps(
    start: State, samples: Samples, prior: Prior, steps: int = 6
) -> tuple[float, State]:
    """Take a few soft-weighted steps from a first guess; return its cost and where it led."""
    problem = Problem(samples, prior, FIRST_NOISE, Weights.ones(len(samples)))
    state, prediction, damping = start, predict(start, samples), 1e-3
    for _ in range(steps):
        problem = _soft(problem, state, prediction)
        step = take_step(linearise(state, problem, prediction), problem, damping)
        state, prediction, damping = step.state, step.prediction, step.damping
        if not step.accepted:
            break
    chi = chi_squares(state, prediction, problem.noise)
    return student_cost(chi, problem.rigid) + prior.cost(state.shared), state


def anneal(start: State, samples: Samples, prior: Prior, rounds: int = 30) -> Solution:
    """Bring a guess to the soft-weighted optimum with the noise estimated on the way."""
    problem = Problem(samples, prior, FIRST_NOISE, Weights.ones(len(samples)))
    state, prediction, damping, extra = start, predict(start, samples), 1e-4, None
    for turn in range(rounds):
        problem = _soft(problem, state, prediction)
        lin = linearise(state, problem, prediction)
        change = 0.0
        if turn >= 5:
            kappa = samples_per_independent(lin.residual, problem.weights.data)
            change = abs(math.log(kappa / problem.kappa)) / 5.0
            problem = replace(problem, kappa=kappa)
        if turn >= 4 and turn % 3 == 1:
            extra = log_determinant_gradient(lin, problem)
        step = take_step(lin, problem, damping, extra)
        state, prediction, damping = step.state, step.prediction, step.damping
        noise = estimate_noise(lin, problem, change=2.0)
        change = max(change, largest_change(noise, problem.noise))
        problem = problem.with_noise(noise)
        if change < 0.01 and step.fall < 0.05:
            break
    return Solution(state, _soft(problem, state, prediction))


def softened(solution: Solution, rounds: int = 4) -> Solution:
    """Take a few soft-weighted steps, the noise estimated on the way.

    A gate that is closed before freshly freed globals have moved shuts out the samples that they
    are to explain.
    """
    state, problem, damping = solution.state, solution.problem, 1e-4
    prediction = predict(state, problem.samples)
    for _ in range(rounds):
        problem = _soft(problem, state, prediction)
        lin = linearise(state, problem, prediction)
        step = take_step(lin, problem, damping)
        state, prediction, damping = step.state, step.prediction, step.damping
        problem = problem.with_noise(estimate_noise(lin, problem, change=2.0))
    return Solution(state, problem)


def gated(solution: Solution, rounds: int = 40) -> Solution:
    """Replace soft weights by a gate and repeat until gate, noise and optimum agree.

    Parameters
    ----------
    solution : Solution
        Where to start; `problem.rigid` decides the axis.
    rounds : int
        At most so many rounds of gate, steps and noise.
    """
    state, problem = solution.state, solution.problem
    weights = hard_weights(np.ones(len(problem.samples), dtype=bool))
    lin = linearise(state, problem.with_weights(weights))
    for turn in range(rounds):
        problem = problem.with_weights(weights)
        chi = chi_squares(state, lin.prediction, problem.noise)
        paid = shares(lin, problem)
        weights = hard_weights(gate(lin, chi, paid.up + paid.field))
        regated = int(np.sum(weights.sample != problem.weights.sample))
        problem = problem.with_weights(weights)
        if turn > 0:
            kappa = samples_per_independent(lin.residual, weights.sample)
            problem = replace(problem, kappa=kappa)
        lin, moved = settle(state, problem, steps=2, tolerance=STILL)
        state = lin.state
        noise = estimate_noise(lin, problem, change=1.5)
        change = largest_change(noise, problem.noise, NOTICEABLE_WOBBLE)
        problem = problem.with_noise(noise)
        # A wobble too small to matter makes way for a rigid axis, wherever the rest would go.
        fades = not problem.rigid and noise.wobble < NOTICEABLE_WOBBLE * noise.up
        stays = regated <= 0.002 * len(weights.sample) and (fades or moved < STILL)
        if turn > 0 and change < 0.02 and stays:
            break
    return Solution(state, problem)


def converged(solution: Solution) -> Solution:
    """Take steps with gate and noise held until nothing moves."""
    tolerance = 1e-12 if solution.problem.rigid else 1e-8
    lin, _ = settle(solution.state, solution.problem, steps=30, tolerance=tolerance)
    return Solution(lin.state, solution.problem)


def settle(
    state: State, problem: Problem, steps: int, tolerance: float
) -> tuple[Linearisation, float]:
    """Take up to `steps` steps until one promises to lower the cost by less than `tolerance`.

    Returns
    -------
    Linearisation
        Where that led.
    float
        The most that a step promised: squared, how many sigmas the globals moved.
    """
    lin, damping, moved = linearise(state, problem), 1e-6, 0.0
    for _ in range(steps):
        # The price of the leans changes along the way, much where the reference field is loose.
        extra = None if problem.rigid else log_determinant_gradient(lin, problem)
        step = take_step(lin, problem, damping, extra)
        damping = step.damping
        if not step.accepted:
            break
        moved = max(moved, step.promised)
        lin = linearise(step.state, problem, step.prediction)
        if step.size < 1e-11 or step.promised < tolerance:
            break
    return lin, moved


def _soft(problem: Problem, state: State, prediction: Prediction) -> Problem:
    chi = chi_squares(state, prediction, problem.noise)
    return problem.with_weights(student_weights(chi, problem.rigid))
