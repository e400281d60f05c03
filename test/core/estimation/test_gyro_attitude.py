"""The equations of gyro-propagated attitudes, against differences of the cost."""

from dataclasses import replace

import numpy as np
import pytest
from slope_turns import EAST, KNOWN, window_on

from magcal_ros.core.estimation import parameters as p
from magcal_ros.core.estimation.averaging import prepare
from magcal_ros.core.estimation.effects import Effect, effects_of_rate
from magcal_ros.core.estimation.free_attitude import FreeBlock
from magcal_ros.core.estimation.gyro_attitude import DRIFT, GyroBlock
from magcal_ros.core.estimation.gyro_path import gyro_path
from magcal_ros.core.estimation.weighting import Noise, Weighting, Weights
from magcal_ros.core.methods.maximum_likelihood.fit import solve

SHARED = np.arange(p.ROLL, p.COUNT)
STEP = 1e-6


@pytest.fixture(scope="module")
def window():
    return window_on(EAST, np.random.default_rng(1), gyro=True, samples=120)


@pytest.fixture(scope="module", params=[False, True], ids=["plain", "with effects"])
def block(request, window):
    """A block away from its optimum, with errors of every kind."""
    rng = np.random.default_rng(2)
    shared = solve(window, KNOWN).choice.fit.shared
    samples = prepare(window.field, window.specific_force, KNOWN, 800).averaged
    n = len(samples)
    weights = Weights(rng.uniform(0.3, 1.5, n), np.ones(n), (rng.random(n) > 0.2).astype(float))
    weighting = Weighting(Noise(0.02, 0.02, 0.1), weights, 1.7)
    path = gyro_path(window, np.arange(n))
    if request.param:
        raw = samples.field - shared.hard_iron
        effects = effects_of_rate(path.pace, raw, shared.distortion(KNOWN.mounting.matrix))
        path = path.with_acceleration().with_effects(effects)
    state = FreeBlock.seated_at(shared, samples, weighting).place.state
    started = GyroBlock.started(state, samples, weighting, path, DRIFT.first)
    away = 1e-3 * rng.standard_normal(p.COUNT)
    away[:4] = 0.0
    return started.moved(away, 1e-4 * rng.standard_normal(path.size))


def slope(block, step, local):
    return (block.moved(step, local).cost - block.moved(-step, -local).cost) / (4.0 * STEP)


def test_gradient_by_the_shared_numbers(block):
    equations = block.equations(SHARED)
    for row, index in enumerate(SHARED):
        step = np.zeros(p.COUNT)
        step[index] = STEP
        rise = slope(block, step, np.zeros(block.path.size))
        assert -equations.gradient[row] == pytest.approx(rise, rel=1e-3, abs=1e-2)


def test_gradient_by_the_errors(block):
    gradient = block.equations(SHARED).gradient[len(SHARED) :]
    for index in range(block.path.size):
        local = np.zeros(block.path.size)
        local[index] = STEP
        rise = slope(block, np.zeros(p.COUNT), local)
        # Errors turn attitudes in the axes of the start; those that are there bend the slope.
        assert -gradient[index] == pytest.approx(rise, rel=2e-2, abs=1.0)


def test_elimination_equals_the_dense_solution(block):
    equations = block.equations(SHARED)
    f = len(SHARED)
    dense = equations.information + np.diag([1.0] * f + [0.0] * block.path.size)
    whole = np.linalg.solve(dense, equations.gradient)
    reduced = equations.reduced(0.0)
    move = np.linalg.solve(reduced.information + np.eye(f), reduced.gradient)
    np.testing.assert_allclose(move, whole[:f], rtol=1e-5, atol=1e-9)
    np.testing.assert_allclose(reduced.follow(move), whole[f:], rtol=1e-4, atol=1e-8)


def test_the_drift_grows_where_the_knots_ask_for_it(block):
    believed = np.zeros(len(SHARED))
    local = np.zeros(block.path.size)
    local[block.path.drifts] = 0.05 * (-1.0) ** np.arange(3 * block.path.knots)
    wild = block.moved(np.zeros(p.COUNT), local)
    calm, loud = (b.equations(SHARED).renoised(2.0, believed, 1.0).drift for b in (block, wild))
    assert loud > calm
    assert DRIFT.smallest <= calm <= loud <= DRIFT.largest


def test_a_linear_acceleration_is_taken_off_the_up_vectors(window):
    pull = np.array([0.03, -0.02, 0.0])
    force = window.specific_force / 9.80665 + pull
    leaning = replace(window, specific_force=9.80665 * force)
    block = solve(leaning, KNOWN).choice.fit.block
    assert isinstance(block, GyroBlock)
    if Effect.PULL in block.path.effects:
        np.testing.assert_allclose(block.acceleration[:2], pull[:2], atol=0.01)
