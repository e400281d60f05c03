"""A pull of the turn, a bias of the gyro, and what tells them apart."""

import math
from dataclasses import replace

import numpy as np
import pytest
from long_form import first_of

from magcal_ros.core.calibration.figure import Figure
from magcal_ros.core.calibration.heading_sigma import predicted_heading_sigma
from magcal_ros.core.estimation.gyro_path import gyro_path
from magcal_ros.core.estimation.linear_acceleration import (
    doubtful_pull,
    leaning,
    lever_arm_left,
)
from magcal_ros.core.estimation.model import Samples
from magcal_ros.core.geometry.rotations import rotation_about, rotation_from_rpy
from magcal_ros.core.knowledge import Systematics
from magcal_ros.core.methods.maximum_likelihood import fit
from magcal_ros.core.samples.rest import RestBeside
from magcal_ros.core.samples.window import Window
from magcal_ros.core.simulation.simulator import (
    DEGREE,
    LEVEL_TILT,
    Motion,
    Robot,
    heading_errors,
    measure,
)

UP = np.array([0.0, 0.0, 1.0])


def circles(bias=(0.0, 0.0, 0.0), radius=0.0, unevenness=0.4, seed=1):
    """Two circles at an uneven rate; the pull is that of a vehicle on a circle of this radius."""
    time = np.arange(0.0, 40.0, 0.05)
    rate = math.tau / 20.0 * (1.0 + unevenness * np.sin(math.tau * time / 13.0))
    yaw = np.cumsum(rate) * 0.05
    robot = Robot(gyro_bias=np.array(bias) * DEGREE, noise_field=0.3e-6, noise_force=0.05)
    motion = Motion(time, rotation_about(UP, -yaw))
    window = measure(robot, motion, np.random.default_rng(seed), gyro=True)
    pull = np.zeros((len(time), 3))
    pull[:, 1] = rate**2 * radius
    return robot, Window(time, window.field, window.specific_force + pull, window.angular_rate)


def known(robot):
    return replace(robot.knowledge(1.5e-6, 1.0 * DEGREE), systematics=Systematics())


def error_and_sigma(robot, window):
    estimate = fit(window, known(robot))
    gap = heading_errors(estimate.correction, robot)[:, LEVEL_TILT]
    return math.sqrt(np.mean(gap**2)), predicted_heading_sigma(estimate, 0.0), estimate


@pytest.mark.parametrize("radius", first_of([5.0, 10.0]))
def test_a_cars_circle_is_told_from_a_leaning_sensor(radius):
    error, sigma, estimate = error_and_sigma(*circles(radius=radius))
    assert error < 1.0 * DEGREE
    assert error < 3.0 * sigma
    mean = radius * (math.tau / 20.0) ** 2 / 9.81
    assert estimate.figures[Figure.STEADY_PULL] == pytest.approx(mean, rel=0.3)


KNOWN_FAULT = pytest.mark.xfail(
    strict=True, reason="a bias of 2 °/s about y alone leaves a pull of .001 g"
)
BIASES = [(1.0, 1.0, 1.5), (2.0, 0.0, 0.0), (0.0, -2, 0)]


@pytest.mark.parametrize(
    "direction",
    [*first_of(BIASES[:2]), pytest.param(BIASES[2], marks=[pytest.mark.nightly, KNOWN_FAULT])],
)
def test_a_gyros_bias_is_no_pull(direction):
    robot, window = circles(bias=direction)
    assert error_and_sigma(robot, window)[2].figures[Figure.STEADY_PULL] == 0.0


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


def lean_of(time, rate, force_of, bias=np.zeros(3)):
    """Return what `leaning` makes of a robot that turns at a rate on a slope of 8 degrees."""
    yaw = np.concatenate([[0.0], np.cumsum(0.5 * (rate[1:] + rate[:-1]) * np.diff(time))])
    attitude = rotation_about(UP, -yaw) @ rotation_from_rpy(8.0 * DEGREE, 0.0).T
    up = attitude @ UP
    # On a slope the robot's own z is the axis.
    window = Window(time, up, force_of(up), np.outer(rate, UP) + bias)
    first = np.arange(len(time))
    samples = Samples(window.specific_force, window.field, np.eye(3))
    return leaning(samples, gyro_path(window, first)).apart


TIME = np.arange(0.0, 30.0, 0.1)
RATES = {
    "there and back": 0.6 * np.sin(math.tau * TIME / 30.0),
    "stops": np.where(TIME % 4.0 < 2.0, 0.5, 0.0),
    "a turn and a third": np.full(len(TIME), 0.28),
}


@pytest.mark.parametrize("rate", list(RATES.values()), ids=list(RATES))
def test_a_slope_is_no_pull_however_the_robot_turns(rate):
    bias = np.array([0.002, -0.002, 0.0])
    assert lean_of(TIME, rate, lambda up: up, bias) < 0.8 * DEGREE
    pulled = lean_of(TIME, rate, lambda up: up + np.array([0.0, 0.1, 0.0]), bias)
    assert pulled == pytest.approx(0.1, rel=0.2)


@pytest.mark.parametrize("angle", first_of([0.5, 2.5, 4.5]))
def test_a_small_circle_driven_smoothly_is_no_turn_on_the_spot_that_is_sure_of_itself(angle):
    robot, window = circles(bias=(0.1, -0.1, 0.1), unevenness=0.0)
    pull = 0.25 * np.array([math.cos(angle), math.sin(angle), 0.0])
    force = window.specific_force + pull
    pulled = Window(window.time, window.field, force, window.angular_rate)
    error, sigma, _ = error_and_sigma(robot, pulled)
    assert error > 0.5 * DEGREE
    assert error < 3.0 * sigma


def test_what_a_lever_arm_explains_and_what_no_small_robot_drives_is_no_doubt():
    rate = 0.4
    metre = rate**2 / 9.80665
    assert doubtful_pull(0.2 * metre, rate, 0.1) == 0.0
    circle = doubtful_pull(1.0 * metre, rate, 0.1)
    assert 0.0 < circle < 1.0 * metre
    assert doubtful_pull(20.0 * metre, rate, 0.1) == doubtful_pull(10.0 * metre, rate, 0.1)


def test_on_a_fast_turn_the_gyro_knows_the_lever_arm_and_on_a_slow_one_it_does_not():
    assert lever_arm_left(0.0, 0.3, 0.1, 0.005) == pytest.approx(0.1, rel=0.01)
    fast = lever_arm_left(0.0, 4.0, 0.1, 0.005)
    assert fast < 0.02
    assert fast < lever_arm_left(0.1, 4.0, 0.1, 0.005) < 0.1
