"""IRLS weights on the way, a trimmed refit at the end (doc/estimator.md, section 5)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import chdtri

from magcal_ros.core.estimation.weighting import ChiSquares, Weights
from magcal_ros.core.geometry.arrays import BoolArray, FloatArray, runs


@dataclass(frozen=True)
class Robustness:
    """What stands for outliers, and where the gate stands.

    Parameters
    ----------
    student : float
        Degrees of freedom of the Student-t distribution that stands in for noise with outliers.
    gate_tail : float
        Share of valid samples that the gate may drop.
    local_tail : float
        The same of sums over neighbours.
    local_windows : tuple of (int, int)
        The local gate sums residuals over these fractions of the turn, at least so many samples.
    shoulder : float
        A dropped stretch takes so much of its own length with it at each end.
    """

    student: float = 4.0
    gate_tail: float = 3e-4
    local_tail: float = 1e-4
    local_windows: tuple[tuple[int, int], ...] = ((100, 5), (25, 9))
    shoulder: float = 0.2


ROBUST = Robustness()


def student_weights(chi: ChiSquares, *, leans: bool) -> Weights:
    """Return the weights under which least squares fits Student-t residuals.

    Data (five degrees of freedom, of which the attitude takes two or so) and wobble are weighed
    apart: a robot that leans is no outlier.
    """
    data = (ROBUST.student + 3.0) / (ROBUST.student + chi.data)
    wobble = (ROBUST.student + 2.0) / (ROBUST.student + chi.wobble) if leans else np.ones(len(data))
    return Weights(data, wobble, np.ones(len(data)))


def student_cost(chi: ChiSquares, *, leans: bool) -> float:
    """Return minus twice the log-likelihood of Student-t residuals, up to a constant."""
    total = (ROBUST.student + 3.0) * np.log1p(chi.data / ROBUST.student).sum()
    if leans:
        total += (ROBUST.student + 2.0) * np.log1p(chi.wobble / ROBUST.student).sum()
    return float(total)


def gate(residual: FloatArray, chi: ChiSquares, share: FloatArray) -> BoolArray:
    """Return which samples agree with the model, each alone and together with its neighbours.

    Parameters
    ----------
    residual : ndarray, shape (n, 6)
        Whitened.
    chi : ChiSquares
        Of the same place.
    share : ndarray, shape (n,)
        Degrees of freedom that each sample spent on its attitude.
    """
    alone = passes_alone(chi, share)
    together = alone & locally_quiet(residual, alone, 5.0 - float(np.mean(share)))
    enough = max(20, int(0.3 * len(alone)))
    return together if together.sum() >= enough else alone


def passes_alone(chi: ChiSquares, share: FloatArray | float = 3.0) -> BoolArray:
    """Return which samples pass the gate by themselves, shape (n,)."""
    return np.asarray(chi.data < chdtri(np.clip(5.0 - share, 2.0, 5.0), ROBUST.gate_tail))


def locally_quiet(residual: FloatArray, alone: BoolArray, freedom: float) -> BoolArray:
    """Return where the residuals of neighbouring samples do not add up to something.

    A passing disturbance too weak for any single sample shows in sums over a stretch, and the
    whole stretch is dropped: the disturbance comes and goes gently. Honest residuals are
    correlated too, so each sum is measured against the median of all.

    Parameters
    ----------
    residual : ndarray, shape (n, k)
        Whitened.
    alone : ndarray of bool, shape (n,)
        Samples that passed by themselves.
    freedom : float
        Degrees of freedom of one sample's residual.
    """
    n = len(residual)
    quiet = np.ones(n, dtype=bool)
    masked = residual * alone[:, None]
    limit, half = chdtri(freedom, ROBUST.local_tail), chdtri(freedom, 0.5)
    for part, least in ROBUST.local_windows:
        width = max(least, n // part)
        count = np.maximum(moving_sum(alone.astype(float), width), 1.0)
        power = np.sum(moving_sum(masked, width) ** 2, axis=1) / count
        usual = float(np.median(power[alone])) / half if alone.any() else 1.0
        loud = (power > limit * max(1.0, usual)).astype(float)
        quiet &= moving_sum(loud[::-1], width)[::-1] == 0.0
    return quiet & ~_shoulders(~quiet)


def _shoulders(loud: BoolArray) -> BoolArray:
    """Return the neighbourhood of loud stretches, each longer by a share of itself at both ends.

    What comes gently is under the noise at first: a stretch that is dropped for its middle still
    pulls with its ends.
    """
    around = loud.copy()
    for first, last in runs(loud):
        reach = int(ROBUST.shoulder * (last - first))
        around[max(first - reach, 0) : last + reach] = True
    return np.asarray(around)


def moving_sum(values: FloatArray, width: int) -> FloatArray:
    """Sum over `width` neighbours along the first axis, shorter at the ends."""
    n = len(values)
    total = np.concatenate([np.zeros_like(values[:1]), np.cumsum(values, axis=0)])
    before = (width - 1) // 2
    first = np.maximum(np.arange(n) - before, 0)
    last = np.minimum(np.arange(n) - before + width, n)
    return np.asarray(total[last] - total[first])
