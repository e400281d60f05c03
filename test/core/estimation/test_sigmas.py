"""The noise is what the residuals have, over the degrees of freedom they have left."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from magcal_ros.core.estimation.sigmas import FLOOR, estimate_noise, largest_change, limited
from magcal_ros.core.estimation.weighting import Noise, Weighting, Weights

SIGMA = st.floats(1e-4, 1.0)
OLD = Noise(0.02, 0.03, 0.05)


@given(SIGMA, SIGMA, SIGMA, st.floats(1.1, 3.0))
def test_a_change_is_bounded_and_ends_at_the_floor(up, field, wobble, change):
    new = limited(Noise(up, field, wobble), OLD, change)
    for name in ("up", "field", "wobble"):
        value, old, floor = (getattr(noise, name) for noise in (new, OLD, FLOOR))
        assert floor <= value <= max(old * change, floor)
        assert value >= old / change * (1.0 - 1e-12)


def test_residuals_of_another_size_are_recognised():
    rng = np.random.default_rng(1)
    residual = np.hstack(
        [1.3 * rng.standard_normal((4000, 3)), 0.8 * rng.standard_normal((4000, 3))]
    )
    freedom = Noise(3.0 * 4000, 3.0 * 4000, 0.07)
    found = estimate_noise(residual, Weighting(OLD, Weights.ones(4000)), freedom, 2.0)
    assert found.up == pytest.approx(1.3 * OLD.up, rel=0.03)
    assert found.field == pytest.approx(0.8 * OLD.field, rel=0.03)
    assert found.wobble == 0.07


def test_what_the_attitudes_paid_is_no_noise():
    residual = np.ones((100, 6))
    weighting = Weighting(OLD, Weights.ones(100))
    whole = estimate_noise(residual, weighting, Noise(300.0, 300.0, 0.05), 10.0)
    part = estimate_noise(residual, weighting, Noise(75.0, 150.0, 0.05), 10.0)
    assert part.up == pytest.approx(2.0 * whole.up)
    assert part.field == pytest.approx(math.sqrt(2.0) * whole.field)


def test_outliers_are_no_noise():
    residual = np.ones((100, 6))
    residual[:10] = 100.0
    weights = Weights.of_inliers(np.arange(100) >= 10)
    found = estimate_noise(residual, Weighting(OLD, weights), Noise(270.0, 270.0, 0.05), 10.0)
    assert found.up == pytest.approx(OLD.up)


def test_a_wobble_that_fades_does_not_count_as_a_change():
    new = Noise(0.02, 0.03, 0.005)
    assert largest_change(new, OLD) == pytest.approx(math.log(10.0))
    assert largest_change(new, OLD, least_wobble=0.5) == 0.0
