"""Which model the samples ask for, by marginal likelihood."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from magcal_ros.core.arrays import BoolArray, FloatArray
from magcal_ros.core.methods.maximum_likelihood.covariance import inverse_information
from magcal_ros.core.methods.maximum_likelihood.doubt import (
    WORTH_A_FIT,
    Doubt,
    Look,
    look_for_soft_iron,
)
from magcal_ros.core.methods.maximum_likelihood.linearise import (
    Linearisation,
    Noise,
    Problem,
    Weights,
    chi_squares,
    cost,
    linearise,
)
from magcal_ros.core.methods.maximum_likelihood.logdet import (
    log_determinant_gradient,
    log_determinants,
    log_turn_informations,
)
from magcal_ros.core.methods.maximum_likelihood.model import State
from magcal_ros.core.methods.maximum_likelihood.prior import Prior
from magcal_ros.core.methods.maximum_likelihood.refine import Solution, gated, settle, softened
from magcal_ros.core.methods.maximum_likelihood.weights import student_cost

WOBBLE_PRICE = 10.0
SOFT_IRON_PRICE = 25.0
RIGID_SOFT_IRON_PRICE = 20.0
"""By how much, times kappa, minus twice the log evidence must fall for a richer model."""

STRETCHES = 8
LEAST_SHARE = 1.0 / 3.0
"""At least this share of soft iron's gain is made outside the best two neighbouring stretches."""

HONEST_SHARE = 0.97
"""A smaller share of believed samples may hide soft iron: it is fitted, whatever the rest says."""
CLEAR_GAIN = 100.0
"""An expected fall of chi-square that leaves little doubt about soft iron."""

