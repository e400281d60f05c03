"""The normal equations of several turns: slopes by differences, promises kept."""

from dataclasses import replace

import numpy as np
import pytest
from slope_turns import EAST, KNOWN, LEVEL, window_on

from magcal_ros.core.estimation import parameters as p
from magcal_ros.core.estimation.solver import Fit
from magcal_ros.core.methods.maximum_likelihood.fit import solve


@pytest.fixture(scope="module", params=[False, True], ids=["free", "gyro"])
def pair(request):
    """Return a fit of two turns that share their numbers, a little beside its optimum."""
    rng = np.random.default_rng(1)
    fits = [solve(window_on(s, rng, gyro=request.param), KNOWN).choice.fit for s in (LEVEL, EAST)]
    shared = fits[0].shared
    blocks = [fit.block.at(shared) for fit in fits]
    return moved(Fit(tuple(blocks), fits[0].prior), 2e-3 * rng.standard_normal(p.COUNT))


def moved(fit, change):
    """Return a fit whose shared numbers took a step, its turns' own numbers following twice."""
    step = np.zeros(p.COUNT)
    step[fit.free] = change[fit.free]
    blocks = []
    for block in fit.blocks:
        free = np.concatenate([block.own, fit.free])
        for take in (step, np.zeros(p.COUNT), np.zeros(p.COUNT)):
            reduced = block.equations(free).reduced(0.0)
            own = slice(0, len(block.own))
            follow = take[free]
            among, across = reduced.information[own, own], reduced.information[own, own.stop :]
            follow[own] = np.linalg.pinv(among) @ (
                reduced.gradient[own] - across @ follow[own.stop :]
            )
            full = np.zeros(p.COUNT)
            full[free] = follow
            block = block.moved(full, reduced.follow(follow))
        blocks.append(block)
    return fit.with_blocks(blocks)


def test_the_shared_gradient_is_the_slope_of_half_the_cost(pair):
    gradient = sum(
        (pair.equations.own_gradient(k) for k in range(2)),
        pair.prior.information[pair.free] * pair.prior.deviation(pair.shared)[pair.free],
    )
    assert not any(block.leans for block in pair.blocks)
    for index, parameter in enumerate(pair.free):
        step = 1e-5 * np.eye(p.COUNT)[parameter]
        rise = moved(pair, step).cost - moved(pair, -step).cost
        assert -gradient[index] == pytest.approx(rise / 4e-5, rel=0.02, abs=0.5)


def test_a_move_keeps_what_it_promises(pair):
    nothing = np.zeros(pair.equations.size)
    move = pair.equations.move(0.0, nothing)
    fall = pair.cost - pair.with_blocks(move.blocks).cost
    assert move.promised > 1.0
    assert fall == pytest.approx(move.promised, rel=0.1)


def test_damping_shortens_the_move(pair):
    nothing = np.zeros(pair.equations.size)
    sizes = [pair.equations.move(damping, nothing).size for damping in (0.0, 1e-2, 1.0, 100.0)]
    assert sizes == sorted(sizes, reverse=True)
    assert sizes[-1] < 0.1 * sizes[0]


def test_a_turn_of_fewer_independent_samples_says_less_and_the_others_the_same(pair):
    block = pair.blocks[0]
    halved = replace(block.weighting, inefficiency=2.0 * block.weighting.inefficiency)
    other = pair.with_blocks([block.weighted(halved), pair.blocks[1]])
    one, two = pair.equations.turn_information, other.equations.turn_information
    # A gyro's errors keep their prior, and hold their share of what is left.
    assert np.trace(one[0]) / 2.0 <= np.trace(two[0]) * (1.0 + 1e-9)
    assert np.trace(two[0]) < 0.6 * np.trace(one[0])
    np.testing.assert_allclose(two[1], one[1])
