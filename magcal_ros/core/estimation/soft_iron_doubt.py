"""Soft iron that the samples neither show nor exclude (doc/estimator.md, section 9).

Seen from the optimum without soft iron, one step towards the optimum with it tells the fall of
chi-square, where the globals would go, and how much of the prior's volume the samples would leave:
the Occam factor of the marginal likelihood (MacKay, "Information theory, inference, and learning
algorithms", 2003, section 28.1). Where both models remain possible, the covariance is that of
their mixture about the simpler one (Hoeting et al., "Bayesian model averaging", 1999).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import expit

from magcal_ros.core.estimation import parameters as p
from magcal_ros.core.estimation.prior import SOFT_IRON_INDICES, Prior
from magcal_ros.core.geometry.arrays import FloatArray


@dataclass(frozen=True)
class SoftIronRule:
    """When soft iron is fitted, and when it is doubted; falls of chi-square per independent sample.

    Parameters
    ----------
    prior_odds : float
        Twice the log odds against soft iron worth mentioning, about two to one.
    least_fall : float
        On short arcs Occam's factor is weak; less than this is asked for by chance too often.
    most_fall, most_fall_rigid : float
        What leaves no doubt, on a wobbling or gyro-propagated axis and on a rigid one.
    chance : float
        A fall that noise alone brings easily; below it nothing speaks for soft iron.
    least_probability : float
        A smaller doubt would mostly widen what needs no widening.
    worth_a_fit : float
        A fall, seen from the optimum without soft iron, that may yet come to the least one asked
        for when it is fitted.
    clear : float
        An expected fall that leaves little doubt.
    honest_share : float
        A smaller share of inliers may hide soft iron: it is fitted, whatever the rest says.
    trusted_share : float
        A larger share of inliers tells what is an outlier: only what soft iron gains among them
        speaks for it.
    few_kept : float
        A model that throws more of the simpler one's inliers away, to fit the rest better,
        explains nothing.
    far_beyond, most_widenings : float, int
        Sigmas from which a number of soft iron is taken for larger than was believed, and how
        often the belief is widened at most.
    most_caution : float
        Times the usual fall of chi-square that a drifting gyro may ask for before soft iron is
        taken: in a car the accelerometer's jolts look like drift, and an ellipse of a fifth is no
        doubt.
    stretches, lasting_share : int, float
        Stretches of the turn, and the least share of soft iron's gain that is made outside the
        best two neighbouring ones.
    """

    prior_odds: float = 1.4
    least_fall: float = 14.0
    most_fall: float = 25.0
    most_fall_rigid: float = 20.0
    chance: float = 4.0
    least_probability: float = 0.02
    worth_a_fit: float = 7.0
    clear: float = 100.0
    honest_share: float = 0.97
    trusted_share: float = 0.6
    few_kept: float = 0.9
    far_beyond: float = 2.5
    most_widenings: int = 3
    most_caution: float = 16.0
    stretches: int = 8
    lasting_share: float = 1.0 / 3.0


RULE = SoftIronRule()


@dataclass(frozen=True, eq=False)
class Look:
    """What soft iron would bring, seen from the optimum without it.

    Parameters
    ----------
    gain : float
        Expected fall of chi-square, per independent sample.
    occam : float
        Twice the logarithm of prior over posterior volume of the soft-iron numbers.
    step : ndarray, shape (18,)
        To the optimum with soft iron.
    covariance : ndarray, shape (18, 18)
        Of the globals with soft iron, zero where not free.
    """

    gain: float
    occam: float
    step: FloatArray
    covariance: FloatArray

    @property
    def mean_square(self) -> FloatArray:
        """Of the error of the globals where there is soft iron and it is left out, (18, 18)."""
        return np.asarray(self.covariance + np.outer(self.step, self.step))

    def needed(self, most: float) -> float:
        """Return by how much chi-square must fall, per independent sample, for it to be fitted."""
        return min(max(self.occam + RULE.prior_odds, RULE.least_fall), most)

    def probability(self, gain: float) -> float:
        """Return how likely soft iron is although it was left out.

        Parameters
        ----------
        gain : float
            Fall of chi-square, per independent sample, that the fit with soft iron found.
        """
        if gain < RULE.chance:
            return 0.0
        against = self.occam + RULE.prior_odds - gain
        likely = float(expit(-0.5 * against))
        return likely if likely > RULE.least_probability else 0.0


def look_for_soft_iron(covariance: FloatArray, gradient: FloatArray, prior: Prior) -> Look:
    """Take one step with soft iron freed.

    Parameters
    ----------
    covariance : ndarray, shape (f, f)
        Of the globals that `prior` frees, per independent sample, with soft iron among them.
    gradient : ndarray, shape (f,)
    prior : Prior
    """
    free = prior.free
    move = covariance @ gradient
    step, spread = np.zeros(p.COUNT), np.zeros((p.COUNT, p.COUNT))
    step[free] = move
    spread[np.ix_(free, free)] = covariance
    return Look(float(gradient @ move), occam_factor(spread, prior), step, spread)


def occam_factor(covariance: FloatArray, prior: Prior) -> float:
    """Return twice the logarithm of prior over posterior volume of the free soft-iron numbers.

    Parameters
    ----------
    covariance : ndarray, shape (18, 18)
        Of all globals where soft iron is fitted.
    prior : Prior
        Frees soft iron.
    """
    iron = SOFT_IRON_INDICES[np.isin(SOFT_IRON_INDICES, prior.free)]
    posterior = float(np.linalg.slogdet(covariance[np.ix_(iron, iron)])[1])
    return -float(np.log(prior.information[iron]).sum()) - posterior


@dataclass(frozen=True, eq=False)
class Doubt:
    """Soft iron that was not fitted, and how likely it is all the same."""

    look: Look
    probability: float

    def widened(self, covariance: FloatArray, jacobian: FloatArray) -> FloatArray:
        """Return the mean square error of the estimate, whichever of the two models is true.

        With the simpler model's numbers as the estimate and p the richer one's probability it is
        `(1 - p) C_simple + p (C_rich + d d^T)`: the mixture about the simpler estimate, not about
        its mean.

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
