"""What the samples of one turn are weighed by (doc/estimator.md, sections 2 and 5)."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from magcal_ros.core.estimation.model import Evaluation
from magcal_ros.core.geometry.arrays import BoolArray, FloatArray


@dataclass(frozen=True)
class Noise:
    """Standard deviations: up (radians), field (field scales), wobble (radians), per axis."""

    up: float
    field: float
    wobble: float

    @property
    def whitening(self) -> FloatArray:
        """What the six residuals of a sample are multiplied by."""
        return np.repeat([1.0 / self.up, 1.0 / self.field], 3)


@dataclass(frozen=True, eq=False)
class Weights:
    """How much each sample counts; each array of shape (n,).

    Parameters
    ----------
    data, wobble : ndarray
        IRLS weights of the sample's measurements and of its lean, 0 to about 2.
    sample : ndarray
        What the sample as a whole says about the globals, 0 or 1. The attitude of a sample that
        counts nothing still follows its measurements, so a trimmed refit can take it back.
    """

    data: FloatArray
    wobble: FloatArray
    sample: FloatArray

    @classmethod
    def ones(cls, n: int) -> Weights:
        """Count every sample fully."""
        return cls(np.ones(n), np.ones(n), np.ones(n))

    @classmethod
    def of_inliers(cls, inliers: BoolArray) -> Weights:
        """Count the inliers fully and the others not at all."""
        return replace(cls.ones(len(inliers)), sample=inliers.astype(float))


@dataclass(frozen=True, eq=False)
class Weighting:
    """Noise and weights of one turn.

    Parameters
    ----------
    noise : Noise
    weights : Weights
    inefficiency : float
        The inefficiency factor kappa: samples that make one independent sample, one or more.
    """

    noise: Noise
    weights: Weights
    inefficiency: float = 1.0

    @property
    def inliers(self) -> BoolArray:
        """Samples that count, shape (n,)."""
        return self.weights.sample > 0.5


@dataclass(frozen=True, eq=False)
class ChiSquares:
    """Squared whitened residuals per sample: up, field, wobble; each shape (n,)."""

    up: FloatArray
    field: FloatArray
    wobble: FloatArray

    @property
    def data(self) -> FloatArray:
        """Up and field together."""
        return self.up + self.field


def chi_squares(place: Evaluation, noise: Noise) -> ChiSquares:
    """Return the squared whitened residuals at a place."""
    up, field, lean = place.squares
    return ChiSquares(up / noise.up**2, field / noise.field**2, lean / noise.wobble**2)


def whitened(place: Evaluation, noise: Noise) -> FloatArray:
    """Return the residuals of up and field over their noise, shape (n, 6)."""
    prediction = place.prediction
    return np.concatenate(
        [prediction.up_residual / noise.up, prediction.field_residual / noise.field], axis=1
    )
