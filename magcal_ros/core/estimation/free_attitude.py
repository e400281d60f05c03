"""A turn in which each sample has an attitude of its own (doc/estimator.md, section 4)."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from magcal_ros.core.estimation.block import AXES, Reduced, TurnBlock
from magcal_ros.core.estimation.free_equations import (
    LocalEquations,
    SchurSystem,
    local_equations,
    schur_system,
)
from magcal_ros.core.estimation.leans import log_determinant_gradient, log_determinants
from magcal_ros.core.estimation.model import Evaluation, Samples, State
from magcal_ros.core.estimation.parameters import COUNT, Globals
from magcal_ros.core.estimation.seating import attitudes_from_vectors, seated
from magcal_ros.core.estimation.sigmas import estimate_noise
from magcal_ros.core.estimation.weighting import (
    ChiSquares,
    Noise,
    Weighting,
    Weights,
    chi_squares,
)
from magcal_ros.core.geometry.arrays import FloatArray, IntArray

LEAST_FREEDOM = 0.02
"""Least degrees of freedom per sample: below it a sigma cannot be told."""


@dataclass(frozen=True, eq=False)
class FreeBlock:
    """A turn in which each sample has an attitude of its own.

    Parameters
    ----------
    place : Evaluation
    weighting : Weighting
    leans : bool
        Whether the axis wobbles and each sample may lean; otherwise it is rigid.
    own : ndarray of int
        Indices of the globals that belong to this turn alone; none where the axes are held.
    """

    place: Evaluation
    weighting: Weighting
    leans: bool = True
    own: IntArray = field(default_factory=AXES.copy)

    drift = 0.0

    @classmethod
    def seated_at(cls, shared: Globals, samples: Samples, weighting: Weighting) -> FreeBlock:
        """Return a wobbling turn with the attitudes that up and field show under `shared`."""
        state = State(shared, attitudes_from_vectors(shared, samples))
        return cls(Evaluation(state, samples), weighting)

    @property
    def samples(self) -> Samples:
        """The samples as they were measured."""
        return self.place.samples

    @property
    def wobble(self) -> float:
        """RMS lean of the axis, radians per axis; zero for a rigid axis."""
        return self.weighting.noise.wobble if self.leans else 0.0

    @cached_property
    def chi(self) -> ChiSquares:
        """Squared whitened residuals."""
        return chi_squares(self.place, self.weighting.noise)

    @property
    def sample_costs(self) -> FloatArray:
        """Weighted squares of each sample, shape (n,)."""
        weights = self.weighting.weights
        each = weights.data * self.chi.data
        if self.leans:
            each += weights.wobble * self.chi.wobble
        return np.asarray(weights.sample * each)

    @property
    def cost(self) -> float:
        """Weighted sum of squares, leans included."""
        return float(self.sample_costs.sum())

    @property
    def lean_cost(self) -> float:
        """The counted samples' log-determinants of the leans."""
        if not self.leans:
            return 0.0
        return float(self.weighting.weights.sample @ log_determinants(self.local))

    @cached_property
    def local(self) -> LocalEquations:
        """The samples' own equations, globals held."""
        return local_equations(self.place, self.weighting, self.leans)

    def equations(self, free: IntArray) -> FreeEquations:
        """Return the normal equations over the globals `free`."""
        return FreeEquations(self, schur_system(self.place, self.weighting, self.local, free))

    def moved(self, step: FloatArray, local: FloatArray) -> FreeBlock:
        """Return the block after a step of all globals (18,) and of the attitudes (n, l)."""
        return replace(self, place=self.place.moved(step, local))

    def weighted(self, weighting: Weighting) -> FreeBlock:
        """Return the block with another weighting."""
        return replace(self, weighting=weighting)

    def under(self, other: TurnBlock) -> FreeBlock:
        """Return this turn's place under another block's weighting and rigidity."""
        place = self.place
        if self.leans and not other.leans:
            place = Evaluation(place.state.upright(), place.samples)
        return FreeBlock(place, other.weighting, other.leans)

    def at(self, shared: Globals) -> FreeBlock:
        """Return the block with other shared numbers; axes and attitudes are found anew."""
        state = seated(shared, self.samples, self.weighting.inliers)
        state = state if self.leans else state.upright()
        return replace(self, place=Evaluation(state, self.samples))

    def stiffened(self) -> FreeBlock:
        """Return where the fit of a rigid axis begins: what were leans is now noise of up."""
        noise = self.weighting.noise
        noise = replace(noise, up=float(np.hypot(noise.up, noise.wobble)))
        weighting = replace(self.weighting, noise=noise)
        return FreeBlock(
            Evaluation(self.place.state.upright(), self.samples), weighting, leans=False
        )

    def following(self, samples: Samples, noise: Noise, steps: int = 3) -> FreeBlock:
        """Return other samples of the turn at their best attitudes, the globals held."""
        weighting = Weighting(noise, Weights.ones(len(samples)))
        block = FreeBlock.seated_at(self.place.state.shared, samples, weighting)
        block = block if self.leans else replace(block.under(self), weighting=weighting)
        for _ in range(steps):
            moved = block.moved(np.zeros(COUNT), block.local.best_step)
            if not moved.cost < block.cost:
                break
            block = moved
        return block


