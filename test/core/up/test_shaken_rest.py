"""A robot that stands while its engine shakes it shows the gyro's bias all the same."""

import math

import numpy as np
import pytest

from magcal_ros.core.samples.streams import ImuSample
from magcal_ros.core.up import UpFollower

STEP = 0.02
SHAKES = 4.3
"""Hertz."""
BIAS = np.radians([0.6, -0.5, 0.4])


class Vehicle:
    """Stands, drives on or turns, shaken by its engine as `car_neu2024_gautham` is."""

    def __init__(self, seed=1):
        self.rng, self.follower = np.random.default_rng(seed), UpFollower()
        self.stamp = self.yaw = 0.0

    def go(self, seconds, turn=0.0, pull=(0.0, 0.0), field=True, swing=0.0):
        """Live on, turning at a rate that swings by a share of it, pulled by m/s²."""
        for _ in range(round(seconds / STEP)):
            self.stamp += STEP
            rate = turn * (1.0 + swing * math.sin(self.stamp))
            self.yaw += rate * STEP
            shake = math.sin(math.tau * SHAKES * self.stamp)
            force = np.array([*pull, 9.81]) + shake * np.array([0.6, 0.5, 0.9])
            spin = BIAS + np.array([0.13 * shake, 0.01 * shake, rate])
            force += self.rng.normal(0.0, 0.1, 3)
            spin += self.rng.normal(0.0, 0.01, 3)
            self.follower.add(ImuSample(self.stamp, tuple(force), tuple(spin)))
            if field:
                way = np.array([math.cos(self.yaw), -math.sin(self.yaw), -2.0])
                measured = 20e-6 * way + self.rng.normal(0.0, 2e-7, 3)
                self.follower.add_field(self.stamp, tuple(measured))

    @property
    def bias_error(self):
        """The farthest of the three axes, degrees a second."""
        return math.degrees(np.abs(np.array(self.follower.gyro_bias.rate) - BIAS).max())

    @property
    def lean(self):
        """By how much up is off, degrees: it stands level."""
        x, y, z = self.follower.newest
        return math.degrees(math.atan2(math.hypot(x, y), z))


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_ten_seconds_show_bias_and_up(seed):
    vehicle = Vehicle(seed)
    vehicle.go(10.0)
    assert not vehicle.follower.is_at_rest
    assert vehicle.bias_error < 0.2
    assert vehicle.lean < 1.5


def test_long_ones_show_them_for_a_turn_to_come():
    vehicle = Vehicle()
    vehicle.go(30.0)
    told = vehicle.follower.gyro_at_rest
    assert np.abs(np.array(told.rate) - BIAS).max() < 3.0 * told.sigma


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_circles_after_it_do_not_tilt_up(seed):
    vehicle = Vehicle(seed)
    vehicle.go(14.0)
    for _ in range(5):
        vehicle.go(8.0, turn=0.3, pull=(0.0, 1.2))
        assert vehicle.lean < 2.5


@pytest.mark.parametrize("turn", [0.05, -0.3])
def test_an_even_turn_is_no_rest(turn):
    vehicle = Vehicle()
    vehicle.go(20.0, turn=turn, pull=(0.0, 4.0 * turn))
    assert vehicle.follower.gyro_at_rest is None


def test_without_a_field_nobody_tells_it_from_an_even_turn():
    vehicle = Vehicle()
    vehicle.go(15.0, field=False)
    assert vehicle.follower.gyro_at_rest is None
