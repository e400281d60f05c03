"""What a turn leaves possible of a pull."""

import math

import numpy as np
import pytest
from circles import UP, circles, error_and_sigma, known
from long_form import first_of
from scipy.ndimage import gaussian_filter1d

from magcal_ros.core.assessment.verdict import judge
from magcal_ros.core.calibration.figure import Figure
from magcal_ros.core.estimation.gyro_path import gyro_path
from magcal_ros.core.estimation.model import Samples
from magcal_ros.core.estimation.possible_pull import doubtful_pull, leaning, lever_arm_left
from magcal_ros.core.geometry.rotations import rotation_about, rotation_from_rpy
from magcal_ros.core.samples.window import Window
from magcal_ros.core.simulation.simulator import DEGREE


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
    assert error < 3.5 * sigma


def without_gyro(window, jolts):
    """The same without a gyro, jolted by m/s² that last for a second or so."""
    rng = np.random.default_rng(3)
    slow = gaussian_filter1d(rng.standard_normal(window.specific_force.shape), 10.0, axis=0)
    force = window.specific_force + jolts * slow / slow.std() * np.array([1.0, 1.0, 0.3])
    return Window(window.time, window.field, force)


def test_a_car_without_a_gyro_may_be_pulled_all_the_way_and_who_turns_on_the_spot_is_not():
    robot, car = circles(radius=6.0)
    error, sigma, driven = error_and_sigma(robot, without_gyro(car, 0.4))
    assert 3.0 * DEGREE < error < 3.0 * sigma
    assert "turn on the spot" in judge(driven, known(robot), car).summary
    robot, still = circles()
    turned = error_and_sigma(robot, without_gyro(still, 0.1))[2]
    assert driven.figures[Figure.POSSIBLE_PULL] > 3.0 * DEGREE
    assert turned.figures[Figure.POSSIBLE_PULL] == 0.0


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