@dataclass(frozen=True, eq=False)
class Shares:
    """How much of its attitude each sample took from up, field and the prior on wobble; (n,)."""

    up: FloatArray
    field: FloatArray
    wobble: FloatArray


@dataclass(frozen=True, eq=False)
class FreeEquations:
    """The normal equations of a `FreeBlock`, and what its residuals say of the noise."""

    block: FreeBlock
    system: SchurSystem

    @property
    def diagonal(self) -> FloatArray:
        """Diagonal of the information, attitudes held, shape (f,)."""
        return np.asarray(np.diag(self.system.information))

    @cached_property
    def lean_gradient(self) -> FloatArray:
        """Gradient of the marginalised leans' half log-determinant, shape (f,)."""
        if not self.block.leans:
            return np.zeros(len(self.system.free))
        return log_determinant_gradient(self.system)

    @cached_property
    def shares(self) -> Shares:
        """Traces of the local hat matrix, split by source."""
        jacobian, covariance = self.system.local.jacobian, self.system.local.covariance
        weight = self.block.weighting.weights.data
        paid = np.sum((jacobian @ covariance) * jacobian, axis=2) * weight[:, None]
        up, rest = paid[:, :3].sum(axis=1), paid[:, 3:].sum(axis=1)
        return Shares(up, rest, covariance.shape[1] - up - rest)

    @property
    def attitude_shares(self) -> FloatArray:
        """Degrees of freedom that each sample spent on its attitude, shape (n,)."""
        return np.asarray(self.shares.up + self.shares.field)

    def reduced(self, damping: float) -> Reduced:
        """Eliminate the attitudes."""
        return self.system.reduced(damping)

    def renoised(self, change: float, known: FloatArray, share: float) -> FreeBlock:
        """Return the block with the noise that the residuals ask for.

        Up has paid for its axis in the body and the world, the field for the shared numbers.
        """
        weighting = self.block.weighting
        used = weighting.inliers
        count = max(int(used.sum()), 1)
        paid, least = self.shares, LEAST_FREEDOM * count
        up = float(np.sum(2.0 - paid.up[used])) - len(self.block.own)
        rest = float(np.sum(3.0 - paid.field[used])) - share * len(known)
        freedom = Noise(max(up, least), max(rest, least), self._wobble(count))
        noise = estimate_noise(self.system.local.residual, weighting, freedom, change)
        return self.block.weighted(replace(weighting, noise=noise))

    def _wobble(self, count: int) -> float:
        weighting = self.block.weighting
        if not self.block.leans:
            return weighting.noise.wobble
        used = weighting.inliers
        squares = np.sum(self.block.place.state.lean[:, :2] ** 2, axis=1)
        squares = squares * weighting.weights.wobble
        freedom = float(np.sum(2.0 - self.shares.wobble[used]))
        return float(np.sqrt(squares[used].sum() / max(freedom, 1e-3 * count)))
