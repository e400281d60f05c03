"""How far two fits are apart, where it counts."""

import math
from dataclasses import replace

import numpy as np
import pytest
from slope_turns import KNOWN, LEVEL, window_on

from magcal_ros.core.estimation.heading_gap import heading_gap, unexplained_gap
from magcal_ros.core.estimation.model import Evaluation, State
from magcal_ros.core.methods.maximum_likelihood.fit import solve


@pytest.fixture(scope="module")
def optimum():
    return solve(window_on(LEVEL, np.random.default_rng(1)), KNOWN).choice.fit


def changed(fit, **numbers):
    place = fit.block.place
    state = State(replace(place.state.shared, **numbers), place.state.attitude)
    return fit.with_blocks([replace(fit.block, place=Evaluation(state, place.samples))])


def test_a_fit_is_nowhere_from_itself(optimum):
    assert heading_gap(optimum, optimum) < 1e-12


@pytest.mark.parametrize("yaw_deg", [-20.0, 0.1, 5.0])
def test_on_the_level_a_yaw_of_the_installation_is_its_whole_size(optimum, yaw_deg):
    yaw = math.radians(yaw_deg)
    other = changed(optimum, yaw=optimum.shared.yaw + yaw)
    assert heading_gap(optimum, other) == pytest.approx(abs(yaw), rel=0.01)
    assert heading_gap(other, optimum) == pytest.approx(heading_gap(optimum, other))


def test_a_hard_iron_swings_the_heading_by_its_share_of_the_level_field(optimum):
    shared = optimum.shared
    level = shared.strength * math.cos(shared.inclination)
    iron = shared.hard_iron + np.array([0.02 * level, 0.0, 0.0])
    expected = 0.02 / math.sqrt(2.0)
    assert heading_gap(optimum, changed(optimum, hard_iron=iron)) == pytest.approx(
        expected, rel=0.1
    )


def test_what_the_other_fit_does_not_know_itself_is_no_gap(optimum):
    shared = optimum.shared
    iron = shared.hard_iron + np.array([1e-3, 0.0, 0.0])
    other = changed(optimum, hard_iron=iron)
    weighting = other.block.weighting
    noise = replace(weighting.noise, field=10.0 * weighting.noise.field)
    vague = other.with_blocks([other.block.weighted(replace(weighting, noise=noise))])
    assert unexplained_gap(optimum, other) == pytest.approx(heading_gap(optimum, other), rel=0.2)
    assert unexplained_gap(optimum, vague) == 0.0
