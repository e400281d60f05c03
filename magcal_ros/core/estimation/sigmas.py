"""The noise, estimated from the residuals themselves (doc/estimator.md, section 6).

Each sample spends some of its information on its own attitude; the hat matrix of the sample says
how much of that each sensor paid, and the rest are the degrees of freedom that its residuals have
left (MacKay, "Bayesian interpolation", 1992).
"""

from __future__ import annotations

import math

import numpy as np

from magcal_ros.core.estimation.weighting import Noise, Weighting
from magcal_ros.core.geometry.arrays import FloatArray

FLOOR = Noise(up=0.005, field=0.001, wobble=1e-4)
"""Smallest noise that is taken for real (radians, field scales, radians): what is not white in real
sensors lies above it."""


def estimate_noise(
    residual: FloatArray,
    weighting: Weighting,
    freedom: Noise,
    change: float,
) -> Noise:
    """Return the sigmas that whitened residuals ask for.

    Parameters
    ----------
    residual : ndarray, shape (n, 6)
        Whitened by the noise of `weighting`.
    weighting : Weighting
    freedom : Noise
        Degrees of freedom of the residuals of up and field; the sigma of the wobble as it is asked
        for, since leans are no residuals.
    change : float
        Largest factor by which a sigma may change at once.
    """
    weights, noise = weighting.weights, weighting.noise
    squares = (weights.data * weighting.inliers)[:, None] * residual**2
    return limited(
        Noise(
            noise.up * math.sqrt(float(squares[:, :3].sum()) / freedom.up),
            noise.field * math.sqrt(float(squares[:, 3:].sum()) / freedom.field),
            freedom.wobble,
        ),
        noise,
        change,
    )


def limited(new: Noise, old: Noise, change: float) -> Noise:
    """Return the new sigmas, none changed by more than a factor and none below its floor."""

    def one(new: float, old: float, floor: float) -> float:
        return max(min(max(new, old / change), old * change), floor)

    return Noise(
        one(new.up, old.up, FLOOR.up),
        one(new.field, old.field, FLOOR.field),
        one(new.wobble, old.wobble, FLOOR.wobble),
    )


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
