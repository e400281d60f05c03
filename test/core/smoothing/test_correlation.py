"""The inefficiency factor of noise whose correlation is known."""

import numpy as np
import pytest

from magcal_ros.core.smoothing.certainty import inefficiency_factor


def autoregressive(coefficient, n, seed):
    rng = np.random.default_rng(seed)
    shocks, values = rng.standard_normal((n, 6)), np.zeros((n, 6))
    for k in range(1, n):
        values[k] = coefficient * values[k - 1] + np.sqrt(1.0 - coefficient**2) * shocks[k]
    return values


def test_white_noise_is_independent():
    rng = np.random.default_rng(1)
    factors = [inefficiency_factor(rng.standard_normal((500, 6)), np.ones(500)) for _ in range(50)]
    assert np.mean(factors) < 1.05


@pytest.mark.parametrize("coefficient", [0.3, 0.6, 0.9])
def test_an_autoregressive_process_has_its_own_factor(coefficient):
    factors = [
        inefficiency_factor(autoregressive(coefficient, 3000, seed), np.ones(3000))
        for seed in range(5)
    ]
    assert np.mean(factors) == pytest.approx((1.0 + coefficient) / (1.0 - coefficient), rel=0.2)


def test_samples_without_weight_say_nothing():
    values = autoregressive(0.6, 2000, 3)
    spoilt, weight = values.copy(), np.ones(2000)
    spoilt[500:600], weight[500:600] = 50.0, 0.0
    assert inefficiency_factor(spoilt, weight) == pytest.approx(
        inefficiency_factor(values, np.ones(2000)), rel=0.15
    )


def test_residuals_far_below_the_noise_count_as_white():
    values = autoregressive(0.9, 1000, 4)
    assert inefficiency_factor(1e-3 * values, np.ones(1000)) == 1.0
    assert inefficiency_factor(np.zeros((50, 6)), np.ones(50)) == 1.0
