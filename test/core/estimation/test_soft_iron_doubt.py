"""One rule for soft iron that is neither shown nor excluded."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from magcal_ros.core.estimation import parameters as p
from magcal_ros.core.estimation.prior import SOFT_IRON_INDICES, Prior
from magcal_ros.core.estimation.soft_iron_doubt import (
    RULE,
    Doubt,
    Look,
    look_for_soft_iron,
    occam_factor,
)

NOWHERE = np.zeros((p.COUNT, p.COUNT))


def look(gain=0.0, occam=10.0, step=None, covariance=NOWHERE):
    return Look(gain, occam, np.zeros(p.COUNT) if step is None else step, covariance)


def test_the_mixture_is_about_the_simpler_estimate():
    """Draw the truth from either model: the mean square about the simpler model's numbers."""
    rng = np.random.default_rng(1)
    likely, dimension = 0.3, 12
    jacobian = rng.standard_normal((dimension, p.COUNT)) / 4.0
    roots = [0.3 * rng.standard_normal((p.COUNT, p.COUNT)) / 4.0 for _ in range(2)]
    simple, rich = (root @ root.T for root in roots)
    away = rng.standard_normal(p.COUNT)
    found = Doubt(look(step=away, covariance=rich), likely).widened(
        jacobian @ simple @ jacobian.T, jacobian
    )
    draws = 400_000
    is_rich = rng.random(draws) < likely
    truth = np.where(
        is_rich[:, None],
        away + rng.standard_normal((draws, p.COUNT)) @ roots[1].T,
        rng.standard_normal((draws, p.COUNT)) @ roots[0].T,
    )
    errors = truth @ jacobian.T
    sampled = errors.T @ errors / draws
    assert np.linalg.norm(found - sampled) < 0.02 * np.linalg.norm(sampled)
    about_the_mean = found - likely**2 * np.outer(jacobian @ away, jacobian @ away)
    assert np.linalg.norm(about_the_mean - sampled) > 0.1 * np.linalg.norm(sampled)


@given(st.floats(4.0, 60.0), st.floats(4.0, 60.0))
def test_more_gain_is_more_likely(one, other):
    low, high = sorted((one, other))
    assert look().probability(low) <= look().probability(high)


def test_chance_gains_are_no_doubt():
    assert look(occam=-50.0).probability(RULE.chance - 0.01) == 0.0
    assert look(occam=1000.0).probability(20.0) == 0.0


def test_even_odds_lie_where_the_log_bayes_factor_says():
    occam = 12.0
    assert look(occam=occam).probability(occam + RULE.prior_odds) == pytest.approx(0.5)


@given(st.floats(-20.0, 60.0))
def test_what_is_needed_lies_between_its_bounds(occam):
    assert RULE.least_fall <= look(occam=occam).needed(RULE.most_fall) <= RULE.most_fall


def test_one_step_finds_the_optimum_of_a_quadratic():
    rng = np.random.default_rng(2)
    free = np.array([p.ROLL, p.PITCH, *SOFT_IRON_INDICES])
    root = rng.standard_normal((len(free), len(free)))
    information = root @ root.T + 5.0 * np.eye(len(free))
    gradient = rng.standard_normal(len(free))
    prior = Prior(free, np.full(p.COUNT, 4.0), 1.0, 1.0)
    found = look_for_soft_iron(np.linalg.inv(information), gradient, prior)
    optimum = np.linalg.solve(information, gradient)
    np.testing.assert_allclose(found.step[free], optimum)
    # At the optimum the cost x A x - 2 g x is -g A^-1 g.
    assert found.gain == pytest.approx(2 * gradient @ optimum - optimum @ information @ optimum)


def test_occams_factor_is_the_ratio_of_volumes():
    prior = Prior(np.arange(p.COUNT), np.full(p.COUNT, 0.1**-2), 1.0, 1.0)
    covariance = np.diag(np.full(p.COUNT, 0.02**2))
    assert occam_factor(covariance, prior) == pytest.approx(2 * 6 * math.log(0.1 / 0.02))
