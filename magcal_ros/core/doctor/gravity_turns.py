"""How well gravity turns against the gyro, for each way the gyro's axes may lie."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from magcal_ros.core.geometry.arrays import FloatArray
from magcal_ros.core.geometry.rotations import skews
from magcal_ros.core.samples.stretch import Stretch


@dataclass(frozen=True)
class GravityTurnsTuning:
    """How changes of gravity are compared with the gyro's turns.

    Parameters
    ----------
    span : float
        Seconds over which turns are compared: shorter ones drown in noise, longer ones in bias.
    bias, scale : float
        Standard deviations of what the gyro may err by, rad/s and relative.
    floor : float
        Radians of noise that is believed at least.
    rounds : int
        Of robust weights.
    """

    span: float = 0.6
    bias: float = math.radians(6.0)
    scale: float = 0.2
    floor: float = math.radians(0.5)
    rounds: int = 3


TUNING = GravityTurnsTuning()


def gravity_misfit(stretch: Stretch, ways: FloatArray) -> FloatArray:
    """Return how much worse than the best each way explains gravity's changes, chi-square (k,).

    A body that turns by a small angle d sees up change by -d x up.

    Parameters
    ----------
    stretch : Stretch
        The movement.
    ways : ndarray, shape (k, 3, 3)
        Rows are the gyro's axes in the accelerometer's.
    """
    seconds = np.concatenate([[0.0], np.cumsum(stretch.seconds)])
    angle = np.concatenate([np.zeros((1, 3)), np.cumsum(stretch.turn, axis=0)])
    last = np.searchsorted(seconds, seconds + TUNING.span)
    first = np.flatnonzero(last < len(seconds))
    last = last[first]
    if len(first) < 4:
        return np.zeros(len(ways))
    size = np.linalg.norm(stretch.up, axis=1, keepdims=True)
    up = stretch.up / np.maximum(size, 1e-9)
    middle = skews(0.5 * (up[last] + up[first]))
    seen = up[last] - up[first]
    turned = (angle[last] - angle[first]) @ ways
    # seen = middle x (turned (1 + scale) - bias seconds)
    count, n = len(ways), len(first)
    moved = np.einsum("nij,knj->kni", middle, turned)
    drift = -middle * (seconds[last] - seconds[first])[:, None, None]
    design = np.concatenate([np.broadcast_to(drift, (count, n, 3, 3)), moved[..., None]], axis=3)
    target = seen - moved
    prior = np.diag([TUNING.bias**-2.0] * 3 + [TUNING.scale**-2.0])
    repeated = max(float(np.mean(last - first)), 1.0)
    sigma, left = math.radians(5.0), np.zeros((count, n))
    for _ in range(TUNING.rounds):
        weight = 7.0 / (4.0 + left / sigma**2) / sigma**2 / repeated
        rows = design * weight[..., None, None]
        normal = np.einsum("knia,knib->kab", rows, design) + prior
        found = np.linalg.solve(normal, np.einsum("knia,kni->ka", rows, target)[..., None])[..., 0]
        left = np.sum((target - np.einsum("knia,ka->kni", design, found)) ** 2, axis=2)
        typical = np.sqrt(np.median(left, axis=1) / 2.37)
        cost = 7.0 * np.log1p(left / 4.0 / sigma**2).sum(axis=1) / repeated
        sigma = max(float(typical[np.argmin(cost)]), TUNING.floor)
    cost = 7.0 * np.log1p(left / 4.0 / sigma**2).sum(axis=1) / repeated
    cost = cost + np.einsum("ka,ab,kb->k", found, prior, found)
    return np.asarray(cost - cost.min())
