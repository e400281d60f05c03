"""IRLS weights and the gate."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from magcal_ros.core.estimation.weighting import ChiSquares
from magcal_ros.core.estimation.weights import (
    ROBUST,
    gate,
    moving_sum,
    passes_alone,
    student_cost,
    student_weights,
)

SQUARES = st.floats(0.0, 1e4)


def chi_of(up, field=0.0, wobble=0.0):
    return ChiSquares(*(np.atleast_1d(np.asarray(part, float)) for part in (up, field, wobble)))


def noise_of(n, seed=1):
    return np.random.default_rng(seed).standard_normal((n, 6))


def chi_from(residual):
    squares = residual**2
    return ChiSquares(squares[:, :3].sum(1), squares[:, 3:].sum(1), np.zeros(len(residual)))


@given(SQUARES, SQUARES, SQUARES)
def test_a_weight_is_the_slope_of_the_student_cost(up, field, wobble):
    weights = student_weights(chi_of(up, field, wobble), leans=True)

    def rise(by_up, by_wobble):
        ahead = student_cost(chi_of(up + by_up, field, wobble + by_wobble), leans=True)
        return ahead - student_cost(chi_of(up - by_up, field, wobble - by_wobble), leans=True)

    step = 1e-3 * (1.0 + up + field)
    assert weights.data[0] == pytest.approx(rise(step, 0.0) / (2.0 * step), rel=1e-4)
    step = 1e-3 * (1.0 + wobble)
    assert weights.wobble[0] == pytest.approx(rise(0.0, step) / (2.0 * step), rel=1e-4)


def test_a_rigid_axis_has_no_lean_to_weigh():
    assert student_weights(chi_of(1.0, 1.0, 1e6), leans=False).wobble[0] == 1.0
    chi = chi_of(1.0, 1.0, 5.0)
    assert student_cost(chi, leans=False) < student_cost(chi, leans=True)


def test_honest_noise_passes_the_gate_but_for_its_tail():
    residual = noise_of(20_000)
    chi = chi_from(residual)
    # Residuals of up and field: six numbers where the model counts five degrees of freedom.
    dropped = 1.0 - passes_alone(chi, np.zeros(20_000)).mean()
    assert dropped < 5.0 * ROBUST.gate_tail


def test_single_outliers_are_dropped_alone():
    residual = noise_of(500)
    residual[[7, 100, 400], 3] += 12.0
    inliers = gate(residual, chi_from(residual), np.zeros(500))
    assert not inliers[[7, 100, 400]].any()
    assert inliers.mean() > 0.97


def test_a_weak_disturbance_is_dropped_as_a_stretch():
    residual = noise_of(600)
    residual[200:300, 3:] += 1.5 * np.sin(np.linspace(0.0, np.pi, 100))[:, None]
    chi = chi_from(residual)
    assert passes_alone(chi)[200:300].mean() > 0.8
    assert gate(residual, chi, np.zeros(600))[225:275].mean() < 0.2


def test_correlated_but_honest_samples_are_kept():
    rng = np.random.default_rng(2)
    shocks, residual = rng.standard_normal((800, 6)), np.zeros((800, 6))
    for k in range(1, 800):
        residual[k] = 0.8 * residual[k - 1] + 0.6 * shocks[k]
    assert gate(residual, chi_from(residual), np.zeros(800)).mean() > 0.9


@given(st.integers(1, 40), st.integers(1, 60))
def test_a_moving_sum_is_a_sum_over_neighbours(width, n):
    values = np.arange(1.0, n + 1.0)
    before = (width - 1) // 2
    expected = [values[max(k - before, 0) : k - before + width].sum() for k in range(n)]
    np.testing.assert_allclose(moving_sum(values, width), expected)
