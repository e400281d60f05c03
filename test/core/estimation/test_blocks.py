"""Both kinds of block keep the same promises, at the optimum of a real solve."""

from dataclasses import replace

import numpy as np
import pytest
from slope_turns import EAST, KNOWN, LEVEL, window_on

from magcal_ros.core.estimation import parameters as p
from magcal_ros.core.estimation.gyro_attitude import GyroBlock
from magcal_ros.core.methods.maximum_likelihood.fit import solve

SHARED = np.arange(p.ROLL, p.COUNT)


def full_step(free, move):
    step = np.zeros(p.COUNT)
    step[free] = move
    return step


def followed(block, free, move):
    local = block.equations(free).reduced(0.0).follow(move)
    return block.moved(full_step(free, move), local)


@pytest.fixture(params=[False, True], ids=["free", "gyro"])
def block(request):
    rng = np.random.default_rng(1)
    block = solve(window_on(EAST, rng, gyro=request.param), KNOWN).choice.fit.block
    assert isinstance(block, GyroBlock) is request.param
    return block


def test_gradient_is_that_of_half_the_cost_with_attitudes_following(block):
    free = np.concatenate([block.own, SHARED])
    for _ in range(3):
        block = followed(block, free, np.zeros(len(free)))
    gradient = block.equations(free).reduced(0.0).gradient
    for index in (0, 5, len(free) - 1):
        move = 1e-5 * np.eye(len(free))[index]
        rise = followed(block, free, move).cost - followed(block, free, -move).cost
        assert -gradient[index] == pytest.approx(rise / 4e-5, rel=0.01, abs=0.05)


def test_a_turn_that_is_placed_anew_comes_back_to_its_own_optimum(block):
    again = block.at(block.place.state.shared)
    free = np.concatenate([block.own, SHARED[:1]])
    for _ in range(4):
        reduced = again.equations(free).reduced(0.0)
        move = np.linalg.solve(reduced.information, reduced.gradient)
        move[len(block.own) :] = 0.0
        again = followed(again, free, move)
    assert again.cost == pytest.approx(block.cost, rel=0.02)


def test_a_block_under_its_own_weighting_stays_as_it_is(block):
    same = block.under(block)
    assert same.cost == pytest.approx(block.cost)
    louder = replace(
        block.weighting, noise=replace(block.weighting.noise, field=2 * block.weighting.noise.field)
    )
    assert block.under(block.weighted(louder)).cost < block.cost


def test_level_and_slope_start_from_their_own_axis():
    rng = np.random.default_rng(2)
    for slope, lean in ((LEVEL, 0.0), (EAST, np.sin(np.radians(10.0)))):
        block = solve(window_on(slope, rng), KNOWN).choice.fit.block
        axis = block.at(block.place.state.shared).place.state.shared.world_axis[:, 2]
        assert np.hypot(axis[0], axis[1]) == pytest.approx(lean, abs=0.01)
