"""Calibration from stationary measurements of the field at known headings."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from magcal_ros.core.geometry.arrays import FloatArray
from magcal_ros.core.knowledge import Knowledge
from magcal_ros.core.smoother import factors
from magcal_ros.core.smoother.known_heading_model import (
    DRIFTS,
    KnownHeadingMeasurement,
    KnownHeadingModel,
    KnownHeadingOptimum,
)
from magcal_ros.core.smoother.posterior import Posterior, posterior_at
from magcal_ros.core.smoother.state import State
from magcal_ros.core.smoother.unknowns import DISTURBANCE_AT_REST, MICROTESLA, SHARED, Size

SPREADS = np.linspace(-2.4, 2.4, 7)
"""Sizes of the local disturbance that are tried, as prior spreads of its logarithm."""
LARGEST_PLAUSIBLE = -2
"""Index of the largest plausible size; headings that misfit even there are contradicted."""


@dataclass(frozen=True)
class HeadingAgreement:
    """How well known headings, field and gyro agree."""

    cost: float
    """Minus twice the logarithm of the evidence, up to a constant of the number of measurements."""
    misfit: float
    """Sum of squared normalised residuals at the usual size of the local disturbance."""
    least: float  # the same at the largest plausible size
    freedom: int
    """Degrees of freedom: components of the field, less the hard iron, plus turns by the gyro."""

    @property
    def chance(self) -> float:
        """The probability of a larger misfit by chance (p-value)."""
        from scipy.special import gammaincc

        return float(gammaincc(0.5 * self.freedom, 0.5 * self.least)) if self.freedom else 1.0

    @property
    def times(self) -> float:
        """Root mean square of the normalised residuals."""
        return math.sqrt(self.misfit / self.freedom) if self.freedom else 0.0


@dataclass(frozen=True, eq=False)
class HeadingFit:
    """The fit of measurements at known headings."""

    state: State
    covariance: FloatArray  # of the shared unknowns. Shape (SHARED, SHARED).
    posterior: Posterior
    agreement: HeadingAgreement
    residual: FloatArray
    """Residuals of the field, tesla, sensor axes. Shape (n, 3)."""


def fit_headings(
    measurements: Sequence[KnownHeadingMeasurement],
    knowledge: Knowledge,
    place: Size = DISTURBANCE_AT_REST,
) -> HeadingFit:
    """Return the fit of the shared unknowns to one or more measurements at known headings.

    `place` is the size of the local disturbance. Raises
    `numpy.linalg.LinAlgError` if a matrix is not positive definite.
    """
    model = KnownHeadingModel.of(measurements, knowledge)
    found, costs, agreement = _optima(model, place)
    weights = np.exp(-0.5 * (costs - costs.min()))
    weights = weights / weights.sum()
    shared = np.einsum("k,ks->s", weights, [each.state.shared for each in found])
    covariance = np.zeros((SHARED, SHARED))
    for weight, each in zip(weights, found, strict=True):
        off = each.state.shared - shared
        covariance += weight * (each.covariance + np.outer(off, off))
    if np.linalg.det(factors.soft_iron(shared)) <= 0.0:
        raise np.linalg.LinAlgError("the soft iron mirrors the axes")
    state = replace(found[int(np.argmax(weights))].state, shared=shared)
    posterior = posterior_at(state, covariance, knowledge.mounting.matrix)
    residual = model.field_of(state).residual @ knowledge.mounting.matrix.T / MICROTESLA
    return HeadingFit(state, covariance, posterior, agreement, residual)


def _optima(
    model: KnownHeadingModel, place: Size
) -> tuple[list[KnownHeadingOptimum], FloatArray, HeadingAgreement]:
    """Return the optima at sizes of the local disturbance and of a drift, costs, and agreement."""
    middle = model.optimum(place.rms)
    sizes = place.usual * np.exp(place.spread * SPREADS)
    found = [model.optimum(float(size), middle.state) for size in sizes]
    costs = np.array([each.cost for each in found]) + SPREADS**2
    usual, large = middle, found[LARGEST_PLAUSIBLE]
    if model.columns["drifts"].any():
        best = int(np.argmin(costs))
        size, start = float(sizes[best]), found[best].state
        drifting = [model.optimum(size, start, drift) for drift in DRIFTS]
        # The sizes of the disturbance are assumed to be as likely with a drift as without one.
        others = 2.0 * math.log(np.exp(-0.5 * (costs - costs[best])).sum()) - SPREADS[best] ** 2
        odds = 2.0 * np.log(list(DRIFTS.values()))
        costs = np.append(costs, [each.cost for each in drifting] - odds - others)
        found += drifting
        k = int(np.argmin(costs)) - len(SPREADS)
        if k >= 0:
            drift, start = list(DRIFTS)[k], drifting[k].state
            usual = model.optimum(place.rms, start, drift)
            large = model.optimum(float(sizes[LARGEST_PLAUSIBLE]), start, drift)
    return found, costs, _agreement(model, usual, large)


def agreement_of(
    measurements: Sequence[KnownHeadingMeasurement],
    knowledge: Knowledge,
    place: Size = DISTURBANCE_AT_REST,
) -> HeadingAgreement:
    """Return the agreement of measurements; parameters and errors as for `fit_headings`."""
    model = KnownHeadingModel.of(measurements, knowledge)
    middle = model.optimum(place.rms)
    size = place.usual * math.exp(place.spread * SPREADS[LARGEST_PLAUSIBLE])
    return _agreement(model, middle, model.optimum(size, middle.state))


def _agreement(
    model: KnownHeadingModel, usual: KnownHeadingOptimum, large: KnownHeadingOptimum
) -> HeadingAgreement:
    turns = np.isfinite(model.columns["turned_sigma"][1:])
    freedom = 3 * len(model.common) - 3 + int(turns.sum())
    return HeadingAgreement(usual.cost, usual.misfit, large.misfit, freedom)


def sigma_with(
    fit: HeadingFit,
    measurements: Sequence[KnownHeadingMeasurement],
    knowledge: Knowledge,
    heading: float,
) -> float:
    """Return the sigma of the heading on the level after one more measurement, radians.

    `fit` is the fit of the measurements so far. The next one has `heading`, radians to magnetic
    north, and the sigma of the last one.
    """
    last = replace(measurements[-1], heading=heading, turned_sigma=math.inf, distance=math.inf)
    more = KnownHeadingModel.of([*measurements, last], knowledge)
    # The covariance does not depend on the new field.
    state = replace(more.start, shared=fit.state.shared)
    found = more.optimum(DISTURBANCE_AT_REST.rms, state, rounds=0)
    return posterior_at(state, found.covariance, knowledge.mounting.matrix).heading_sigma
