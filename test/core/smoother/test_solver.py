"""The elimination of nodes against numpy's dense matrices."""

import numpy as np
import pytest

from magcal_ros.core.smoother import Residuals
from magcal_ros.core.smoother.solver import WeightedResiduals, block_tridiagonal

SIZE = 3


def blocks(count, rng):
    """A positive definite block tridiagonal matrix: its blocks, and all of it."""
    whole = np.zeros((count * SIZE, count * SIZE))
    for k in range(count):
        rows = slice(k * SIZE, min(k + 2, count) * SIZE)
        step = rng.standard_normal((2 * SIZE, whole[rows].shape[0]))
        whole[rows, rows] += step.T @ step + 0.1 * np.eye(step.shape[1])
    grid = whole.reshape(count, SIZE, count, SIZE)
    diagonal = np.array([grid[k, :, k] for k in range(count)])
    upper = np.array([grid[k, :, k + 1] for k in range(count - 1)]).reshape(-1, SIZE, SIZE)
    return diagonal, upper, whole


@pytest.mark.parametrize("count", range(1, 10))
def test_a_chain_solves_and_inverts_as_the_whole_matrix_does(count):
    rng = np.random.default_rng(count)
    diagonal, upper, whole = blocks(count, rng)
    chain = block_tridiagonal(diagonal, upper)
    right = rng.standard_normal((count, SIZE, 4))
    solved = np.linalg.solve(whole, right.reshape(-1, 4))
    np.testing.assert_allclose(chain.solve(right).reshape(-1, 4), solved, rtol=1e-8, atol=1e-10)
    inverse = np.linalg.inv(whole).reshape(count, SIZE, count, SIZE)
    own, beside = chain.covariance()
    assert len(own) == count
    assert len(beside) == count - 1
    for k in range(count):
        np.testing.assert_allclose(own[k], inverse[k, :, k], rtol=1e-8, atol=1e-10)
    for k in range(count - 1):
        np.testing.assert_allclose(beside[k], inverse[k, :, k + 1], rtol=1e-8, atol=1e-10)
    assert chain.log_determinant == pytest.approx(np.linalg.slogdet(whole)[1])


def test_a_matrix_that_is_not_positive_definite_is_refused():
    diagonal, upper, _ = blocks(5, np.random.default_rng(0))
    diagonal[3] -= 100.0 * np.eye(SIZE)
    with pytest.raises(np.linalg.LinAlgError):
        block_tridiagonal(diagonal, upper)


@pytest.mark.parametrize("freedom", [1.0, 2.0, 6.0, 1e9])
def test_the_density_of_every_student_distribution_integrates_to_that_of_a_gaussian(freedom):
    x = np.sinh(np.linspace(-12.0, 12.0, 20_001))
    costs = WeightedResiduals(Residuals(x[:, None], ()), np.full(len(x), 4.0), freedom)
    density = np.exp(-0.5 * (costs.costs + costs.normaliser))
    total = np.sum(0.5 * (density[1:] + density[:-1]) * np.diff(x))
    assert total == pytest.approx(np.sqrt(2.0 * np.pi), rel=1e-4)
