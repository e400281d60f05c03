"""The equations of a turn in which each sample has an attitude of its own, against differences."""

from dataclasses import replace

import numpy as np
import pytest

from magcal_ros.core.estimation.free_attitude import FreeBlock
from magcal_ros.core.estimation.free_equations import inverse_blocks
from magcal_ros.core.estimation.model import Evaluation
from magcal_ros.core.estimation.weighting import Noise

EVERY = np.arange(18)
STEP = 1e-6


def local_numbers(block):
    return 3 if block.leans else 1


def slope(block, step=None, local=None):
    step = np.zeros(18) if step is None else step
    local = np.zeros((len(block.samples), local_numbers(block))) if local is None else local
    return (block.moved(step, local).cost - block.moved(-step, -local).cost) / (4.0 * STEP)


def test_gradient_is_that_of_half_the_cost(free_block):
    gradient = free_block.equations(EVERY).system.gradient
    slopes = [slope(free_block, STEP * axis) for axis in np.eye(18)]
    np.testing.assert_allclose(-gradient, slopes, rtol=1e-4, atol=1e-3)


def test_local_gradient_is_that_of_half_the_cost(free_block):
    gradient = free_block.local.gradient
    chosen = int(np.flatnonzero(free_block.weighting.inliers)[0])
    for column in range(local_numbers(free_block)):
        local = np.zeros((len(free_block.samples), local_numbers(free_block)))
        local[chosen, column] = STEP
        rise = slope(free_block, local=local)
        assert -gradient[chosen, column] == pytest.approx(rise, rel=1e-4, abs=1e-3)


def test_elimination_equals_the_dense_solution(free_block):
    system = free_block.equations(EVERY).system
    n, f, size = len(free_block.samples), 18, local_numbers(free_block)
    dense, right = np.eye(f + size * n), np.zeros(f + size * n)
    dense[:f, :f] = system.information + np.eye(f)
    right[:f] = system.gradient
    for i in np.flatnonzero(free_block.weighting.inliers):
        rows = slice(f + size * i, f + size * (i + 1))
        dense[rows, rows] = system.local.information[i]
        dense[rows, :f], dense[:f, rows] = system.coupling[i], system.coupling[i].T
        right[rows] = system.local.gradient[i]
    expected = np.linalg.solve(dense, right)
    reduced = system.reduced(0.0)
    move = np.linalg.solve(reduced.information + np.eye(f), reduced.gradient)
    np.testing.assert_allclose(move, expected[:f], rtol=1e-6, atol=1e-9)
    counted = free_block.weighting.inliers
    follow = expected[f:].reshape(n, size)[counted]
    np.testing.assert_allclose(reduced.follow(move)[counted], follow, rtol=1e-6, atol=1e-9)


def test_a_sample_that_does_not_count_follows_its_measurements(free_block):
    out = free_block.weighting.weights.sample == 0.0
    local = free_block.equations(EVERY).reduced(0.0).follow(np.zeros(18))
    moved = free_block.moved(np.zeros(18), local)
    assert (moved.chi.data + moved.chi.wobble * free_block.leans)[out].sum() < (
        free_block.chi.data + free_block.chi.wobble * free_block.leans
    )[out].sum()


def test_the_noise_is_found_from_wrong_first_values(rng, state, samples, weighting):
    noise = Noise(0.02, 0.005, 0.05)
    block = FreeBlock(Evaluation(state, samples), replace(weighting, noise=noise))
    for _ in range(12):
        local = block.equations(EVERY).reduced(0.0).follow(np.zeros(18))
        block = block.moved(np.zeros(18), local)
        block = block.equations(EVERY).renoised(1.5, np.zeros(0), 1.0)
    # 40 samples, weighed by chance, with a noise of 0.01 in up and field and leans of 0.1.
    assert block.weighting.noise.up == pytest.approx(0.01, rel=0.5)
    assert block.weighting.noise.field == pytest.approx(0.01, rel=0.5)
    assert block.weighting.noise.wobble == pytest.approx(0.1, rel=0.4)


def test_other_samples_find_their_attitudes_again(free_block):
    start = free_block.following(free_block.samples, free_block.weighting.noise, steps=0)
    found = free_block.following(free_block.samples, free_block.weighting.noise)
    assert found.leans is free_block.leans
    assert found.cost <= start.cost
    assert np.abs(found.local.best_step).max() < 0.01


def test_blocks_are_inverted(rng):
    half = rng.standard_normal((6, 3, 3))
    blocks = half @ np.swapaxes(half, 1, 2) + np.eye(3)
    expected = np.broadcast_to(np.eye(3), (6, 3, 3))
    np.testing.assert_allclose(inverse_blocks(blocks) @ blocks, expected, atol=1e-9)
    np.testing.assert_allclose(inverse_blocks(blocks[:, :1, :1]) * blocks[:, :1, :1], 1.0)
