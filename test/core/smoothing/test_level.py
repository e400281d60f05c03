"""Up along a drive, and the gyro's bias, against rides whose up is known."""

import math

import numpy as np
import pytest

from magcal_ros.core.geometry.attitude import STANDARD_GRAVITY, unit
from magcal_ros.core.geometry.rotations import rotation_about, rotation_from_rpy
from magcal_ros.core.smoothing.level import ForceLog, Leans, gyro_bias, level_of
from magcal_ros.core.smoothing.tuning import TUNING

UP = np.array([0.0, 0.0, 1.0])
SLOPE = rotation_from_rpy(math.radians(3.0), math.radians(-2.0))


def ride(turn_rate, speed, bias=(0.0, 0.0, 0.0), seed=1, jolts=0.5):
    """Time, force, rate and up of a vehicle on a slope: it turns and travels as it is told."""
    time = TUNING.row * np.arange(len(turn_rate))
    yaw = np.concatenate([[0.0], np.cumsum(0.5 * (turn_rate[1:] + turn_rate[:-1]) * TUNING.row)])
    up = np.swapaxes(rotation_about(UP, yaw), 1, 2) @ SLOPE.T @ UP
    own = np.column_stack([np.gradient(speed, time), speed * turn_rate, np.zeros(len(time))])
    rng = np.random.default_rng(seed)
    force = STANDARD_GRAVITY * up + own + rng.normal(0.0, jolts, (len(time), 3))
    rate = np.column_stack([np.zeros((len(time), 2)), turn_rate]) + np.array(bias)
    return time, force, rate + rng.normal(0.0, 2e-3, rate.shape), up


def city(seconds=300.0):
    """Bends of a quarter turn either way between straight streets; stops on the way."""
    time = np.arange(0.0, seconds, TUNING.row)
    bends = np.where(time % 20.0 < 5.0, 0.1 * math.pi, 0.0)
    bends *= np.where(time // 20.0 % 3.0 == 1.0, -1.0, 1.0)
    speed = 6.0 + 3.0 * np.sin(2.0 * math.pi * time / 23.0)
    return bends, speed


def circles(seconds=60.0, rate=0.35, speed=3.5):
    count = round(seconds / TUNING.row)
    return np.full(count, rate), np.full(count, speed)


def degrees_off(up, truth):
    return np.degrees(np.arccos(np.clip(np.sum(up * truth, axis=1), -1.0, 1.0)))


def bias_of(time, force, rate):
    over_gravity = force / np.median(np.linalg.norm(force, axis=1))
    seen = ForceLog(time, over_gravity, rate, np.ones(len(time)), np.array([0]))
    return gyro_bias(seen, Leans.travelling()).rate


@pytest.mark.parametrize("rate", [0.3, -0.5])
def test_steady_circles_lean_up_by_no_degree(rate):
    time, force, rates, truth = ride(*circles(rate=rate))
    leans = degrees_off(unit(force), truth)
    assert np.median(leans) > 5.0
    off = degrees_off(level_of(time, force, rates).up, truth)
    assert np.median(off) < 0.7
    assert off.max() < 3.0


def test_starts_stops_and_bends_lean_up_by_little():
    time, force, rate, truth = ride(*city())
    off = degrees_off(level_of(time, force, rate).up, truth)
    assert np.percentile(off, 90.0) < 1.5


@pytest.mark.parametrize("bias", [(3.5, 2.0, 1.9), (-1.0, 0.0, 0.0), (0.0, 5.0, 0.0)])
def test_a_large_bias_is_found_where_streets_are_straight_for_a_while(bias):
    time, force, rate, truth = ride(*city(), bias=np.radians(bias))
    found = np.degrees(bias_of(time, force, rate))
    assert found[:2] == pytest.approx(bias[:2], abs=0.1)
    off = degrees_off(level_of(time, force, rate).up, truth)
    assert np.percentile(off, 90.0) < 2.0


def test_the_pull_of_a_circle_is_no_bias():
    time, force, rate, _ = ride(*circles())
    assert np.linalg.norm(np.degrees(bias_of(time, force, rate))) < 0.1


def test_a_usual_bias_in_circles_stays_usual():
    time, force, rate, truth = ride(*circles(), bias=np.radians([0.1, -0.1, 0.1]))
    assert np.linalg.norm(np.degrees(bias_of(time, force, rate)[:2])) < 0.3
    assert np.median(degrees_off(level_of(time, force, rate).up, truth)) < 1.5


def test_who_stands_has_the_mean_of_the_force_for_up():
    time, force, rate, truth = ride(np.zeros(600), np.zeros(600), jolts=0.05)
    assert degrees_off(level_of(time, force, rate).up, truth).max() < 0.3


def test_a_small_steady_circle_is_not_taken_for_standing_with_a_bias():
    time, force, rate, truth = ride(*circles(rate=0.8, speed=0.5), jolts=0.05)
    assert np.median(degrees_off(unit(force), truth)) > 2.0
    assert np.median(degrees_off(level_of(time, force, rate).up, truth)) < 0.3


@pytest.mark.parametrize("rows", [1, 2, 3, 12])
def test_a_few_rows_have_an_up_too(rows):
    time, force, rate, truth = ride(np.zeros(rows + 2), np.zeros(rows + 2))
    up = level_of(time[:rows], force[:rows], rate[:rows]).up
    assert np.linalg.norm(up, axis=1) == pytest.approx(np.ones(rows))
    assert degrees_off(up, truth[:rows]).max() < 10.0
