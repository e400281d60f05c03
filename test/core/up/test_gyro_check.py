import math

import numpy as np

from magcal_ros.core.up.gyro_check import GyroCheck

STEP = 0.04


def nodding(check, sense, seconds=20.0, noise=0.002, seed=1):
    rng = np.random.default_rng(seed)
    for k in range(int(seconds / STEP)):
        angle, rate = 0.15 * math.sin(k * STEP), 0.15 * math.cos(k * STEP)
        force = np.array([0.0, math.sin(angle), math.cos(angle)])
        check.add(tuple(force + noise * rng.standard_normal(3)), (sense * rate * STEP, 0, 0), STEP)


def test_a_gyro_that_turns_as_the_accelerometer_is_believed():
    check = GyroCheck()
    nodding(check, 1.0)
    assert check.is_believed


def test_a_mirrored_gyro_is_not_until_it_is_put_right():
    check = GyroCheck()
    nodding(check, -1.0)
    assert not check.is_believed
    nodding(check, 1.0, seconds=120.0)
    assert check.is_believed


def test_a_steady_circle_says_nothing():
    check = GyroCheck()
    for _ in range(1000):
        check.add((0.0, 0.15, 1.0), (0.0, 0.0, 0.5 * STEP), STEP)
    assert check.is_believed


def test_noise_alone_says_nothing():
    check = GyroCheck()
    nodding(check, 0.0, noise=0.02)
    assert check.is_believed
