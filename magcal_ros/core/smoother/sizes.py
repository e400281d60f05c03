"""How large noises and effects are: found with the unknowns, each with a log-normal prior."""

from __future__ import annotations

import math

import numpy as np

from magcal_ros.core.geometry.arrays import FloatArray, IntArray
from magcal_ros.core.smoother.factors import Linear
from magcal_ros.core.smoother.model import Model, Point, counted_unknowns
from magcal_ros.core.smoother.solver import Solution, Weighted
from magcal_ros.core.smoother.unknowns import AT, UNKNOWNS, VELOCITY, Size

GRID = 60
"""Factors of an effect's sigma that are tried."""


def noise_sizes(
    model: Model, point: Point, weighted: dict[str, Weighted], solution: Solution
) -> tuple[dict[str, float], dict[str, float], FloatArray]:
    """Return the next sizes of the noises, and by how many residuals each is shown.

    By MacKay's fixed point (Bayesian interpolation, Neural Computation 4, 1992): the squared
    residuals over their variance add up to the number of residuals that the samples determine.

    Returns
    -------
    sizes, shown : dict of str to float
    doubt : ndarray, shape (n,)
        Variance of the nodes' velocities, (m/s)².
    """
    own, beside = solution.node_covariance()
    free = counted_unknowns(model, point.places)
    sizes, shown = {}, {}
    for name, part in weighted.items():
        counted, linear = np.isfinite(part.variance), part.linear
        spent = part.weight * _variance(linear, solution, own, beside, free)
        square = part.weight * np.sum(linear.residual**2, axis=1)
        total, taken = float(np.sum(square[counted])), float(np.sum(spent[counted]))
        number = int(counted.sum()) * linear.residual.shape[1]
        if name == "street" and len(point.places):
            more, less = _by_centres(point, solution)
            total, taken, number = total + more, taken + less, number + 3 * len(point.places)
        shown[name] = max(number - taken, 0.0)
        sizes[name] = _next_size(point.sizes[name], total, shown[name], model.priors.sizes[name])
    follow = solution.follow[:, VELOCITY]
    by_shared = np.sum((follow @ solution.covariance) * follow, axis=(1, 2))
    return sizes, shown, np.trace(own[:, VELOCITY, VELOCITY], axis1=1, axis2=2) + by_shared


def _by_centres(point: Point, solution: Solution) -> tuple[float, float]:
    """Return the centres' squares over their variance, and what of it their covariance makes."""
    places, variance = point.places, point.sizes["street"] ** 2
    rows = slice(-3 * len(places), None)
    blocks = solution.covariance[rows, rows].reshape(len(places), 3, len(places), 3)
    spread = np.einsum("iaja->ij", blocks) / variance
    values = point.state.centres @ point.state.centres.T / variance
    by_values, by_spread = (np.sum(places.information * each) for each in (values, spread))
    return float(by_values), float(by_spread)


def _variance(
    linear: Linear, solution: Solution, own: FloatArray, beside: FloatArray, free: IntArray
) -> FloatArray:
    """Return the sum of the variances of a prediction's components, shape (k,)."""
    here, follow = linear.here, solution.follow
    count = len(here)
    by_local = np.sum((here @ own[:count]) * here, axis=(1, 2))
    by_shared = -(here @ follow[:count])
    if linear.there is not None:
        there = linear.there
        by_local += np.sum((2.0 * here @ beside + there @ own[1:]) * there, axis=(1, 2))
        by_shared -= there @ follow[1:]
    if linear.shared is not None:
        direct = linear.by(free)
        by_shared[:, :, : direct.shape[2]] += direct
    flat = by_shared.reshape(-1, len(free))
    shared = np.sum((flat @ solution.covariance) * flat, axis=1)
    return np.asarray(by_local + shared.reshape(count, -1).sum(axis=1))


def _next_size(size: float, total: float, shown: float, belief: Size) -> float:
    """Return the size at which `total` squares over the old variance fit the number shown.

    Solves t exp(-2 x) - n - (x + x0 - m) / s^2 = 0 for the step x of the logarithm by Newton.
    """
    shown = max(shown, 1e-3)
    off, change = math.log(size / belief.usual), 0.0
    for _ in range(30):
        scaled = total * math.exp(-2.0 * change)
        slope = scaled - shown - (off + change) / belief.spread**2
        step = slope / (2.0 * scaled + belief.spread**-2.0)
        change += max(-0.5, min(0.5, step))
        if abs(step) < 1e-4:
            break
    return size * math.exp(max(-0.7, min(0.7, change)))


def expected_square(size: float, shown: float, belief: Size) -> float:
    """Return the root mean square of a size under its posterior.

    Its logarithm is about normal, with the information of the residuals shown and of the prior.
    """
    return size * math.exp(1.0 / (2.0 * shown + belief.spread**-2.0))


def effect_factors(model: Model, point: Point, solution: Solution) -> dict[str, float]:
    """Return the most likely factors of the effects' sigmas."""
    return {name: effect_factor(model, point, solution, name) for name in AT}


def effect_factor(
    model: Model, point: Point, solution: Solution, name: str, *, expected: bool = False
) -> float:
    """Return the most likely factor of a group's sigmas, or the root of its mean square.

    Of each group the posterior less its prior is what the samples say, with all else integrated
    out. From that the marginal likelihood of any other factor follows in closed form.
    """
    at, spread = AT[name], model.priors.spread[name]
    seen = np.flatnonzero(model.priors.scale[at] > 0.0)
    if spread == 0.0 or not len(seen):
        return 1.0
    scale = model.priors.scale[at][seen]
    rows = np.searchsorted(model.free, at.start + seen)
    covariance = solution.covariance[np.ix_(rows, rows)] / np.outer(scale, scale)
    posterior = np.linalg.inv(covariance)
    mean = (point.state.shared[at] - model.priors.mean[at])[seen] / scale
    own = posterior - np.eye(len(seen)) / point.groups[name] ** 2
    values, vectors = np.linalg.eigh(own)
    values = np.maximum(values, 0.0)
    pull = vectors.T @ posterior @ mean
    x = np.linspace(-3.0 * spread, math.log(UNKNOWNS[name].most), GRID)
    square = np.exp(2.0 * x)[:, None]
    likely = 0.5 * np.sum(square * pull**2 / (1.0 + square * values), axis=1)
    likely -= 0.5 * np.sum(np.log1p(square * values), axis=1) + 0.5 * (x / spread) ** 2
    if not expected:
        return float(np.exp(x[np.argmax(likely)]))
    odds = np.exp(likely - likely.max())
    return math.sqrt(float(odds @ square[:, 0] / np.sum(odds)))
