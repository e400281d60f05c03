"""The hard iron swings about the middle of the arc, and its covariance knows."""

import math

import numpy as np
import pytest

from magcal_ros.core.estimation import parameters as p
from magcal_ros.core.estimation.uncertainty import bend_of_hard_iron
from magcal_ros.core.methods.maximum_likelihood import fit
from magcal_ros.core.simulation.simulator import DEGREE, Robot, measure, turn


def middle(shared, turned, mounting):
    """The middle of the raw field, hard iron left out."""
    field = shared.body_axis @ turned @ shared.world_axis.T @ shared.field_enu
    return shared.distortion(mounting) @ field


def test_it_is_the_mean_square_of_what_the_middle_departs_from_its_tangent(state, samples, rng):
    shared, turned = state.shared, state.attitude.mean(axis=0)
    moving = [p.ROLL, p.PITCH]
    root = 0.1 * rng.standard_normal((len(moving), len(moving)))
    covariance = np.zeros((p.COUNT, p.COUNT))
    covariance[np.ix_(moving, moving)] = root @ root.T
    departures = []
    for _ in range(1500):
        step = np.zeros(p.COUNT)
        step[moving] = root @ rng.standard_normal(len(moving))
        there, back = (middle(shared.moved(s), turned, samples.mounting) for s in (step, -step))
        departures.append(0.5 * (there + back) - middle(shared, turned, samples.mounting))
    found = bend_of_hard_iron(shared, turned, samples.mounting, covariance)
    sampled = np.einsum("ni,nj->ij", departures, departures) / len(departures)
    np.testing.assert_allclose(found, sampled, atol=0.2 * np.trace(sampled))


def test_where_nothing_is_uncertain_nothing_bends(state, samples):
    nothing = np.zeros((p.COUNT, p.COUNT))
    turned = state.attitude.mean(axis=0)
    assert not bend_of_hard_iron(state.shared, turned, samples.mounting, nothing).any()


@pytest.mark.nightly
@pytest.mark.parametrize("slope", [0.0, 10.0])
def test_the_hard_iron_of_a_short_arc_is_as_uncertain_as_it_says(slope):
    robot, ratios = Robot(), []
    for seed in range(40):
        rng = np.random.default_rng([13, seed])
        start = (slope * DEGREE, 0.0, rng.uniform(-math.pi, math.pi))
        window = measure(robot, turn(arc=math.pi / 4, start_rpy=start), rng)
        estimate = fit(window, robot.knowledge())
        error = estimate.correction.hard_iron - robot.hard_iron
        ratios.append(error @ np.linalg.solve(estimate.covariance[9:, 9:], error) / 3.0)
    # Along the tangent alone this was three and more.
    assert 0.5 < np.mean(ratios) < 1.6
