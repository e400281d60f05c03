import math

import numpy as np
import pytest
from simulated.turns import Motion, measure

from magcal_ros.core.geometry import rotation_about
from magcal_ros.core.samples import rests_around
from magcal_ros.core.simulation import Robot

DEGREE = math.pi / 180.0
UP = np.array([0.0, 0.0, 1.0])


def turned(yaw, seconds, bias, seed=1):
    """The measurements for a yaw over time."""
    time = np.linspace(0.0, seconds, len(yaw))
    robot = Robot(gyro_bias=np.array(bias) * DEGREE, noise_rate=0.003)
    return measure(
        robot, Motion(time, rotation_about(UP, -yaw)), np.random.default_rng(seed), gyro=True
    )


def bias_at_rest(window):
    return rests_around(window.time, window.field, window.angular_rate)[2]


def rest_and_turn(rest=5.0, rate=0.5, hz=40.0):
    still = np.zeros(int(rest * hz))
    return np.concatenate([still, np.arange(0.0, math.tau, rate / hz)]), hz


@pytest.mark.parametrize("bias", [(5.0, 0.0, 0.0), (3.5, 2.0, 1.9), (0.0, 0.0, -5.0)])
def test_a_large_bias_is_learnt_within_seconds_of_rest(bias):
    yaw, hz = rest_and_turn()
    window = turned(yaw, len(yaw) / hz, bias)
    found = bias_at_rest(window)
    np.testing.assert_allclose(found / DEGREE, bias, atol=0.15)


def test_an_even_turn_is_no_rest():
    yaw = np.linspace(0.0, 2.0 * math.tau, 1600)
    window = turned(yaw, 40.0, (0.0, 0.0, 0.0))
    assert bias_at_rest(window) is None


@pytest.mark.parametrize("seed", range(8))
@pytest.mark.parametrize("rate", [0.02, 0.05, 0.1, 0.3])
def test_a_slow_turn_is_never_taken_for_a_bias(rate, seed):
    yaw = np.arange(0.0, math.tau, rate / 10.0)
    window = turned(yaw, len(yaw) / 10.0, (0.0, 0.0, 0.0), seed)
    assert bias_at_rest(window) is None


def test_a_small_bias_is_the_mean_rate_of_the_rest():
    yaw, hz = rest_and_turn()
    found = bias_at_rest(turned(yaw, len(yaw) / hz, (0.0, 0.0, 0.05)))
    np.testing.assert_allclose(found / DEGREE, (0.0, 0.0, 0.05), atol=0.05)


def test_too_few_samples_show_no_rest():
    window = turned(np.zeros(4), 0.1, (5.0, 0.0, 0.0))
    assert bias_at_rest(window) is None
