"""Iterations: from a first guess to the optimum, and from soft weights to a gate."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from magcal_ros.core.arrays import BoolArray, FloatArray
from magcal_ros.core.methods.maximum_likelihood.correlation import samples_per_independent
from magcal_ros.core.methods.maximum_likelihood.linearise import (
    Noise,
    Problem,
    Weights,
    chi_squares,
    linearise,
    take_step,
)
from magcal_ros.core.methods.maximum_likelihood.logdet import log_determinant_gradient
from magcal_ros.core.methods.maximum_likelihood.model import Samples, State, predict
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


@dataclass(frozen=True, eq=False)
class Solution:
    """An optimum, and the problem it solves."""

    state: State
    problem: Problem

    @property
    def believed(self) -> BoolArray:
        """Samples inside the gate, shape (n,)."""
        return self.problem.weights.data > 0.5


def first_steps(
    start: State, samples: Samples, prior: Prior, steps: int = 6
) -> tuple[float, State]:
    """Take a few soft-weighted steps from a first guess; return its cost and where it led."""
    problem = Problem(samples, prior, FIRST_NOISE, Weights.ones(len(samples)))
    state, damping = start, 1e-3
    for _ in range(steps):
        problem = _soft(problem, state)
        step = take_step(state, problem, damping)
        state, damping = step.state, step.damping
        if not step.accepted:
            break
    chi = chi_squares(state, predict(state, samples), problem.noise)
    return student_cost(chi, problem.rigid) + prior.cost(state.shared), state


def anneal(start: State, samples: Samples, prior: Prior, rounds: int = 25) -> Solution:
    """Bring a guess to the soft-weighted optimum with the noise estimated on the way."""
    problem = Problem(samples, prior, FIRST_NOISE, Weights.ones(len(samples)))
    state, damping, extra = start, 1e-4, None
    for turn in range(rounds):
        problem = _soft(problem, state)
        if turn >= 4 and turn % 3 == 1:
            extra = log_determinant_gradient(linearise(state, problem), problem)
        step = take_step(state, problem, damping, extra)
        state, damping = step.state, step.damping
        problem = _soft(problem, state)
        lin = linearise(state, problem)
        noise = estimate_noise(lin, problem, change=2.0)
        change = largest_change(noise, problem.noise)
        problem = problem.with_noise(noise)
        if turn >= 5:
            kappa = samples_per_independent(lin.residual, problem.weights.data)
            change = max(change, abs(math.log(kappa / problem.kappa)) / 5.0)
            problem = replace(problem, kappa=kappa)
        if change < 0.01 and step.previous - step.cost < 0.05:
            break
    return Solution(state, _soft(problem, state))


def gated(solution: Solution, rounds: int = 8, *, final: bool = True) -> Solution:
    """Replace soft weights by a gate and repeat until gate, noise and optimum agree.

    Parameters
    ----------
    solution : Solution
        Where to start; `problem.rigid` decides the axis.
    rounds : int
        At most so many rounds of gate, steps and noise.
    final : bool
        Whether to end with steps to full convergence.
    """
    state, problem = solution.state, solution.problem
    weights, extra = hard_weights(np.ones(len(problem.samples), dtype=bool)), None
    for turn in range(rounds):
        open_problem = problem.with_weights(weights)
        lin = linearise(state, open_problem)
        chi = chi_squares(state, lin.prediction, problem.noise)
        paid = shares(lin, open_problem)
        believed = gate(lin, chi, paid.up + paid.field)
        new_weights = hard_weights(believed)
        moved = int(np.sum(new_weights.data != weights.data))
        weights = new_weights
        problem = problem.with_weights(weights)
        if turn > 0:
            kappa = samples_per_independent(lin.residual, weights.data)
            problem = replace(problem, kappa=kappa)
        state, extra = settle(state, problem, steps=4, tolerance=1e-2)
        lin = linearise(state, problem)
        noise = estimate_noise(lin, problem, change=1.5)
        change = largest_change(noise, problem.noise)
        problem = problem.with_noise(noise)
        if turn > 0 and change < 0.02 and moved <= 0.002 * len(believed):
            break
    if final:
        state, _ = settle(state, problem, steps=20, tolerance=1e-12, extra=extra)
    return Solution(state, problem)


def settle(
    state: State,
    problem: Problem,
    steps: int,
    tolerance: float,
    extra: FloatArray | None = None,
) -> tuple[State, FloatArray | None]:
    """Take steps until the cost falls by less than `tolerance`; return the last extra gradient."""
    if not problem.rigid and extra is None:
        extra = log_determinant_gradient(linearise(state, problem), problem)
    damping = 1e-6
    for _ in range(steps):
        step = take_step(state, problem, damping, extra)
        state, damping = step.state, step.damping
        if not step.accepted or abs(step.previous - step.cost) < tolerance or step.size < 1e-11:
            break
    return state, extra


def _soft(problem: Problem, state: State) -> Problem:
    chi = chi_squares(state, predict(state, problem.samples), problem.noise)
    return problem.with_weights(student_weights(chi, problem.rigid))
