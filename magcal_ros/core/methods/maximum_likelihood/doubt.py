"""Soft iron that the samples neither show nor exclude: how likely it is, and what it would move.

Seen from the optimum without soft iron, one step towards the optimum with it tells the fall of
chi-square, where the globals would go, and how much of the belief's room the samples would leave:
the Occam factor of the marginal likelihood. Where both models remain possible, the covariance is
that of their mixture about the simpler one (Hoeting et al., "Bayesian model averaging", 1999).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from magcal_ros.core.arrays import FloatArray
from magcal_ros.core.methods.maximum_likelihood import parameters as p
from magcal_ros.core.methods.maximum_likelihood.prior import SOFT_IRON_INDICES, Prior

PRIOR_ODDS = 1.4
"""Twice the logarithm of the odds against soft iron worth mentioning, about two to one."""
LEAST_PRICE = 14.0
"""On short arcs Occam's factor is weak; less than this is asked for by chance too often."""
CHANCE = 4.0
"""A fall of chi-square that noise alone brings easily; below it nothing speaks for soft iron."""
LEAST_PROBABILITY = 0.02
"""A smaller doubt would mostly widen what needs no widening."""
WORTH_A_FIT = 7.0
"""A fall of chi-square, seen from the optimum without soft iron, that may yet come to the least
price when it is fitted."""


@dataclass(frozen=True, eq=False)
class Look:
    """What soft iron would bring, seen from the optimum without it.

    Parameters
    ----------
    gain : float
        Fall of chi-square, independent samples counted as such; several kappas where there are.
    occam : float
        Twice the logarithm of prior over posterior room of the soft-iron numbers.
    kappa : float
        Samples per independent sample.
    step : ndarray, shape (18,)
        To the optimum with soft iron.
    covariance : ndarray, shape (18, 18)
        Of the globals with soft iron, kappa included; zero where not free.
    """

    gain: float
    occam: float
    kappa: float
    step: FloatArray
    covariance: FloatArray

    def price(self, most: float) -> float:
        """Return by how much, times kappa, chi-square must fall for soft iron to be fitted."""
        return min(max(self.occam + PRIOR_ODDS, LEAST_PRICE), most)

    def probability(self, gain: float) -> float:
        """Return how likely soft iron is although it was left out.

        Parameters
        ----------
        gain : float
            Fall of chi-square that the fit with soft iron found.
        """
        independent = gain / self.kappa
        if independent < CHANCE:
            return 0.0
        against = self.occam + PRIOR_ODDS - independent
        likely = 1.0 / (1.0 + math.exp(min(0.5 * against, 50.0)))
        return likely if likely > LEAST_PROBABILITY else 0.0


def look_for_soft_iron(
    covariance: FloatArray, gradient: FloatArray, prior: Prior, kappa: float
) -> Look:
    """Take one step with soft iron freed.

    Parameters
    ----------
    covariance : ndarray, shape (m, m)
        Inverse of the information with soft iron free; the free globals come first.
    gradient : ndarray, shape (m,)
    prior : Prior
        Frees soft iron.
    kappa : float
        Samples per independent sample, in the prior's part of the information.
    """
    free = prior.free
    move = covariance @ gradient
    iron = np.isin(free, SOFT_IRON_INDICES)
    among = covariance[: len(free), : len(free)]
    room = np.linalg.slogdet(kappa * among[np.ix_(iron, iron)])[1]
    occam = -float(np.log(prior.information[free[iron]]).sum()) - float(room)
    step, spread = np.zeros(p.COUNT), np.zeros((p.COUNT, p.COUNT))
    step[free] = move[: len(free)]
    spread[np.ix_(free, free)] = kappa * among
    return Look(float(gradient @ move), occam, kappa, step, spread)


@dataclass(frozen=True, eq=False)
class Doubt:
    """Soft iron that was not fitted, and how likely it is all the same."""

    look: Look
    probability: float

    def widened(self, covariance: FloatArray, jacobian: FloatArray) -> FloatArray:
        """Return the mean square error of the estimate, whichever of the two models is true.

        Parameters
        ----------
        covariance : ndarray, shape (12, 12)
            Without soft iron.
        jacobian : ndarray, shape (12, 18)
            Of the twelve numbers by the globals.
        """
        likely, away = self.probability, jacobian @ self.look.step
        rich = jacobian @ self.look.covariance @ jacobian.T
        return np.asarray((1.0 - likely) * covariance + likely * (rich + np.outer(away, away)))
