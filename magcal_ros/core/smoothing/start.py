"""Where the smoother starts: the field as the gyro turns it, which is linear in what is sought."""

from __future__ import annotations

import math

import numpy as np

from magcal_ros.core.geometry.arrays import FloatArray
from magcal_ros.core.smoothing.drive_model import (
    DOWN_FIELD,
    GYRO_BIAS,
    IRON,
    LEVEL_FIELD,
    SHARED,
    Unknowns,
    turned_into,
)
from magcal_ros.core.smoothing.drive_prior import SharedPrior
from magcal_ros.core.smoothing.nodes import Nodes
from magcal_ros.core.smoothing.tuning import TUNING, SmootherTuning

BIASES: FloatArray = np.radians(
    [0.0, -0.1, 0.1, -0.2, 0.2, -0.5, 0.5, -1.0, 1.0, -2.0, 2.0, -3.5, 3.5, -5.0, 5.0]
)
"""rad/s that a gyro may be off by, at rest as well."""


def linear_start(
    nodes: Nodes, prior: SharedPrior, tuning: SmootherTuning = TUNING
) -> tuple[Unknowns, SharedPrior]:
    """Fit field and hard iron in the gyro's axes by IRLS, for several biases; the best is taken.

    Returns
    -------
    Unknowns, SharedPrior
        The prior's hard iron is the start's.
    """
    best, chosen, bias = math.inf, np.zeros(6), 0.0
    clock = np.cumsum(nodes.seconds)
    for trial in BIASES:
        found, misfit = _fitted(nodes, nodes.heading - trial * clock, prior, tuning)
        if misfit < best:
            best, chosen, bias = misfit, found, float(trial)
    shared = prior.mean.copy()
    shared[IRON] = chosen[3:]
    shared[LEVEL_FIELD] = max(math.hypot(chosen[0], chosen[1]), 0.5 * prior.mean[LEVEL_FIELD])
    shared[GYRO_BIAS] = bias
    first = math.atan2(chosen[0], chosen[1])
    yaw = nodes.heading - bias * clock + first
    shared[DOWN_FIELD] = prior.mean[DOWN_FIELD]
    assert len(shared) == SHARED
    return Unknowns(shared, yaw, np.zeros((len(nodes), 3))), prior.about(chosen[3:])


def _fitted(
    nodes: Nodes, heading: FloatArray, prior: SharedPrior, tuning: SmootherTuning
) -> tuple[FloatArray, float]:
    """Return field in the gyro's axes and hard iron (6,), and the median misfit, microtesla."""
    n = len(nodes)
    design = np.concatenate(
        [nodes.axes @ turned_into(heading), np.broadcast_to(np.eye(3), (n, 3, 3))], axis=2
    )
    expected = np.array([0.0, 0.0, -prior.mean[DOWN_FIELD], 0.0, 0.0, 0.0])
    known = np.array([1e-6, 1e-6, tuning.start_field**-2.0, *(prior.sigma[IRON] ** -2.0)])
    rows, read = design.reshape(-1, 6), nodes.field.ravel()
    weight, found, misfit = np.ones(n), expected, math.inf
    for _ in range(tuning.start_rounds):
        weighted = rows * np.repeat(weight, 3)[:, None]
        normal = weighted.T @ rows + n * np.diag(known) * 0.01
        found = np.linalg.solve(normal, weighted.T @ read + n * 0.01 * known * expected)
        size = np.linalg.norm((read - rows @ found).reshape(n, 3), axis=1)
        misfit = float(np.median(size))
        weight = 1.0 / (1.0 + (size / (2.0 * misfit + 1e-9)) ** 2)
    return found, misfit
