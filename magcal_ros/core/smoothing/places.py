"""The places that a drive passed: streets bend the field there, each time in the same way."""

from __future__ import annotations

import math

import numpy as np

from magcal_ros.core.geometry.arrays import ComplexArray
from magcal_ros.core.smoothing.descent import Smoothed


def new_metres(smoothed: Smoothed) -> float:
    """Return the length of road without what was driven again; cells of one reach are counted."""
    reach = smoothed.problem.tuning.reach
    way = _way(smoothed)
    cells = np.column_stack([way.real, way.imag]) // reach
    return reach * len(np.unique(cells.astype(int), axis=0))


def _way(smoothed: Smoothed) -> ComplexArray:
    """Return the places of the nodes, reckoned from yaw and metres: east + i north, metres."""
    steps = smoothed.problem.nodes.metres * np.exp(1j * smoothed.unknowns.yaw)
    return np.asarray(np.cumsum(steps), dtype=np.complex128)


def iron_by_streets(smoothed: Smoothed) -> float:
    """Return what streets let pass for hard iron, microtesla per level axis, one sigma.

    Seen from the world, hard iron turns with the yaw and the field of streets belongs to places:
    `exp(i psi) h + d(p)`. With the covariance of d between places, `exp(-distance / reach)` and
    small iron beside it, generalised least squares leave of h the variance `1 / (x^H K^-1 x)`,
    x = exp(i psi). Circles in one place leave little of the street, whose mean is no hard iron,
    and laps repeat what the first one told.

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
    joined = math.ceil(len(smoothed.unknowns.yaw) / tuning.most_places)
    way, turned = (
        _block_means(values, joined)
        for values in (_way(smoothed), np.exp(1j * smoothed.unknowns.yaw))
    )
    apart = np.abs(way[:, None] - way)
    covariance = street * np.exp(-apart / tuning.reach)
    covariance += small * np.exp(-apart / tuning.small_reach)
    covariance += tuning.own_noise**2 / joined * np.eye(len(way))
    known = float(np.real(turned.conj() @ np.linalg.solve(covariance, turned)))
    return 1.0 / math.sqrt(known)


def _block_means(values: ComplexArray, size: int) -> ComplexArray:
    """Return the means of so many values each; the last may be of fewer."""
    first = np.arange(0, len(values), size)
    counts = np.diff(np.append(first, len(values)))
    return np.asarray(np.add.reduceat(values, first) / counts)
