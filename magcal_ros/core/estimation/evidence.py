"""Marginal likelihoods of models with an attitude for each sample (doc/estimator.md, section 9)."""

from __future__ import annotations

import math

import numpy as np

from magcal_ros.core.estimation.free_attitude import FreeBlock
from magcal_ros.core.estimation.gyro_attitude import GyroBlock
from magcal_ros.core.estimation.leans import log_determinants, log_turn_informations
from magcal_ros.core.estimation.prior import Prior
from magcal_ros.core.estimation.solver import Fit
from magcal_ros.core.estimation.weighting import Noise, Weighting, Weights
from magcal_ros.core.estimation.weights import student_cost
from magcal_ros.core.geometry.arrays import BoolArray


def soft_evidence(block: FreeBlock, prior: Prior) -> float:
    """Return minus twice the log marginal likelihood with Student-t residuals, up to a constant."""
    weighting = block.weighting
    plain = block.weighted(Weighting(weighting.noise, Weights.ones(len(block.samples))))
    local, count = plain.local, len(block.samples)
    return (
        student_cost(plain.chi, leans=block.leans)
        + _noise_cost(weighting.noise, count)
        + weighting.inefficiency * prior.cost(block.place.state.shared)
        + float((log_determinants(local) + log_turn_informations(local, weighting.noise)).sum())
        + (4.0 * count * math.log(weighting.noise.wobble) if block.leans else 0.0)
    )


def propagated_evidence(fit: Fit, inefficiency: float) -> float:
    """Return minus twice the log likelihood of a gyro-propagated turn, Student-t residuals.

    Per independent sample, the priors of the errors included, up to a constant.

    Parameters
    ----------
    fit : Fit
        Of one turn.
    inefficiency : float
        The same for all models that are compared.
    """
    block = fit.block
    assert isinstance(block, GyroBlock)
    noise, count = block.weighting.noise, len(block.samples)
    data = student_cost(block.chi, leans=False) + _noise_cost(noise, count)
    believed = float(block.errors @ block.prior_information @ block.errors)
    return data / inefficiency + believed + fit.prior.cost(fit.shared)


def evidence(block: FreeBlock, prior: Prior, inliers: BoolArray, inefficiency: float) -> float:
    """Return minus twice the log marginal likelihood of the inliers, up to a constant.

    Parameters
    ----------
    block : FreeBlock
    prior : Prior
    inliers : ndarray of bool, shape (n,)
        The same for all models that are compared.
    inefficiency : float
        The same for all models that are compared.
    """
    noise = block.weighting.noise
    plain = block.weighted(Weighting(noise, Weights.ones(len(inliers))))
    count = int(inliers.sum())
    turns = log_turn_informations(plain.local, noise)
    total = float(np.sum((plain.chi.data + turns)[inliers])) + _noise_cost(noise, count)
    total += inefficiency * prior.cost(block.place.state.shared)
    if not block.leans:
        return total
    # Two lean angles a sample, each with a Gaussian prior and integrated over.
    lean = np.sum((plain.chi.wobble + log_determinants(plain.local))[inliers])
    return total + float(lean) + 4.0 * count * math.log(noise.wobble)


def _noise_cost(noise: Noise, count: int) -> float:
    """Return the normalisation of the Gaussians: two numbers of up, three of field."""
    return count * (4.0 * math.log(noise.up) + 6.0 * math.log(noise.field))
