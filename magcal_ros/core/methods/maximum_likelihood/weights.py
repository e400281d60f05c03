"""Which samples to believe: soft weights on the way, gates at the end."""

from __future__ import annotations

import numpy as np
from scipy.special import chdtri

from magcal_ros.core.arrays import BoolArray, FloatArray
from magcal_ros.core.methods.maximum_likelihood.linearise import ChiSquares, Linearisation, Weights

STUDENT = 4.0
"""Degrees of freedom of the Student-t distribution that stands in for noise with outliers."""

GATE_TAIL = 3e-4
"""Share of honest samples that the gate may drop."""

LOCAL_TAIL = 1e-4
LOCAL_WINDOWS = ((100, 5), (25, 9))
"""The local gate sums residuals over these fractions of the turn, at least so many samples."""

SHOULDER = 0.2
"""A dropped stretch takes so much of its own length with it at each end."""


def student_weights(chi: ChiSquares, rigid: bool) -> Weights:
    """Return the weights under which least squares fits Student-t residuals.

    Data (five degrees of freedom, of which the attitude takes two or so) and wobble are weighed
    apart: a robot that leans is no outlier.
    """
    data = (STUDENT + 3.0) / (STUDENT + chi.data)
    wobble = np.ones(len(data)) if rigid else (STUDENT + 2.0) / (STUDENT + chi.wobble)
    return Weights(data, wobble, np.ones(len(data)))


def student_cost(chi: ChiSquares, rigid: bool) -> float:
    """Return minus twice the log-likelihood of Student-t residuals, up to a constant."""
    total = (STUDENT + 3.0) * np.log1p(chi.data / STUDENT).sum()
    if not rigid:
        total += (STUDENT + 2.0) * np.log1p(chi.wobble / STUDENT).sum()
    return float(total)


def gate(lin: Linearisation, chi: ChiSquares, share: FloatArray) -> BoolArray:
    """Return which samples agree with the model, each alone and together with its neighbours.

    Parameters
    ----------
    lin : Linearisation
        Holds the whitened residuals.
    chi : ChiSquares
        Of the same state.
    share : ndarray, shape (n,)
        Degrees of freedom that each sample spent on its attitude.
    """
    return gate_residuals(lin.residual, chi, share)


def gate_residuals(residual: FloatArray, chi: ChiSquares, share: FloatArray) -> BoolArray:
    """Return the same from whitened residuals (n, 6) alone."""
    alone = passes_alone(chi, share)
    together = alone & locally_quiet(residual, alone, 5.0 - float(np.mean(share)))
    enough = max(20, int(0.3 * len(alone)))
    return together if together.sum() >= enough else alone


def passes_alone(chi: ChiSquares, share: FloatArray | float = 3.0) -> BoolArray:
    """Return which samples pass the gate by themselves, shape (n,)."""
    return np.asarray(chi.data < chdtri(np.clip(5.0 - share, 2.0, 5.0), GATE_TAIL))


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
    limit, half = chdtri(freedom, LOCAL_TAIL), chdtri(freedom, 0.5)
    for part, least in LOCAL_WINDOWS:
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
    edges = np.flatnonzero(np.diff(np.concatenate([[False], loud, [False]]).astype(int)))
    around = loud.copy()
    for first, last in edges.reshape(-1, 2):
        reach = int(SHOULDER * (last - first))
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


def hard_weights(believed: BoolArray) -> Weights:
    """Return weights that count the believed samples fully and the others not at all."""
    n = len(believed)
    return Weights(np.ones(n), np.ones(n), believed.astype(float))
