"""One turn's part in a fit, whichever way the attitudes of its samples are tied.

A block holds the samples of one turn, their weighting and its present place. There are two kinds:
in `free_attitude` each sample has an attitude of its own, in `gyro_attitude` the gyro propagates
one attitude through the turn. The solver knows what is written here and nothing else of them.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from magcal_ros.core.estimation.model import Evaluation, Samples
from magcal_ros.core.estimation.parameters import Globals
from magcal_ros.core.estimation.weighting import ChiSquares, Weighting
from magcal_ros.core.geometry.arrays import FloatArray, IntArray

AXES = np.array([0, 1, 2, 3])
"""Parameters of a turn's own axis, in the body and in the world."""


@dataclass(frozen=True, eq=False)
class Reduced:
    """Normal equations with the turn's own numbers eliminated (Schur complement).

    Parameters
    ----------
    information, gradient : ndarray, shape (f, f) and (f,)
        Of the data, over the free parameters that were asked for.
    local : ndarray
        Step of the turn's own numbers where the free parameters stay; any leading shape.
    coupling : ndarray, shape (*local.shape, f)
        What that step changes by for a step of the free parameters, with its sign turned.
    """

    information: FloatArray
    gradient: FloatArray
    local: FloatArray
    coupling: FloatArray

    def follow(self, move: FloatArray) -> FloatArray:
        """Return the step of the turn's own numbers that goes with a step (f,) of the others."""
        return np.asarray(self.local - self.coupling @ move)


class Equations(Protocol):
    """The normal equations of a block's data at its place."""

    @property
    def diagonal(self) -> FloatArray:
        """Diagonal of the information with nothing eliminated, shape (f,)."""

    @property
    def lean_gradient(self) -> FloatArray:
        """Gradient of the marginalised leans' half log-determinant, shape (f,)."""

    @property
    def attitude_shares(self) -> FloatArray:
        """Degrees of freedom that each sample spent on its own attitude, shape (n,)."""

    def reduced(self, damping: float) -> Reduced:
        """Eliminate the turn's own numbers, their part damped by Levenberg and Marquardt's rule."""

    def renoised(self, change: float, known: FloatArray, share: float) -> TurnBlock:
        """Return the block with the noise that the residuals ask for.

        Parameters
        ----------
        change : float
            Largest factor by which a sigma may change at once.
        known : ndarray, shape (s,)
            Prior information on the shared parameters among the free ones.
        share : float
            Part of the shared parameters that this turn has paid for, 0 to 1.
        """


class TurnBlock(Protocol):
    """Samples of one turn, how they are weighed, and where the fit stands."""

    @property
    def place(self) -> Evaluation:
        """State and samples."""

    @property
    def samples(self) -> Samples:
        """The samples as they were measured."""

    @property
    def weighting(self) -> Weighting:
        """Noise, weights and inefficiency factor."""

    @property
    def own(self) -> IntArray:
        """Indices of the globals that belong to this turn alone."""

    @property
    def leans(self) -> bool:
        """Whether each sample has a lean of its own that is integrated out."""

    @property
    def drift(self) -> float:
        """Random walk of the gyro's attitude, rad per root second; zero without a gyro."""

    @property
    def wobble(self) -> float:
        """RMS lean of the axis, radians per axis; zero for a rigid axis."""

    @property
    def chi(self) -> ChiSquares:
        """Squared whitened residuals of the samples, each shape (n,)."""

    @property
    def sample_costs(self) -> FloatArray:
        """Weighted squares of each sample, shape (n,)."""

    @property
    def cost(self) -> float:
        """Weighted sum of squares, priors of the turn's own numbers included."""

    @property
    def lean_cost(self) -> float:
        """The counted samples' log-determinants of the leans."""

    def equations(self, free: IntArray) -> Equations:
        """Return the normal equations over the globals `free`."""

    def moved(self, step: FloatArray, local: FloatArray) -> TurnBlock:
        """Return the block after a step of all globals (18,) and of its own numbers."""

    def weighted(self, weighting: Weighting) -> TurnBlock:
        """Return the block with another weighting."""

    def under(self, other: TurnBlock) -> TurnBlock:
        """Return this turn's place under another block's weighting, rigidity and drift."""

    def at(self, shared: Globals) -> TurnBlock:
        """Return the block with other shared numbers, its own found anew."""
