"""The size of gravity in the specific force of a sensor that is moved."""

import math
import tracemalloc

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from magcal_ros.core.samples import gravity_size


def moved_by_hand(seed, acceleration):
    """Return time, specific force and rates of a sensor that is moved to and fro and rotated."""
    rng = np.random.default_rng(seed)
    time = np.arange(0.0, 40.0, 0.02)
    frequency, phase = rng.uniform(0.3, 1.5, (3, 3, 1)), rng.uniform(0.0, math.tau, (3, 3, 1))
    moved = acceleration * np.sin(math.tau * frequency * time + phase).sum(axis=0).T
    rate = 0.5 * np.sin(math.tau * rng.uniform(0.05, 0.3, 3) * time[:, None])
    attitude, force = Rotation.identity(), []
    for turned, added in zip(rate, moved, strict=True):
        force.append(attitude.inv().apply(added + np.array([0.0, 0.0, 9.80665])))
        attitude = attitude * Rotation.from_rotvec(turned * 0.02)
    return time, np.array(force), rate


@pytest.mark.parametrize("seed", range(3))
def test_linear_acceleration_is_no_error_of_the_accelerometer(seed):
    """A hand's acceleration makes the samples longer than gravity by a tenth and more."""
    time, force, rate = moved_by_hand(seed, 4.0)
    assert np.median(np.linalg.norm(force, axis=1)) > 10.8
    assert gravity_size(time, force, rate) == pytest.approx(9.807, rel=0.02)


@pytest.mark.parametrize("factor", [0.5, 0.8, 1.3, 2.0])
def test_an_error_of_the_accelerometer_stays_visible_while_it_is_moved(factor):
    time, force, rate = moved_by_hand(7, 2.0)
    assert abs(gravity_size(time, factor * force, rate) / 9.807 - 1.0) > 0.1


def test_without_a_gyro_the_usual_length_is_returned():
    time, force, _ = moved_by_hand(7, 2.0)
    assert gravity_size(time, force, None) == np.median(np.linalg.norm(force, axis=1))


def test_a_jump_of_the_clock_takes_no_memory():
    """The means over four seconds were searched in all of the time between, here 50 years."""
    time, force, rate = moved_by_hand(7, 2.0)
    time[1000:] += 1.6e9
    tracemalloc.start()
    assert gravity_size(time, force, rate) == pytest.approx(9.807, rel=0.1)
    most = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert most < 1e8
