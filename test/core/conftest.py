import math

import numpy as np
import pytest

from magcal_ros.core.estimation.free_attitude import FreeBlock
from magcal_ros.core.estimation.model import Evaluation, Samples, State, about_z, predict
from magcal_ros.core.estimation.parameters import ROLL, Globals
from magcal_ros.core.estimation.prior import Prior
from magcal_ros.core.estimation.weighting import Noise, Weighting, Weights
from magcal_ros.core.geometry import exp_rotation, exp_rotations, rotation_from_rpy, unit

COUNT = 40


@pytest.fixture
def rng():
    return np.random.default_rng(7)


@pytest.fixture
def state(rng):
    shared = Globals(
        exp_rotation(np.array([0.3, -0.2, 0.1])),
        exp_rotation(np.array([-0.1, 0.25, 0.4])),
        0.2,
        -0.3,
        np.array([0.6, -0.4, 0.5]),
        1.1,
        math.radians(55.0),
        0.02 * rng.standard_normal(6),
        0.35,
    )
    lean = np.column_stack([0.1 * rng.standard_normal((COUNT, 2)), np.zeros(COUNT)])
    return State(shared, exp_rotations(lean) @ about_z(np.linspace(0.0, 5.0, COUNT)))


@pytest.fixture
def samples(rng, state):
    mounting = np.array([0.8, 1.2, 0.9])[:, None] * rotation_from_rpy(0.1, 0.2, 0.7).T
    empty = Samples(np.zeros((COUNT, 3)), np.zeros((COUNT, 3)), mounting)
    truth = predict(state, empty)
    up = unit(truth.up @ state.shared.body_axis.T + 0.01 * rng.standard_normal((COUNT, 3)))
    field = -truth.field_residual + 0.01 * rng.standard_normal((COUNT, 3))
    return Samples(up, field, mounting)


@pytest.fixture
def prior():
    return Prior(np.arange(ROLL, 18), np.linspace(1.0, 50.0, 18), 1.0, math.radians(60.0))


@pytest.fixture
def weighting(rng):
    counted = (rng.random(COUNT) > 0.2).astype(float)
    weights = Weights(rng.uniform(0.3, 1.5, COUNT), rng.uniform(0.3, 1.5, COUNT), counted)
    return Weighting(Noise(0.01, 0.012, 0.08), weights)


@pytest.fixture(params=[True, False], ids=["wobbling", "rigid"])
def free_block(request, state, samples, weighting):
    state = state if request.param else state.upright()
    return FreeBlock(Evaluation(state, samples), weighting, leans=request.param)
