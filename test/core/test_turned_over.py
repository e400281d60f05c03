"""A sensor that is tumbled by hand through all orientations."""

import functools
import math
from dataclasses import replace

import numpy as np
import pytest
from long_form import first_of
from scipy.spatial.transform import Rotation
from simulated.turns import Motion, measure

from magcal_ros.core import Knowledge, Reason, Refusal, calibrate
from magcal_ros.core.assessment import LEVEL_ONLY, WHICH_WAY_UP
from magcal_ros.core.doctor import with_explanation
from magcal_ros.core.samples import gravity_size, was_turned_over
from magcal_ros.core.simulation import Robot, heading_errors

ROBOT = Robot()


def turned_over(seed, seconds=25.0, size=1.0, step=0.04):
    """Return the movement of a hand: slow turns about axes that wander, from an upright rest."""
    rng = np.random.default_rng(seed)
    time = np.arange(0.0, seconds, step)
    frequency, phase = rng.uniform(0.03, 0.15, (2, 3, 3))[0], rng.uniform(0.0, math.tau, (3, 3))
    rate = size * np.sin(math.tau * frequency * time[:, None, None] + phase).sum(axis=2)
    rate *= np.clip(time / 3.0 - 1.0, 0.0, 1.0)[:, None]
    attitude, attitudes = Rotation.identity(), []
    for turned in Rotation.from_rotvec(rate * step):
        attitudes.append(attitude.as_matrix())
        attitude = turned * attitude
    return Motion(time, np.array(attitudes))


@functools.cache
def window_of(seed):
    return measure(ROBOT, turned_over(seed), np.random.default_rng(seed), gyro=True)


@functools.cache
def outcome_of(seed):
    return calibrate(window_of(seed), Knowledge())


@pytest.mark.parametrize("seed", first_of([1, 3]))
def test_a_tumble_is_calibrated_without_a_reference(seed):
    outcome = outcome_of(seed)
    assert outcome.verdict.accepted, outcome.verdict.summary
    # A level field to the south is the same world, rotated by half a turn.
    assert abs(outcome.estimate.inclination) < 0.5 * math.pi
    errors = heading_errors(outcome.calibration.correction, ROBOT)
    assert math.degrees(np.sqrt(np.mean((errors - errors.mean()) ** 2))) < 1.0


def test_of_z_only_that_it_is_unobservable_is_reported():
    assert was_turned_over(window_of(1))
    verdict = outcome_of(1).verdict
    assert not any("z points" in check.words for check in verdict.checks)
    assert WHICH_WAY_UP in verdict.not_shown
    assert LEVEL_ONLY not in verdict.not_shown


def tumbled_fast(seed):
    return measure(
        ROBOT, turned_over(seed, size=4.5, step=0.02), np.random.default_rng(seed), gyro=True
    )


def swung_about_an_elbow(seed):
    """Return a fast tumble whose accelerometer sits beside the axis of the movement."""
    window = tumbled_fast(seed)
    arm = np.random.default_rng([seed, 15]).standard_normal(3)
    arm *= 0.15 / np.linalg.norm(arm)
    rate = window.angular_rate
    spin = np.gradient(rate, window.time, axis=0)
    acceleration = np.cross(spin, arm) + np.cross(rate, np.cross(rate, arm))
    return replace(window, specific_force=window.specific_force + acceleration)


@pytest.mark.parametrize("seed", first_of(range(21, 41), 3))
def test_a_fast_tumble_by_hand_is_recognised(seed):
    window, in_place = swung_about_an_elbow(seed), tumbled_fast(seed)
    assert np.linalg.norm(window.angular_rate, axis=1).max() > 10.0
    assert was_turned_over(window) == was_turned_over(in_place)
    size = gravity_size(window.time, window.specific_force, window.angular_rate)
    assert size == pytest.approx(9.807, rel=0.02)


@pytest.mark.nightly
@pytest.mark.parametrize("seed", range(21, 41))
def test_the_verdict_of_a_fast_tumble_reports_no_wrong_axes(seed):
    window, in_place = swung_about_an_elbow(seed), tumbled_fast(seed)
    verdict = calibrate(window, Knowledge()).verdict
    if was_turned_over(in_place):
        assert not any("z points" in check.words for check in verdict.checks)
    assert not any("not gravity's" in check.words for check in verdict.checks)


def test_a_refusal_names_the_method_for_it():
    words = str(with_explanation(Refusal(Reason.AXES_DISAGREE, "the axes disagree"), window_of(1)))
    assert "ellipsoid" in words
    assert "z points" not in words


@pytest.mark.parametrize("method", first_of(["ellipsoid", "min_max"]))
def test_the_methods_for_tumbles_accept_any_median_orientation(method):
    robot = Robot(roll=0.0, pitch=0.0)
    window = measure(robot, turned_over(2), np.random.default_rng(2), gyro=True)
    verdict = calibrate(window, robot.knowledge(), method).verdict
    assert not any("z points" in words for words in verdict.reasons)


@pytest.mark.nightly
def test_a_rolling_boat_is_advised_to_turn():
    """Its z points up, and its axis of rotation is horizontal."""
    time = np.arange(0.0, 20.0, 0.1)
    roll = Rotation.from_rotvec(0.95 * np.sin(time)[:, None] * [1.0, 0.0, 0.0])
    window = measure(ROBOT, Motion(time, roll.as_matrix()), np.random.default_rng(1), gyro=False)
    assert not was_turned_over(window)
    verdict = calibrate(window, ROBOT.knowledge()).verdict
    assert not verdict.accepted
    assert not any("z points" in words for words in verdict.reasons)
