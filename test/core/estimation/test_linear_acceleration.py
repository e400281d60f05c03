"""A pull of the turn, a bias of the gyro, and what tells them apart."""

import math
from dataclasses import replace

import numpy as np
import pytest
from circles import circles, error_and_sigma, known
from long_form import first_of
from realistic_robots import by_rested_turn, by_turn, collected, heading_error

from magcal_ros.core.calibration.figure import Figure
from magcal_ros.core.calibration.heading_sigma import predicted_heading_sigma
from magcal_ros.core.methods.maximum_likelihood import fit
from magcal_ros.core.samples.rest import RestBeside
from magcal_ros.core.samples.window import Window
from magcal_ros.core.simulation.simulator import DEGREE


@pytest.mark.parametrize("radius", first_of([5.0, 10.0]))
def test_a_cars_circle_is_told_from_a_leaning_sensor(radius):
    error, sigma, estimate = error_and_sigma(*circles(radius=radius))
    assert error < 1.0 * DEGREE
    assert error < 3.0 * sigma
    mean = radius * (math.tau / 20.0) ** 2 / 9.81
    assert estimate.figures[Figure.STEADY_PULL] == pytest.approx(mean, rel=0.3)


BIASES = [(1.0, 1.0, 1.5), (2.0, 0.0, 0.0), (0.0, -2.0, 0.0)]


@pytest.mark.parametrize("direction", first_of(BIASES))
def test_a_gyros_bias_is_no_pull(direction):
    """A pull of .002 g leans up by .1 degrees: a lever arm of 2 cm gives it at 1 rad/s."""
    robot, window = circles(bias=direction)
    assert error_and_sigma(robot, window)[2].figures[Figure.STEADY_PULL] < 0.002


@pytest.mark.parametrize("direction", first_of(BIASES))
def test_a_gyros_bias_does_no_harm(direction):
    """More knowledge never hurts: with this gyro as without it."""
    robot, window = circles(bias=direction)
    error, sigma, _ = error_and_sigma(robot, window)
    without = error_and_sigma(robot, Window(window.time, window.field, window.specific_force))[0]
    assert error < 1.1 * without + 0.1 * DEGREE
    assert error < 3.0 * sigma


def rested(share):
    """Circles of .1 g, and a rest after them at which the sensor reads a share of that."""
    robot, window = circles(radius=10.0)
    lean = share * 10.0 * (math.tau / 20.0) ** 2
    force = np.array([0.0, lean, math.sqrt(9.81**2 - lean**2)])
    still = RestBeside(
        3.0, window.field[-1], 1e-8, force, np.zeros(3), 2e-4, window.time[-1], np.eye(3)
    )
    return robot, replace(window, rests=(still,))


@pytest.mark.parametrize(("share", "is_pulled"), [(0.0, True), (1.0, False)])
def test_a_rest_tells_whose_the_lean_is(share, is_pulled):
    figures = error_and_sigma(*rested(share))[2].figures
    assert (figures[Figure.STEADY_PULL] > 0.05) == is_pulled
    assert figures[Figure.GYRO_GAP] < 0.6 * DEGREE


@pytest.mark.parametrize(
    "robot", [("typical", 11), *first_of([("cheap", 1), ("typical", 5), ("typical", 8)])]
)
def test_an_accelerometer_that_is_off_is_no_lever_arm_and_no_motor(robot):
    """From rest to rest, there and back: what it reads always had passed for what follows the rate.

    Typical 11 was 1.4 degrees off and said .2, cheap 1 was 1.3 off and said .3.
    """
    sensors, number = robot
    scene, knowledge = by_rested_turn("there and back", sensors, "open")(number)
    window = collected(scene.window)
    estimate = fit(window, knowledge)
    error = heading_error(scene, estimate.correction)
    alone = fit(replace(window, angular_rate=None), knowledge)
    assert error < 0.5 * DEGREE
    assert error < 2.0 * predicted_heading_sigma(estimate, 0.0)
    assert error < 1.1 * heading_error(scene, alone.correction) + 0.1 * DEGREE


def test_a_rest_that_tells_half_of_it_leaves_a_doubt():
    """Whichever is taken for the whole, the other half is wrong."""
    estimates = [error_and_sigma(*rested(share)) for share in (0.45, 0.55)]
    gap = error_and_sigma(*rested(1.0))[0]
    for _, sigma, estimate in estimates:
        assert estimate.figures[Figure.GYRO_GAP] == pytest.approx(0.45 * gap, rel=0.3)
        assert sigma > 0.4 * gap


def test_what_cannot_be_told_apart_has_a_large_sigma():
    """An even turn: a gyro of 2 degrees a second, or a robot that is pulled."""
    for case in ({"bias": (0.0, 2.0, 0.0)}, {"radius": 10.0}):
        error, sigma, _ = error_and_sigma(*circles(unevenness=0.0, **case))
        assert error < 3.0 * sigma


def test_a_clean_turn_is_asked_for_no_pull():
    _, _, estimate = error_and_sigma(*circles())
    assert estimate.figures[Figure.STEADY_PULL] == 0.0
    assert estimate.figures[Figure.GYRO_GAP] < 0.2 * DEGREE


@pytest.mark.parametrize("unevenness", first_of([0.8, 0.4]))
def test_an_accelerometer_that_is_off_is_no_pull(unevenness):
    """It leans the same at any rate, and will lean when the calibration is used."""
    robot, window = circles(unevenness=unevenness)
    force = window.specific_force + np.array([0.3, -0.2, 0.0])
    found = fit(replace(window, specific_force=force), known(robot))
    alone = fit(Window(window.time, window.field, force), known(robot))
    assert found.figures[Figure.STEADY_PULL] == 0.0
    gap = (
        found.installation.roll - alone.installation.roll,
        found.installation.pitch - (alone.installation.pitch),
    )
    assert math.hypot(*gap) < 0.1 * DEGREE


@pytest.mark.parametrize("number", first_of([55, 51]))
def test_a_pull_that_is_no_likelier_than_a_sensor_that_leans_is_left_in(number):
    """More knowledge never hurts: left in, the heading is as good as without the gyro."""
    scene, knowledge = by_turn("there and back", "cheap", "open")(number)
    estimate = fit(scene.window, knowledge)
    assert estimate.figures[Figure.STEADY_PULL] == 0.0
    alone = fit(replace(scene.window, angular_rate=None), knowledge)
    errors = [heading_error(scene, each.correction) for each in (estimate, alone)]
    assert errors[0] < errors[1] + 0.3 * DEGREE


def test_a_pull_that_not_all_samples_follow_is_in_doubt():
    """An eighth of them would have to be outliers, of a robot that nothing jolts."""
    scene, knowledge = by_turn("there and back", "cheap", "open")(58)
    estimate = fit(scene.window, knowledge)
    error = heading_error(scene, estimate.correction)
    assert error < 4.0 * predicted_heading_sigma(estimate, 0.0)
    assert estimate.figures[Figure.GYRO_GAP] > 0.5 * DEGREE
