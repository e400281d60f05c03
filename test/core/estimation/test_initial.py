"""First guesses: every closed-form root, and the true one among them."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from magcal_ros.core.estimation.averaging import prepare
from magcal_ros.core.estimation.initial import axes, starts
from magcal_ros.core.estimation.multi_start import search
from magcal_ros.core.estimation.prior import prior_from
from magcal_ros.core.geometry.rotations import roll_pitch_between, rotation_angle, rotation_from_rpy
from magcal_ros.core.knowledge import Knowledge
from magcal_ros.core.simulation.simulator import DEGREE, Robot, measure, turn

ANGLE = st.floats(-80 * DEGREE, 80 * DEGREE)
TILTED = np.array([0.0, 0.9, 0.9]) / math.hypot(0.9, 0.9)


@given(ANGLE, ANGLE, st.floats(-1.0, 1.0), st.floats(-1.0, 1.0))
def test_the_true_installation_is_among_the_roots(roll, pitch, x, y):
    axis = np.array([x, y, 1.5]) / math.hypot(x, y, 1.5)
    normal = rotation_from_rpy(roll, pitch).T @ axis
    found = roll_pitch_between(axis, normal, or_nearest=True)
    assert 1 <= len(found) <= 2
    true = rotation_from_rpy(roll, pitch)
    gaps = [rotation_angle(rotation_from_rpy(*guess).T @ true) for guess in found]
    assert min(gaps) < 1e-4
    for guess in found:
        np.testing.assert_allclose(rotation_from_rpy(*guess).T @ axis, normal, atol=1e-6)


def samples_of(robot, knowledge, **motion):
    window = measure(robot, turn(**motion), np.random.default_rng(1))
    return prepare(window.field, window.specific_force, knowledge, 800).averaged


@pytest.mark.parametrize("axis", [np.array([0.0, 0.0, 1.0]), TILTED])
@pytest.mark.parametrize("arc_deg", [120.0, 360.0])
def test_one_guess_is_near_the_truth(axis, arc_deg):
    robot = Robot()
    knowledge = robot.knowledge()
    samples = samples_of(robot, knowledge, axis=axis, arc=arc_deg * DEGREE)
    guesses = starts(samples, knowledge.reference, robot.strength, 1.0)
    true = rotation_from_rpy(robot.roll, robot.pitch)
    away = [
        rotation_angle(guess.shared.installation @ true)
        + np.abs(guess.shared.hard_iron - robot.hard_iron / robot.strength).max()
        for guess in guesses
    ]
    assert min(away) < 0.25


def test_an_upright_turn_has_one_axis_and_a_tilted_one_two():
    upright = samples_of(Robot(), Knowledge())
    assert len(axes(upright.up)) == 1
    tilted = samples_of(Robot(), Knowledge(), axis=TILTED)
    assert max(float(axis @ TILTED) for axis in axes(tilted.up)) > 0.999


def test_the_search_takes_the_smaller_installation_and_says_how_far_the_rival_is():
    robot = Robot()
    knowledge = robot.knowledge()
    samples = samples_of(robot, knowledge)
    prior = prior_from(knowledge, robot.strength, soft_iron=False)
    found = search(starts(samples, knowledge.reference, robot.strength, 1.0), samples, prior)
    true = rotation_from_rpy(robot.roll, robot.pitch)
    assert rotation_angle(found.best.shared.installation @ true) < 1 * DEGREE
    assert found.rival_gap < 1 * DEGREE
