"""What is known becomes a Gaussian: its cost, its slope, and what may move."""

import math
from dataclasses import replace

import numpy as np
import pytest

from magcal_ros.core.estimation import parameters as p
from magcal_ros.core.estimation.prior import (
    SOFT_IRON_INDICES,
    WIDEST,
    prior_from,
)
from magcal_ros.core.knowledge import Knowledge
from magcal_ros.core.simulation.simulator import DEGREE, Robot

SCALE = 48e-6
ROBOT = replace(Robot(), strength=48e-6, inclination=60.0 * DEGREE)
KNOWN = ROBOT.knowledge(1e-6, 2.0 * DEGREE)


def prior_of(knowledge, **options):
    return prior_from(knowledge, SCALE, **{"soft_iron": True, **options})


def test_what_is_exact_is_held_and_what_is_known_costs_its_sigmas(state):
    prior = prior_of(KNOWN)
    shared = replace(state.shared, strength=1.0 + 2.0e-6 / SCALE, inclination=63.0 * DEGREE)
    shared = replace(shared, soft_iron=np.zeros(6))
    assert prior.cost(shared) == pytest.approx(2.0**2 + 1.5**2)
    exact = prior_of(ROBOT.knowledge(0.0, 0.0))
    assert not np.isin([p.STRENGTH, p.INCLINATION], exact.free).any()
    assert np.isin([p.STRENGTH, p.INCLINATION], prior.free).all()


GAUSSIAN_ABOUT_ZERO = [*range(11, 17), p.YAW]


@pytest.mark.parametrize("index", GAUSSIAN_ABOUT_ZERO)
def test_the_slope_of_the_cost_pulls_towards_what_is_expected(state, index):
    prior = prior_of(Knowledge(), yaw=True)
    step = 1e-6 * np.eye(p.COUNT)[index]
    rise = prior.cost(state.shared.moved(step)) - prior.cost(state.shared.moved(-step))
    pull = prior.information[index] * prior.deviation(state.shared)[index]
    assert prior.information[index] > 0.0
    assert -pull == pytest.approx(rise / 4e-6, rel=1e-4, abs=1e-4)


def test_only_where_nothing_is_known_of_the_field_is_the_hard_iron_held():
    unknown = prior_of(ROBOT.knowledge(math.inf, math.inf))
    assert unknown.holds_hard_iron
    np.testing.assert_allclose(unknown.information[p.HARD_IRON], WIDEST.hard_iron**-2)
    assert not prior_of(ROBOT.knowledge(1e-6, math.inf)).holds_hard_iron
    assert not prior_of(ROBOT.knowledge(math.inf, 2.0 * DEGREE)).holds_hard_iron


def test_soft_iron_and_yaw_move_only_where_they_are_asked_for():
    rigid = prior_of(KNOWN, soft_iron=False)
    assert not rigid.has_soft_iron
    assert p.YAW not in rigid.free
    assert prior_of(KNOWN).has_soft_iron
    assert p.YAW in prior_of(KNOWN, yaw=True).free


def test_soft_iron_far_beyond_its_prior_widens_that_prior_alone(state):
    prior = prior_of(KNOWN)
    sigma = prior.information[SOFT_IRON_INDICES] ** -0.5
    iron = np.array([5.0, 0.5, 0.0, 50.0, 0.0, 0.0]) * sigma
    wide = prior.as_wide_as(replace(state.shared, soft_iron=iron), beyond=3.0)
    found = wide.information[SOFT_IRON_INDICES] ** -0.5
    expected = sigma.copy()
    expected[0], expected[3] = min(iron[0], WIDEST.soft_iron), min(iron[3], WIDEST.soft_iron)
    np.testing.assert_allclose(found, expected)
    others = np.setdiff1d(np.arange(p.COUNT), SOFT_IRON_INDICES)
    np.testing.assert_array_equal(wide.information[others], prior.information[others])
