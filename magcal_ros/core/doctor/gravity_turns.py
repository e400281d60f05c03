"""How well gravity turns against the gyro, for each way the gyro's axes may lie."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from magcal_ros.core.geometry.arrays import FloatArray
from magcal_ros.core.geometry.attitude import STANDARD_GRAVITY
from magcal_ros.core.geometry.rotations import skews
from magcal_ros.core.samples.stretch import Stretch


@dataclass(frozen=True)
class GravityTurnsTuning:
    """How changes of gravity are compared with the gyro's turns."""

    span: float = 0.6
    """Seconds over which turns are compared: shorter ones drown in noise, longer ones in bias."""
    bias: float = math.radians(6.0)
    scale: float = 0.2
    """Standard deviations of what the gyro may err by, rad/s and relative."""
    lever: float = 1.0
    """Metres, standard deviation of how far the sensor is from the point about which it turns: a
    hand swings it around an elbow, a vehicle turns about its rear axle."""
    floor: float = math.radians(0.5)
    """Radians of noise that is believed at least."""
    rounds: int = 3
    """Of robust weights."""


TUNING = GravityTurnsTuning()


def gravity_misfit(stretch: Stretch, ways: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Weigh how each way explains gravity's changes.

    Return chi-square (k,) above the best's, and the typical residual, radians (k,).

    A body that turns by a small angle d sees up change by -d x up, and at a distance r from the
    point about which it turns it is accelerated by what r and the gyro tell. Other accelerations
    change the size of what is felt, which no turn does, and lean it as much.

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
        return np.zeros(len(ways)), np.zeros(len(ways))
    size = np.linalg.norm(stretch.up, axis=1, keepdims=True)
    uneven = float(np.median(np.abs(size[last] - size[first]))) / 0.6745
    up = stretch.up / np.maximum(size, 1e-9)
    middle = skews(0.5 * (up[last] + up[first]))
    seen = up[last] - up[first]
    turned = (angle[last] - angle[first]) @ ways
    # seen = middle x (turned (1 + scale) - bias seconds) + swung r
    count, n = len(ways), len(first)
    moved = np.einsum("nij,knj->kni", middle, turned)
    drift = -middle * (seconds[last] - seconds[first])[:, None, None]
    swung = _accelerated(stretch.rate @ ways, seconds)
    swung = -middle @ middle @ (swung[:, last] - swung[:, first])
    drifted = np.broadcast_to(drift, (count, n, 3, 3))
    design = np.concatenate([drifted, moved[..., None], swung], axis=3)
    target = seen - moved
    sizes = np.array([TUNING.bias] * 3 + [TUNING.scale] + [TUNING.lever] * 3)
    prior = np.diag(sizes**-2.0)
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
        sigma = max(float(typical[np.argmin(cost)]), uneven, TUNING.floor)
    cost = 7.0 * np.log1p(left / 4.0 / sigma**2).sum(axis=1) / repeated
    cost = cost + np.einsum("ka,ab,kb->k", found, prior, found)
    return np.asarray(cost - cost.min()), np.asarray(np.maximum(typical, TUNING.floor))


def _accelerated(rate: FloatArray, seconds: FloatArray) -> FloatArray:
    """Return how a metre of lever arm is accelerated by rates (k, n, 3), in g, (k, n, 3, 3)."""
    turns, gains = (
        skews(values.reshape(-1, 3)).reshape(*values.shape, 3)
        for values in (rate, np.gradient(rate, seconds, axis=1))
    )
    return np.asarray((gains + turns @ turns) / STANDARD_GRAVITY)
