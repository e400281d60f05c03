from dataclasses import replace

import numpy as np
import pytest
from slope_turns import EAST, KNOWN, LEVEL, window_on

from magcal_ros.core.methods.maximum_likelihood import parameters as p
from magcal_ros.core.methods.maximum_likelihood.driver import solve
from magcal_ros.core.several.blocks import block_from

SHARED = np.arange(p.ROLL, p.COUNT)


@pytest.fixture(params=[False, True], ids=["sampled", "carried"])
def block(request):
    rng = np.random.default_rng(1)
    solved = solve(window_on(EAST, rng, gyro=request.param), KNOWN)
    assert (solved.carried is not None) is request.param
    return block_from(solved.solution, solved.carried)


def test_gradient_is_that_of_half_the_cost_with_attitudes_following(block):
    free = np.concatenate([block.own, SHARED])
    for _ in range(3):
        block = block.equations(free).follow(np.zeros(len(free)))
    equations = block.equations(free)
    for index in (0, 5, len(free) - 1):
        move = 1e-5 * np.eye(len(free))[index]
        rise = equations.follow(move).cost - equations.follow(-move).cost
        assert -equations.gradient[index] == pytest.approx(rise / 4e-5, rel=0.01, abs=0.05)


def test_a_turn_that_is_placed_anew_comes_back_to_its_own_optimum(block):
    again = block.at(block.state.shared)
    free = np.concatenate([block.own, SHARED[:1]])
    for _ in range(4):
        equations = again.equations(free)
        move = np.linalg.solve(equations.information, equations.gradient)
        move[len(block.own) :] = 0.0
        again = equations.follow(move)
    assert again.cost == pytest.approx(block.cost, rel=0.02)


def test_information_is_counted_per_independent_sample(block):
    whole = block.equations(SHARED).information
    if hasattr(block, "task"):
        problem = replace(block.problem, kappa=2.0 * block.problem.kappa)
        other = replace(block, task=replace(block.task, problem=problem))
    else:
        other = replace(block, problem=replace(block.problem, kappa=2.0 * block.problem.kappa))
    assert np.trace(other.equations(SHARED).information) < 0.8 * np.trace(whole)


def test_level_and_slope_start_from_their_own_axis():
    rng = np.random.default_rng(2)
    for slope, lean in ((LEVEL, 0.0), (EAST, np.sin(np.radians(10.0)))):
        solved = solve(window_on(slope, rng), KNOWN)
        placed = block_from(solved.solution, None).at(solved.solution.state.shared)
        axis = placed.state.shared.world_axis[:, 2]
        assert np.hypot(axis[0], axis[1]) == pytest.approx(lean, abs=0.01)
