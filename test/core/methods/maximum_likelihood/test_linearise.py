from dataclasses import replace

import numpy as np
import pytest

from magcal_ros.core.methods.maximum_likelihood.linearise import (
    cost,
    inverse_blocks,
    linearise,
    take_step,
)


def local_numbers(problem):
    return 1 if problem.rigid else 3


@pytest.mark.parametrize("rigid", [False, True])
def test_gradient_is_that_of_half_the_cost(state, problem, rigid):
    problem = replace(problem, rigid=rigid)
    state = state.upright() if rigid else state
    lin = linearise(state, problem)
    still = np.zeros((len(problem.samples), local_numbers(problem)))
    for index in range(18):
        step = np.zeros(18)
        step[index] = 1e-6
        rise = cost(state.moved(step, still), problem) - cost(state.moved(-step, still), problem)
        assert -lin.gradient[index] == pytest.approx(rise / 4e-6, rel=1e-4, abs=1e-3)


@pytest.mark.parametrize("rigid", [False, True])
def test_local_gradient_is_that_of_half_the_cost(state, problem, rigid):
    problem = replace(problem, rigid=rigid)
    state = state.upright() if rigid else state
    lin = linearise(state, problem)
    chosen = int(np.flatnonzero(problem.weights.sample)[0])
    for column in range(local_numbers(problem)):
        local = np.zeros((len(problem.samples), local_numbers(problem)))
        local[chosen, column] = 1e-6
        ahead = cost(state.moved(np.zeros(18), local), problem)
        behind = cost(state.moved(np.zeros(18), -local), problem)
        slope = (ahead - behind) / 4e-6
        assert -lin.local_gradient[chosen, column] == pytest.approx(slope, rel=1e-4, abs=1e-3)


def test_elimination_equals_the_dense_solution(state, problem):
    lin = linearise(state, problem)
    n, g = len(problem.samples), len(problem.prior.free)
    dense = np.zeros((g + 3 * n, g + 3 * n))
    dense[:g, :g] = lin.information
    for i in np.flatnonzero(problem.weights.sample == 0.0):
        dense[g + 3 * i : g + 3 * i + 3, g + 3 * i : g + 3 * i + 3] = np.eye(3)
    for i in np.flatnonzero(problem.weights.sample):
        rows = slice(g + 3 * i, g + 3 * i + 3)
        dense[rows, rows] = lin.local_information[i]
        dense[rows, :g] = lin.coupling[i]
        dense[:g, rows] = lin.coupling[i].T
    expected = np.linalg.inv(np.linalg.inv(dense)[:g, :g])
    np.testing.assert_allclose(lin.reduced_information, expected, rtol=1e-6, atol=1e-6)


def test_a_step_never_raises_the_cost(state, problem, rng):
    start = state.moved(0.1 * rng.standard_normal(18), 0.1 * rng.standard_normal((40, 3)))
    step = take_step(linearise(start, problem), problem, 1e-4)
    assert step.accepted
    assert step.fall > 0.0


def test_blocks_are_inverted(rng):
    half = rng.standard_normal((6, 3, 3))
    blocks = half @ np.swapaxes(half, 1, 2) + np.eye(3)
    expected = np.broadcast_to(np.eye(3), (6, 3, 3))
    np.testing.assert_allclose(inverse_blocks(blocks) @ blocks, expected, atol=1e-9)
    np.testing.assert_allclose(inverse_blocks(blocks[:, :1, :1]) * blocks[:, :1, :1], 1.0)
