"""The places that a drive passed: streets bend the field there, each time in the same way."""

from __future__ import annotations

import math

import numpy as np

from magcal_ros.core.geometry.arrays import FloatArray
from magcal_ros.core.smoothing.descent import Smoothed
from magcal_ros.core.smoothing.nodes import Means


def new_metres(smoothed: Smoothed) -> float:
    """Return the length of road without what was driven again; cells of one reach are counted."""
    reach = smoothed.problem.tuning.reach
    cells = _way(smoothed) // reach
    return reach * len(np.unique(cells.astype(int), axis=0))


def _way(smoothed: Smoothed) -> FloatArray:
    """Return the places of the nodes, reckoned from yaw and metres: east and north, (n, 2)."""
    return np.cumsum(smoothed.problem.nodes.metres[:, None] * _ahead(smoothed), axis=0)


def _ahead(smoothed: Smoothed) -> FloatArray:
    """Return where the nodes look, east and north, unit, shape (n, 2)."""
    return np.column_stack([np.cos(smoothed.unknowns.yaw), np.sin(smoothed.unknowns.yaw)])


def iron_by_streets(smoothed: Smoothed) -> float:
    """Return what streets let pass for hard iron, microtesla per level axis, one sigma.

    Seen from the world, hard iron turns with the yaw and the field of streets belongs to places:
    `exp(i psi) h + d(p)`. With the covariance of d between places, `exp(-distance / reach)` and
    small iron beside it, generalised least squares leave of h the variance `1 / (x^H K^-1 x)`,
    x = exp(i psi), here by its real and imaginary parts. Circles in one place leave little of the
    street, whose mean is no hard iron, and laps repeat what the first one told. Where the iron
    is not there yet, x is zero: such places only tell what their streets are.

    In a small place the calibration takes the bend for its own, so what was found of the street's
    size counts by its witnesses, two reaches of new road each, beside the usual size.
    """
    tuning, sizes = smoothed.problem.tuning, smoothed.problem.sizes
    witnesses = new_metres(smoothed) / (2.0 * tuning.reach)
    found = (tuning.street * sizes.street) ** 2
    street = (witnesses * found + tuning.usual_witnesses * tuning.street**2) / (
        witnesses + tuning.usual_witnesses
    )
    small = (tuning.noise * max(sizes.noise, 1.0)) ** 2
    count = len(smoothed.unknowns.yaw)
    joined = math.ceil(count / tuning.most_places)
    means = Means(np.arange(0, count, joined), count)
    has_iron = smoothed.problem.nodes.has_iron[:, None]
    way, ahead = means.of(_way(smoothed)), means.of(has_iron * _ahead(smoothed))
    apart = np.linalg.norm(way[:, None] - way, axis=2)
    covariance = street * np.exp(-apart / tuning.reach)
    covariance += small * np.exp(-apart / tuning.small_reach)
    covariance += tuning.own_noise**2 / joined * np.eye(len(way))
    return 1.0 / math.sqrt(float(np.sum(ahead * np.linalg.solve(covariance, ahead))))
