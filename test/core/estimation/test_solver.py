"""The solver: steps that never raise the cost, turns counted alike, and a status that is true."""

from dataclasses import replace

import numpy as np
import pytest
from slope_turns import EAST, KNOWN, LEVEL, window_on

from magcal_ros.core.calibration.figure import Figure
from magcal_ros.core.estimation import solver
from magcal_ros.core.estimation.schedule import TRIMMING, Damping, Limit
from magcal_ros.core.estimation.solver import Fit, Status, refined, settled, steps_of
from magcal_ros.core.estimation.weighting import Weights
from magcal_ros.core.methods.maximum_likelihood import fit as find
from magcal_ros.core.methods.maximum_likelihood.fit import solve


@pytest.fixture(scope="module", params=[False, True], ids=["free", "gyro"])
def optimum(request):
    window = window_on(EAST, np.random.default_rng(1), gyro=request.param)
    return solve(window, KNOWN).choice.fit


def displaced(fit, size, rng):
    step = np.zeros(18)
    step[fit.free] = size * rng.standard_normal(len(fit.free))
    block = fit.block
    local = block.equations(fit.free).reduced(0.0).local * 0.0
    return fit.with_blocks([block.moved(step, local)])


def test_a_step_never_raises_the_cost(free_block, prior, rng):
    fit = Fit((free_block,), prior)
    local = 0.1 * rng.standard_normal((len(free_block.samples), 3 if free_block.leans else 1))
    start = fit.with_blocks([free_block.moved(0.1 * rng.standard_normal(18), local)])
    nothing = np.zeros(start.equations.size)
    for _ in range(5):
        taken = steps_of(start, Limit(1, 0.0), 1e-4, nothing).fit
        assert taken.cost < start.cost + 1e-6
        start = taken


def test_a_displaced_fit_comes_back(optimum, rng):
    back = settled(displaced(optimum, 0.01, rng))
    assert back.convergence.status is Status.CONVERGED
    np.testing.assert_allclose(back.shared.hard_iron, optimum.shared.hard_iron, atol=1e-6)
    assert back.cost == pytest.approx(optimum.cost, rel=1e-9)


def test_an_optimum_has_no_slope_left(optimum):
    step = np.linalg.solve(optimum.information, optimum.gradient)
    assert optimum.gradient @ step < 1e-8
    assert optimum.convergence.status is Status.CONVERGED
    assert optimum.convergence.decrease < 1e-8


def test_too_few_steps_are_said(optimum, rng):
    early = settled(displaced(optimum, 0.05, rng), Limit(1, 1e-12))
    assert early.convergence.status is Status.OUT_OF_ROUNDS
    assert early.convergence.decrease > 1e-4
    assert early.convergence.iterations == optimum.convergence.iterations + 1


def test_a_step_that_cannot_be_taken_is_a_stall(optimum, rng):
    away = displaced(optimum, 0.05, rng)
    no_step = Damping(longest_step=0.0)
    stopped = steps_of(away, Limit(3, 1e-12), rule=no_step).fit
    assert stopped.convergence.status is Status.STALLED
    assert stopped.cost == away.cost


def test_too_few_rounds_are_said(optimum, rng):
    hurried = replace(TRIMMING, rounds=1, fewest=2)
    assert (
        refined(displaced(optimum, 0.05, rng), hurried).convergence.status is Status.OUT_OF_ROUNDS
    )


def test_an_estimate_says_converged_only_where_it_is_true(monkeypatch):
    window = window_on(LEVEL, np.random.default_rng(3))
    whole = find(window, KNOWN)
    assert whole.message.startswith("converged on ")
    assert whole.figures[Figure.NOT_CONVERGED] == 0.0
    original = solver.refined
    monkeypatch.setattr(
        "magcal_ros.core.estimation.selection.refined",
        lambda fit, schedule: original(fit, replace(schedule, rounds=1, fewest=2)),
    )
    cut = find(window, KNOWN)
    assert cut.message.startswith("out of rounds on ")
    assert cut.figures[Figure.NOT_CONVERGED] == 1.0


def test_turns_are_counted_per_independent_sample(optimum):
    block = optimum.block
    slow = replace(block.weighting, inefficiency=2.0 * block.weighting.inefficiency)
    half = optimum.with_blocks([block.weighted(slow)])
    data, believed = optimum.information, optimum.prior_information
    assert np.trace(half.information - believed) < 0.8 * np.trace(data - believed)


def test_two_copies_of_a_turn_say_twice_as_much(optimum):
    twice = optimum.with_blocks([optimum.block, optimum.block])
    data = optimum.information - optimum.prior_information
    np.testing.assert_allclose(
        twice.information - twice.prior_information, 2.0 * data, rtol=1e-6, atol=1e-3
    )
    step = settled(twice, Limit(1, 1e-12))
    assert step.convergence.decrease < 1.0


def test_a_sample_left_out_says_nothing(optimum):
    sample = optimum.block.weighting.weights.sample.copy()
    sample[::2] = 0.0
    n = len(sample)
    half = optimum.reweighted([Weights(np.ones(n), np.ones(n), sample)])
    ratio = np.trace(half.information - half.prior_information) / np.trace(
        optimum.information - optimum.prior_information
    )
    assert ratio == pytest.approx(0.5, abs=0.1)