FEW_COMMON = 0.95
FEW_KEPT = 0.9
"""A model that has to throw more samples away, to fit the rest better, explains nothing: a rigid
axis, and soft iron."""
LARGEST_RIGID_WOBBLE = 0.05
"""Radians of wobble beyond which a rigid axis is not tried."""


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
        + float((log_determinants(lin) + log_turn_informations(lin, problem.noise)).sum())
        + (0.0 if problem.rigid else 4.0 * count * math.log(problem.noise.wobble))
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
    lin = linearise(solution.state, problem)
    chi = chi_squares(solution.state, lin.prediction, problem.noise)
    count = int(believed.sum())
    turns = log_turn_informations(lin, problem.noise)
    total = float(np.sum((chi.data + turns)[believed])) + _noise_cost(problem.noise, count)
    total += kappa * problem.prior.cost(solution.state.shared)
    if problem.rigid:
        return total
    # Two lean angles a sample, each with a Gaussian belief and integrated over.
    lean = np.sum((chi.wobble + log_determinants(lin))[believed])
    return total + float(lean) + 4.0 * count * math.log(problem.noise.wobble)


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
        Fall of chi-square by soft iron; zero where it was not tried.
    doubt : Doubt, optional
        Where soft iron was left out and could have been there.
    """

    solution: Solution
    soft_iron_gain: float = 0.0
    doubt: Doubt | None = None


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
    if not with_iron.has_soft_iron:
        return Choice(rigid_or_wobbling(wobbling))
    # Where soft iron is plain to see, whether the axis would look rigid without it is idle.
    look = look_at(wobbling, with_iron)
    plain_to_see = look.gain > CLEAR_GAIN
    plain = wobbling if plain_to_see else rigid_or_wobbling(wobbling)
    if plain is not wobbling:
        look = look_at(plain, with_iron)
    gain = look.gain
    # Where soft iron was taken for outliers, what is left no longer shows its slope.
    honest = plain.believed.mean() > HONEST_SHARE
    if always_iron or not honest or look.gain > WORTH_A_FIT:
        # An axis that is rigid without soft iron is rigid with it, which explains more.
        begun = plain if plain.problem.rigid else _near(start)
        freed = replace(begun.problem, prior=with_iron, kappa=1.0)
        iron = gated(softened(Solution(begun.state, freed)))
        iron = iron if iron.problem.rigid else rigid_or_wobbling(iron)
        gain = soft_iron_gain(plain, iron)
        price = look.price(RIGID_SOFT_IRON_PRICE) if iron.problem.rigid else SOFT_IRON_PRICE
        asked = gain > price * iron.problem.kappa
        if always_iron or (asked and keeps_samples(plain, iron)):
            return Choice(iron, gain)
    if plain_to_see:
        plain = rigid_or_wobbling(wobbling)
        look = look_at(plain, with_iron)
    return Choice(plain, gain, Doubt(look, look.probability(gain)))


def _near(start: Solution) -> Solution:
    """Return where soft iron is freed on a wobbling axis.

    Where nothing is known of the field, leans that stand for soft iron take strength and dip far
    away; a rigid axis leaves them where the belief in a small hard iron has them.
    """
    if not start.problem.prior.holds_hard_iron:
        return start
    stiff = stiffened(start)
    lin, _ = settle(stiff.state, stiff.problem, steps=6, tolerance=0.1)
    return Solution(State(lin.state.shared, start.state.attitude), start.problem)


def keeps_samples(one: Solution, other: Solution) -> bool:
    """Return whether the other model believes about as many samples as the one."""
    return bool(other.believed.sum() >= FEW_KEPT * one.believed.sum())


def rigid_or_wobbling(wobbling: Solution) -> Solution:
    """Return the rigid solution where it explains the samples nearly as well."""
    if wobbling.problem.noise.wobble > LARGEST_RIGID_WOBBLE:
        return wobbling
    rigid = gated(stiffened(wobbling))
    if rigid.believed.sum() < FEW_COMMON * wobbling.believed.sum():
        return wobbling
    common = rigid.believed & wobbling.believed
    kappa = wobbling.problem.kappa
    gain = evidence(rigid, common, kappa) - evidence(wobbling, common, kappa)
    if gain > WOBBLE_PRICE * kappa:
        return wobbling
    return rigid


def stiffened(wobbling: Solution) -> Solution:
    """Return where the fit of a rigid axis begins: what were leans is now noise of up."""
    noise = wobbling.problem.noise
    noise = replace(noise, up=math.hypot(noise.up, noise.wobble))
    problem = replace(wobbling.problem, rigid=True, noise=noise)
    return Solution(wobbling.state.upright(), problem)


def soft_iron_gain(plain: Solution, iron: Solution) -> float:
    """Return by how much soft iron lowers the cost, under the noise and gate found with it.

    Only then are the two nested: noise found by each for itself moves the comparison by more than
    what is to be decided.
    """
    problem = replace(iron.problem, prior=plain.problem.prior)
    start = plain.state.upright() if problem.rigid else plain.state
    without, _ = settle(start, problem, steps=6, tolerance=1e-3)
    with_it, _ = settle(iron.state, iron.problem, steps=6, tolerance=1e-3)
    falls = _sample_costs(without, problem) - _sample_costs(with_it, iron.problem)
    total = cost(without.state, problem, without.prediction) - cost(
        with_it.state, iron.problem, with_it.prediction
    )
    lean = log_determinants(without) - log_determinants(with_it)
    total += float(problem.weights.sample @ lean)
    return lasting_gain(total, falls)


def _sample_costs(lin: Linearisation, problem: Problem) -> FloatArray:
    chi = chi_squares(lin.state, lin.prediction, problem.noise)
    each = chi.data if problem.rigid else chi.data + chi.wobble
    return np.asarray(problem.weights.sample * each)


def lasting_gain(total: float, falls: FloatArray) -> float:
    """Return the gain as far as it is made all along the turn.

    Soft iron helps everywhere, something that passed by in one place, and what fits one stretch
    at the expense of others is something else.

    Parameters
    ----------
    total : float
        Fall of the cost.
    falls : ndarray, shape (n,)
        Each sample's fall of chi-square.
    """
    parts = np.array([part.sum() for part in np.array_split(falls, STRETCHES)])
    one_place = max(float(parts.max()), float((parts[:-1] + parts[1:]).max()))
    return min(total, (float(parts.sum()) - max(one_place, 0.0)) / LEAST_SHARE)


def look_at(solution: Solution, with_iron: Prior) -> Look:
    """Return what soft iron would bring, from the slope at zero."""
    problem = replace(solution.problem, prior=with_iron)
    lin = linearise(solution.state, problem)
    pulled = (lin.local_covariance @ lin.local_gradient[:, :, None])[:, :, 0]
    slope = lin.gradient - lin.through_attitudes(pulled)
    if not problem.rigid:
        slope -= log_determinant_gradient(lin, problem)
    covariance = inverse_information(lin.reduced_information)
    return look_for_soft_iron(covariance, slope, with_iron, problem.kappa)
