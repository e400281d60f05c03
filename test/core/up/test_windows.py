from dataclasses import replace

import numpy as np
import pytest
from simulated.turns import Motion, measure, turn

from magcal_ros.core import Window
from magcal_ros.core.simulation import DEGREE, UP_ENU, Robot
from magcal_ros.core.up import propagated_up


def away_deg(found, motion):
    true = motion.attitude @ UP_ENU
    sine = np.linalg.norm(np.cross(found, true), axis=1)
    return np.degrees(np.sqrt(np.mean(sine**2)))


def test_a_steady_sideways_acceleration_is_averaged_out():
    robot = Robot(noise_rate=1e-3)
    motion = turn(arc=6.0 * np.pi, samples=1500, duration=60.0)
    window = measure(robot, motion, np.random.default_rng(2), gyro=True)
    accelerated = window.specific_force + np.array([0.0, 1.2, 0.0])
    window = Window(window.time, window.field, accelerated, window.angular_rate)
    assert away_deg(accelerated / np.linalg.norm(accelerated, axis=1)[:, None], motion) > 6.0
    assert away_deg(propagated_up(window), motion) < 1.5


def test_without_a_gyro_up_is_by_the_accelerometer_alone():
    motion = turn()
    window = measure(Robot(), motion, np.random.default_rng(3))
    assert away_deg(propagated_up(window), motion) < 1.2


def test_forces_in_another_unit_have_a_direction():
    """With milli-g published as m/s², the report on the turn ended with an AssertionError."""
    motion = turn()
    window = measure(Robot(), motion, np.random.default_rng(3), gyro=True)
    window = replace(window, specific_force=100.0 * window.specific_force)
    assert away_deg(propagated_up(window), motion) < 1.2


@pytest.mark.parametrize("row", [0, 60, -1])
@pytest.mark.parametrize("force", [(600.0, 0.0, 0.0), (0.02, 0.0, 0.0)])
def test_a_shock_or_a_fall_does_not_end_the_fit(row, force):
    motion = turn()
    window = measure(Robot(noise_rate=1e-3), motion, np.random.default_rng(3), gyro=True)
    forces = window.specific_force.copy()
    forces[row] = force
    found = propagated_up(replace(window, specific_force=forces))
    others = np.delete(np.arange(len(window)), row)
    assert away_deg(found[others], Motion(motion.time[others], motion.attitude[others])) < 1.2


def test_a_large_bias_by_a_rest_is_used_after_it():
    """The forward pass learns it at rest; the backward pass starts at a stop."""
    circling = turn(arc=6.0 * np.pi, samples=1500, duration=60.0)
    first, last = circling.attitude[0], circling.attitude[-1]
    ways = [np.broadcast_to(first, (500, 3, 3)), circling.attitude]
    ways.append(np.broadcast_to(last, (20, 3, 3)))
    attitude = np.concatenate(ways)
    motion = Motion(np.arange(len(attitude)) * 0.04, attitude)
    robot = Robot(noise_rate=1e-3, gyro_bias=np.array([4.0, -3.0, 1.0]) * DEGREE)
    window = measure(robot, motion, np.random.default_rng(2), gyro=True)
    acceleration = np.zeros((len(attitude), 3))
    acceleration[500:2000, 1] = 1.2
    accelerated = replace(window, specific_force=window.specific_force + acceleration)
    assert away_deg(propagated_up(accelerated), motion) < 0.2
