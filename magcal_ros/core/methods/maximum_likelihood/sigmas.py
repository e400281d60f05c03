"""The noise, estimated from the residuals themselves.

Each sample spends some of its information on its own attitude; the hat matrix of the sample says
how much of that each sensor paid, and the rest are the degrees of freedom that its residuals have
left (MacKay, "Bayesian interpolation", 1992).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from magcal_ros.core.arrays import FloatArray
from magcal_ros.core.methods.maximum_likelihood.linearise import Linearisation, Noise, Problem

UP_FLOOR = 0.005
FIELD_FLOOR = 0.001
WOBBLE_FLOOR = 1e-4
LEAST_FREEDOM = 0.02
"""Least share of a degree of freedom per sample: below it a sigma cannot be told."""


@dataclass(frozen=True, eq=False)
class Shares:
    """How much of its attitude each sample took from up, field and the prior on wobble; (n,)."""

    up: FloatArray
    field: FloatArray
    wobble: FloatArray


def shares(lin: Linearisation, problem: Problem) -> Shares:
    """Return the traces of the local hat matrix, split by source."""
    weight = problem.weights.data
    paid = np.sum((lin.local @ lin.local_covariance) * lin.local, axis=2) * weight[:, None]
    up, field = paid[:, :3].sum(axis=1), paid[:, 3:].sum(axis=1)
    return Shares(up, field, lin.local_covariance.shape[1] - up - field)


def estimate_noise(lin: Linearisation, problem: Problem, change: float) -> Noise:
    """Return the sigmas that the residuals of `lin` ask for.

    Parameters
    ----------
    lin : Linearisation
    problem : Problem
        Its noise is where the sigmas come from, its weights say which samples count.
    change : float
        Largest factor by which a sigma may change at once.
    """
    weight, noise = problem.weights.data, problem.noise
    used = problem.weights.sample > 0.5
    count = max(int(used.sum()), 1)
    paid = shares(lin, problem)
    squares = (weight * used)[:, None] * lin.residual**2
    freedom_up = np.sum(2.0 - paid.up[used]) - 4.0
    freedom_field = np.sum(3.0 - paid.field[used]) - (len(problem.prior.free) - 4.0)
    up = _sigma(squares[:, :3].sum(), freedom_up, count) * noise.up
    field = _sigma(squares[:, 3:].sum(), freedom_field, count) * noise.field
    wobble = noise.wobble
    if not problem.rigid:
        lean = problem.weights.wobble * np.sum(lin.state.lean[:, :2] ** 2, axis=1)
        freedom = np.sum(2.0 - paid.wobble[used])
        wobble = float(np.sqrt(lean[used].sum() / max(freedom, 1e-3 * count)))
    return Noise(
        _limited(up, noise.up, change, UP_FLOOR),
        _limited(field, noise.field, change, FIELD_FLOOR),
        _limited(wobble, noise.wobble, change, WOBBLE_FLOOR),
    )


def _sigma(squares: float, freedom: float, count: int) -> float:
    return float(np.sqrt(squares / max(freedom, LEAST_FREEDOM * count)))


def _limited(new: float, old: float, change: float, floor: float) -> float:
    return max(min(max(new, old / change), old * change), floor)


def largest_change(new: Noise, old: Noise, least_wobble: float = 0.0) -> float:
    """Return the largest relative change among the sigmas, as a logarithm.

    Parameters
    ----------
    new, old : Noise
    least_wobble : float
        Times the noise of up: a smaller wobble does not count.
    """
    pairs = [(new.up, old.up), (new.field, old.field)]
    if new.wobble > least_wobble * new.up:
        pairs.append((new.wobble, old.wobble))
    return float(max(abs(np.log(a / b)) for a, b in pairs))
