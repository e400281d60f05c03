"""Which model the samples ask for, by marginal likelihood."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from magcal_ros.core.arrays import BoolArray
from magcal_ros.core.methods.maximum_likelihood.correlation import samples_per_independent
from magcal_ros.core.methods.maximum_likelihood.linearise import (
    Noise,
    Weights,
    chi_squares,
    linearise,
)
from magcal_ros.core.methods.maximum_likelihood.logdet import log_determinants
from magcal_ros.core.methods.maximum_likelihood.prior import Prior
from magcal_ros.core.methods.maximum_likelihood.refine import Solution, gated
from magcal_ros.core.methods.maximum_likelihood.weights import student_cost

WOBBLE_PRICE = 10.0
SOFT_IRON_PRICE = 20.0
"""By how much, times kappa, minus twice the log evidence must fall for a richer model."""

FEW_COMMON = 0.95
LARGEST_RIGID_WOBBLE = 0.05
"""Radians of wobble beyond which a rigid axis is not tried."""


@dataclass(frozen=True)
class Evidence:
    """Minus twice the log marginal likelihood, up to a constant, in two parts.

    Parameters
    ----------
    data : float
        From up, field and the beliefs on the globals.
    lean : float
        From the leans of a wobbling axis, integrated out; zero for a rigid axis.
    """

    data: float
    lean: float

    @property
    def total(self) -> float:
        """Both together."""
        return self.data + self.lean


def soft_evidence(solution: Solution) -> float:
    """Return minus twice the log marginal likelihood with Student-t residuals, up to a constant."""
    problem = solution.problem.with_weights(Weights.ones(len(solution.problem.samples)))
    lin = linearise(solution.state, problem)
    chi = chi_squares(solution.state, lin.prediction, problem.noise)
    count = len(problem.samples)
    return (
        student_cost(chi, problem.rigid)
        + _noise_cost(problem.noise, count)
        + problem.kappa * problem.prior.cost(solution.state.shared)
        + float(log_determinants(lin).sum())
        + (0.0 if problem.rigid else 4.0 * count * math.log(problem.noise.wobble))
    )


def evidence(solution: Solution, believed: BoolArray, kappa: float) -> Evidence:
    """Weigh the believed samples.

    Parameters
    ----------
    solution : Solution
    believed : ndarray of bool, shape (n,)
        The same for all models that are compared.
    kappa : float
        The same for all models that are compared.
    """
    problem = solution.problem.with_weights(Weights.ones(len(believed)))
    lin = linearise(solution.state, problem)
    chi = chi_squares(solution.state, lin.prediction, problem.noise)
    count = int(believed.sum())
    data = float(np.sum(chi.data[believed])) + _noise_cost(problem.noise, count)
    data += kappa * problem.prior.cost(solution.state.shared)
    if problem.rigid:
        return Evidence(data, 0.0)
    # Two lean angles a sample, each with a Gaussian belief and integrated over.
    lean = np.sum((chi.wobble + log_determinants(lin))[believed])
    return Evidence(data, float(lean) + 4.0 * count * math.log(problem.noise.wobble))


def _noise_cost(noise: Noise, count: int) -> float:
    """Return the normalisation of the Gaussians: two numbers of up, three of field."""
    return count * (4.0 * math.log(noise.up) + 6.0 * math.log(noise.field))


@dataclass(frozen=True, eq=False)
class Choice:
    """The model that the samples ask for.

    Parameters
    ----------
    solution : Solution
    soft_iron_gain : float
        Fall of minus twice the log evidence by soft iron; zero where it was not tried.
    """

    solution: Solution
    soft_iron_gain: float


def choose_model(start: Solution, with_iron: Prior, *, always_iron: bool) -> Choice:
    """Fit rigid and wobbling axis, with soft iron and without, and take what is asked for.

    Parameters
    ----------
    start : Solution
        A wobbling fit without soft iron.
    with_iron : Prior
        The prior that frees soft iron.
    always_iron : bool
        Whether soft iron is fitted whatever the samples say.
    """
    wobbling = gated(start)
    plain = rigid_or_wobbling(wobbling)
    if not with_iron.has_soft_iron:
        return Choice(plain, 0.0)
    if not always_iron and expected_gain(plain, with_iron) < 0.5 * SOFT_IRON_PRICE:
        return Choice(plain, 0.0)
    freed = replace(wobbling.problem, prior=with_iron, kappa=1.0)
    iron = rigid_or_wobbling(gated(Solution(wobbling.state, freed)))
    gain = _gain(plain, iron)
    if always_iron or gain > SOFT_IRON_PRICE * iron.problem.kappa:
        return Choice(iron, gain)
    return Choice(plain, gain)


def rigid_or_wobbling(wobbling: Solution) -> Solution:
    """Return the rigid solution where it explains the samples nearly as well."""
    noise = wobbling.problem.noise
    if noise.wobble > LARGEST_RIGID_WOBBLE:
        return wobbling
    first = replace(noise, up=math.hypot(noise.up, noise.wobble))
    problem = replace(wobbling.problem, rigid=True, noise=first)
    rigid = gated(Solution(wobbling.state.upright(), problem))
    if rigid.believed.sum() < FEW_COMMON * wobbling.believed.sum():
        return wobbling
    if _gain(rigid, wobbling) > WOBBLE_PRICE * wobbling.problem.kappa:
        return wobbling
    return rigid


def _gain(simple: Solution, rich: Solution) -> float:
    """Return by how much minus twice the log evidence falls from the simple to the rich model.

    A real axis leans slowly, so its leans are far fewer than the samples and may not vote for the
    rich model as if they were independent.
    """
    common = simple.believed & rich.believed
    kappa = rich.problem.kappa
    before, after = evidence(simple, common, kappa), evidence(rich, common, kappa)
    if simple.problem.rigid or rich.problem.rigid:
        return before.total - after.total
    kappa_lean = samples_per_independent(rich.state.lean[:, :2], common.astype(float))
    by_lean = before.lean - after.lean
    return before.data - after.data + min(by_lean, by_lean / kappa_lean)


def expected_gain(solution: Solution, with_iron: Prior) -> float:
    """Return by how much chi-square would fall with soft iron, from the slope at zero."""
    problem = replace(solution.problem, prior=with_iron)
    lin = linearise(solution.state, problem)
    pulled = (lin.local_covariance @ lin.local_gradient[:, :, None])[:, :, 0]
    slope = lin.gradient - lin.through_attitudes(pulled)
    return float(slope @ np.linalg.lstsq(lin.reduced_information, slope, rcond=1e-14)[0])
