"""A robot at rest with engine vibration shows the gyro's bias."""

import math

import numpy as np
import pytest
from long_form import first_of

from magcal_ros.core.samples import ImuSample
from magcal_ros.core.up import REST, BlockMeans, ShakenRest, UpFollower

STEP = 0.02
SHAKES = 4.3
"""Hertz."""
BIAS = np.radians([0.6, -0.5, 0.4])


class Vehicle:
    """Stands, drives on or turns, shaken by its engine as `car_neu2024_gautham` is."""

    def __init__(self, seed=1, bias=BIAS):
        self.rng, self.follower = np.random.default_rng(seed), UpFollower()
        self.bias = bias
        self.stamp = self.yaw = 0.0

    def go(self, seconds, turn=0.0, acceleration=(0.0, 0.0), field=True, swing=0.0):
        """Continue, turning at a varying rate, with an acceleration in m/s²."""
        for _ in range(round(seconds / STEP)):
            self.stamp += STEP
            rate = turn * (1.0 + swing * math.sin(self.stamp))
            self.yaw += rate * STEP
            shake = math.sin(math.tau * SHAKES * self.stamp)
            force = np.array([*acceleration, 9.81]) + shake * np.array([0.6, 0.5, 0.9])
            spin = self.bias + np.array([0.13 * shake, 0.01 * shake, rate])
            force += self.rng.normal(0.0, 0.1, 3)
            spin += self.rng.normal(0.0, 0.01, 3)
            self.follower.add(ImuSample(self.stamp, tuple(force), tuple(spin)))
            if field:
                way = np.array([math.cos(self.yaw), -math.sin(self.yaw), -2.0])
                measured = 20e-6 * way + self.rng.normal(0.0, 2e-7, 3)
                self.follower.add_field(self.stamp, tuple(measured))

    @property
    def bias_error(self):
        """The farther of both axes across up, degrees a second."""
        return math.degrees(np.abs(np.array(self.follower.gyro_bias.rate) - self.bias)[:2].max())

    @property
    def lean(self):
        """By how much up is off, degrees: it stands level."""
        x, y, z = self.follower.newest
        return math.degrees(math.atan2(math.hypot(x, y), z))


@pytest.mark.parametrize("seed", first_of([1, 2, 3]))
def test_ten_seconds_show_bias_and_up(seed):
    vehicle = Vehicle(seed)
    vehicle.go(10.0)
    assert not vehicle.follower.is_at_rest
    assert vehicle.bias_error < 0.2
    assert vehicle.lean < 1.5


@pytest.mark.parametrize("seed", first_of([1, 2, 3]))
def test_a_large_bias_of_a_cheap_gyro_is_measured(seed):
    """It lies ten sigmas off what is expected of a gyro."""
    vehicle = Vehicle(seed, np.radians([3.0, -2.0, 1.0]))
    vehicle.go(10.0)
    assert vehicle.bias_error < 0.2


@pytest.mark.parametrize("seed", first_of([1, 2, 3]))
def test_circles_after_the_rest_do_not_tilt_up(seed):
    vehicle = Vehicle(seed)
    vehicle.go(14.0)
    for _ in range(5):
        vehicle.go(8.0, turn=0.3, acceleration=(0.0, 1.2))
        assert vehicle.lean < 2.5


def shown(**changes):
    """The result of six seconds of blocks; force, rate and field of each may be changed."""
    watch, stated = ShakenRest(), []
    for second in range(6):
        values = {"force": (0.1, 0.0, 0.99), "rate": (0.06, -0.03, 0.02), "field": (2.0, 1.0, -4.0)}
        values |= {name: change(second) for name, change in changes.items()}
        for _ in range(25):
            block = BlockMeans(values["force"], values["rate"], 4, 0.04)
            stated.append(watch.add(block, values["field"]))
    return [each for each in stated if each is not None]


def test_four_seconds_that_agree_show_force_and_rate():
    ((force, rate, variance),) = shown()
    assert force == pytest.approx((0.1, 0.0, 0.99))
    assert rate == pytest.approx((0.06, -0.03, 0.02))
    assert math.sqrt(variance) == pytest.approx(REST.shaken_sigma)


@pytest.mark.parametrize(
    "moved",
    [
        {"force": lambda second: (0.1 + 0.01 * second, 0.0, 0.99)},
        {"rate": lambda second: (0.06, -0.03, 0.02 * second)},
        {
            "field": lambda second: (
                2.0 * math.cos(0.05 * second),
                2.0 * math.sin(0.05 * second),
                -4.0,
            )
        },
    ],
    ids=["speeds up", "turns faster", "turns evenly"],
)
def test_a_moving_robot_shows_no_rest(moved):
    assert not shown(**moved)


def test_without_a_field_a_rest_cannot_be_distinguished_from_an_even_turn():
    vehicle = Vehicle()
    vehicle.go(15.0, field=False)
    assert vehicle.bias_error > 0.2
