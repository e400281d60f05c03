"""A robot that drives a small circle smoothly, instead of turning on the spot."""

import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from uneven_turns import ROBOT as FLAT
from uneven_turns import collected, driven, evenly

from magcal_ros.core import Figure, Window, calibrate
from magcal_ros.core.calibration import predicted_heading_sigma
from magcal_ros.core.simulation import DEGREE, LEVEL_TILT, heading_errors

pytestmark = pytest.mark.usefixtures("right_axes")

ROBOT = replace(FLAT, inclination=68.0 * DEGREE)


def judged(course, rest, radius=2.5, *, inwards=(0.8, 0.6, 0.0), wheels=None, forward=None):
    motion, window = driven(course, ROBOT, rest)
    rate = motion.angular_rate[:, 2]
    acceleration = np.outer(radius * rate**2, inwards)
    force = window.specific_force + acceleration
    speed = None if wheels is None else wheels * radius * rate
    samples = window.time, window.field, force, window.angular_rate
    pulled = collected(Window(*samples, speed=speed))
    faultless = ROBOT.knowledge(1.5e-6, 1.0 * DEGREE)
    knowledge = replace(faultless, exact_sensors=False)
    if forward is not None:
        mounting = replace(knowledge.mounting, forward=np.array(forward))
        knowledge = replace(knowledge, mounting=mounting)
    outcome = calibrate(pulled, knowledge)
    gap = heading_errors(outcome.estimate.correction, ROBOT)[:, LEVEL_TILT]
    sigma = predicted_heading_sigma(outcome.estimate, 0.0)
    return math.sqrt(np.mean(gap**2)), sigma, outcome


@cache
def beside_a_rest():
    return judged(evenly, 3.0)


def test_a_rest_next_to_the_circle_determines_the_acceleration():
    error, sigma, outcome = beside_a_rest()
    assert error < 0.8 * DEGREE
    assert error < 3.0 * sigma
    assert outcome.estimate.figures[Figure.STEADY_ACCELERATION] == pytest.approx(
        2.5 * (1.05 * math.tau / 20.0) ** 2 / 9.81, rel=0.2
    )
    assert outcome.estimate.figures[Figure.POSSIBLE_ACCELERATION] < 0.3 * sigma


@pytest.mark.nightly
def test_without_a_rest_the_acceleration_is_in_the_sigma():
    error, sigma, outcome = judged(lambda time: 1.0 + 0.0 * time, 0.0, radius=1.5)
    assert error > 1.0 * DEGREE
    assert error < 3.0 * sigma
    assert outcome.estimate.figures[Figure.POSSIBLE_ACCELERATION] > 0.7 * sigma


CIRCLE = {"course": lambda time: 1.0 + 0.0 * time, "rest": 0.0, "inwards": (0.0, 1.0, 0.0)}


@cache
def on_the_circle():
    return judged(**CIRCLE)


@pytest.mark.nightly
def test_an_imu_that_is_mounted_sideways_is_in_the_sigma_of_a_circle_by_wheels():
    """Ahead is its y axis, which a parameter may say."""
    sideways = CIRCLE | {"inwards": (-1.0, 0.0, 0.0), "wheels": 1.0}
    error, sigma, _ = judged(**sideways)
    assert error < 2.0 * sigma
    reported, smaller, _ = judged(**sideways, forward=(0.0, 1.0, 0.0))
    assert reported < 2.0 * smaller
    assert smaller < 0.8 * sigma


@pytest.mark.nightly
def test_without_a_rest_the_speed_of_wheels_determines_the_acceleration():
    error, sigma, _ = on_the_circle()
    by_wheels, smaller, _ = judged(**CIRCLE, wheels=1.0)
    assert by_wheels < 0.5 * error
    assert smaller < 0.7 * sigma
    assert by_wheels < 3.0 * smaller


def test_a_speed_that_is_always_zero_is_not_used():
    error, sigma, _ = beside_a_rest()
    with_zeros, same, _ = judged(evenly, 3.0, wheels=0.0)
    assert (with_zeros, same) == (error, sigma)
