"""Each sample's attitude when the globals are given."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from magcal_ros.core.arrays import FloatArray
from magcal_ros.core.attitude import body_from_enu
from magcal_ros.core.methods.maximum_likelihood.linearise import (
    Problem,
    Weights,
    best_local_step,
    cost,
)
from magcal_ros.core.methods.maximum_likelihood.model import Samples, State
from magcal_ros.core.methods.maximum_likelihood.parameters import COUNT, Globals


def attitudes_from_vectors(shared: Globals, samples: Samples) -> FloatArray:
    """Return the attitudes that up and corrected field show, shape (n, 3, 3)."""
    matrix = np.linalg.inv(shared.distortion(samples.mounting))
    field = (samples.field - shared.hard_iron) @ matrix.T
    body = body_from_enu(samples.up, field)
    return np.asarray(shared.body_axis.T @ body @ shared.world_axis)


def follow(shared: Globals, problem: Problem, samples: Samples, steps: int = 3) -> State:
    """Return the state in which each sample of `samples` has its best attitude, globals held."""
    problem = replace(problem, samples=samples, weights=Weights.ones(len(samples)))
    state = State(shared, attitudes_from_vectors(shared, samples))
    state = state.upright() if problem.rigid else state
    before = cost(state, problem)
    for _ in range(steps):
        moved = state.moved(np.zeros(COUNT), best_local_step(state, problem))
        after = cost(moved, problem)
        if not after < before:
            break
        state, before = moved, after
    return state
