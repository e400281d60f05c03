"""Which model the samples ask for, by marginal likelihood."""

from __future__ import annotations

import math

import numpy as np

from magcal_ros.core.arrays import BoolArray
from magcal_ros.core.methods.maximum_likelihood.linearise import Weights, chi_squares, linearise
from magcal_ros.core.methods.maximum_likelihood.logdet import log_determinants
from magcal_ros.core.methods.maximum_likelihood.model import predict
from magcal_ros.core.methods.maximum_likelihood.refine import Solution
from magcal_ros.core.methods.maximum_likelihood.weights import student_cost


def soft_evidence(solution: Solution) -> float:
    """Return minus twice the log marginal likelihood with Student-t residuals, up to a constant."""
    problem = solution.problem.with_weights(Weights.ones(len(solution.problem.samples)))
    lin = linearise(solution.state, problem)
    chi = chi_squares(solution.state, lin.prediction, problem.noise)
    return (
        student_cost(chi, problem.rigid)
        + float(log_determinants(lin).sum())
        + _noise_cost(solution, len(problem.samples))
        + problem.kappa * problem.prior.cost(solution.state.shared)
    )


def evidence(solution: Solution, believed: BoolArray, kappa: float) -> float:
    """Return minus twice the log marginal likelihood of the believed samples, up to a constant.

    Parameters
    ----------
    solution : Solution
    believed : ndarray of bool, shape (n,)
        The same for all models that are compared.
    kappa : float
        The same for all models that are compared.
    """
    problem = solution.problem.with_weights(Weights.ones(len(believed)))
    chi = chi_squares(solution.state, predict(solution.state, problem.samples), problem.noise)
    lin = linearise(solution.state, problem)
    total = float(np.sum(chi.data[believed]) + np.sum(log_determinants(lin)[believed]))
    if not problem.rigid:
        total += float(np.sum(chi.wobble[believed]))
    total += _noise_cost(solution, int(believed.sum()))
    return total + kappa * problem.prior.cost(solution.state.shared)


def _noise_cost(solution: Solution, count: int) -> float:
    """Return the normalisation of the Gaussians: two numbers of up, three of field, two of lean.

    Each of the three (or one) local numbers was integrated over its whole range, so the prior on
    the wobble counts with its own width.
    """
    noise = solution.problem.noise
    total = 4.0 * math.log(noise.up) + 6.0 * math.log(noise.field)
    if not solution.problem.rigid:
        total += 4.0 * math.log(noise.wobble)
    return count * total
