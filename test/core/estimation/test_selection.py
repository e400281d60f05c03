"""Which model is chosen, and on what grounds."""

import math

import numpy as np
import pytest

from magcal_ros.core.errors import Reason, Refusal
from magcal_ros.core.estimation.selection import lasting_gain
from magcal_ros.core.methods.maximum_likelihood import fit
from magcal_ros.core.simulation.simulator import (
    DEGREE,
    Robot,
    Trouble,
    measure,
    smooth_wobble,
    turn,
)


def test_a_gain_all_along_the_turn_counts_in_full():
    assert lasting_gain(80.0, np.full(400, 0.2)) == pytest.approx(80.0)


def test_a_gain_in_one_place_counts_for_nothing():
    falls = np.full(400, -0.01)
    falls[120:180] = 1.0
    assert lasting_gain(float(falls.sum()), falls) < 0.0


def test_both_ends_of_a_half_turn_may_gain_more_than_its_middle():
    falls = np.linspace(-1.0, 1.0, 400) ** 2
    total = float(falls.sum())
    assert lasting_gain(total, falls) == pytest.approx(total)


@pytest.mark.parametrize("heading", [-2.0, -1.0, 0.0, 1.0])
def test_soft_iron_on_half_a_turn_is_not_taken_for_outliers(heading):
    robot = Robot(soft_iron=np.diag([0.05, -0.05, 0.0]))
    motion = turn(arc=math.pi, start_rpy=(0.0, 0.0, heading))
    estimate = fit(measure(robot, motion, np.random.default_rng(11)), robot.knowledge())
    assert estimate.figures["soft_iron"] == 1.0
    assert estimate.inliers.mean() > 0.95


@pytest.mark.parametrize("seed", [8, 39, 43])
def test_a_disturbance_that_passes_a_wobbling_robot_is_no_soft_iron(seed):
    robot, rng = Robot(), np.random.default_rng([1, seed])
    heading = rng.uniform(-math.pi, math.pi)
    lean = smooth_wobble(rng, 500, 15.0, 5 * DEGREE)
    motion = turn(duration=15.0, start_rpy=(0.0, 0.0, heading), wobble=lean)
    passing = Trouble(disturbance=0.03 * robot.strength)
    estimate = fit(measure(robot, motion, rng, trouble=passing), robot.knowledge())
    assert estimate.figures["soft_iron"] == 0.0


def test_a_wobble_does_not_look_like_soft_iron():
    robot, doubted = Robot(), []
    for seed in range(6):
        rng = np.random.default_rng([12, seed])
        lean = smooth_wobble(rng, 500, 15.0, 2 * DEGREE)
        window = measure(robot, turn(arc=math.pi, wobble=lean), rng)
        doubted.append(fit(window, robot.knowledge()).figures["heading_sigma"])
    assert np.median(doubted) < 0.13 * DEGREE


def test_noise_is_not_taken_for_a_wobble_that_shows_the_dip():
    robot, rng = Robot(), np.random.default_rng([1, 20])
    motion = turn(start_rpy=(0.0, 0.0, rng.uniform(-math.pi, math.pi)))
    window = measure(robot, motion, rng)
    estimate = fit(window, robot.knowledge(math.inf, math.inf))
    assert math.sqrt(estimate.covariance[11, 11]) > 0.8 * robot.strength


def test_an_upside_down_rival_does_not_win_because_its_wobble_settled_sooner():
    robot = Robot(
        strength=50e-6,
        roll=-35.676 * DEGREE,
        pitch=24.741 * DEGREE,
        hard_iron=np.array([-1.07e-6, -0.64e-6, 0.57e-6]),
        noise_field=0.0,
        noise_force=0.0,
    )
    motion = turn(arc=183 * DEGREE, samples=200, start_rpy=(0.0, 0.0, 1.5))
    window = measure(robot, motion, np.random.default_rng(1))
    # Without a gyro the two cannot be told apart; what may not happen is that the wrong one wins.
    with pytest.raises(Refusal) as refused:
        fit(window, robot.knowledge())
    assert refused.value.reason is Reason.AMBIGUOUS


def test_noise_is_not_taken_for_a_wobble_where_the_reference_is_loose():
    robot, axes = Robot(), []
    for seed in range(8):
        rng = np.random.default_rng([14, seed])
        window = measure(robot, turn(start_rpy=(0.0, 0.0, rng.uniform(0.0, 6.0))), rng)
        axes.append(fit(window, robot.knowledge(1.5e-6, DEGREE)).message)
    assert sum("rigid" in words for words in axes) >= 7
