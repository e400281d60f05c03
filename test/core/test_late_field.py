"""A field with late stamps is not taken for that of motors, and does not reverse the heading."""

import math
from dataclasses import replace

import numpy as np
import pytest
from long_form import first_of
from realistic_robots import SENSORS, collected, drawn, driven, evenly, heading_error, late
from simulated.drive import Vehicle, simulated_drive
from simulated.legs import Leg
from simulated.travel import travel
from simulated.turns import measure

from magcal_ros.core import Figure, Window, calibrate
from magcal_ros.core.calibration import predicted_heading_sigma
from magcal_ros.core.geometry import interpolated
from magcal_ros.core.simulation import DEGREE, LEVEL_TILT, Robot, heading_errors

pytestmark = pytest.mark.usefixtures("right_axes")

ROBOT = Robot(noise_field=0.3e-6, noise_force=0.05, noise_rate=2e-3)


@pytest.mark.nightly
@pytest.mark.parametrize("seconds", first_of([0.25, 0.1]))
def test_a_late_field_between_rests_is_not_taken_for_motors(seconds):
    """A level turn shows a late field in its starts and stops alone, as it does motors."""
    motion = driven(evenly, math.tau, (0.0, 0.0, 0.0), np.zeros((1, 3)))
    window = measure(ROBOT, motion, np.random.default_rng(7), gyro=True)
    field = interpolated(window.time - seconds, window.time, window.field)
    knowledge = replace(ROBOT.knowledge(1.5e-6, 1.0 * DEGREE), exact_sensors=False)
    outcome = calibrate(collected(replace(window, field=field)), knowledge)
    gap = heading_errors(outcome.estimate.correction, ROBOT)[:, LEVEL_TILT]
    error = math.sqrt(np.mean(gap**2))
    assert outcome.estimate.figures[Figure.LATENCY] == pytest.approx(seconds, abs=0.03)
    assert error < 1.0 * DEGREE
    assert error < 3.0 * predicted_heading_sigma(outcome.estimate)


@pytest.mark.nightly
def test_a_reversed_level_field_is_not_taken_for_soft_iron():
    """The robot sways while its field is late: an error of 177 degrees was an optimum."""
    scene, knowledge = drawn(np.random.default_rng([7, 5002]), evenly)
    scene = SENSORS["typical"](np.random.default_rng([8, 5002]), scene)
    scene = late(0.35)(np.random.default_rng(0), scene)
    outcome = calibrate(collected(scene.window), knowledge)
    error = heading_error(scene, outcome.estimate.correction)
    assert error < 3.0 * predicted_heading_sigma(outcome.estimate)


@pytest.mark.parametrize("seed", first_of([21, 20, 30]))
def test_weak_motors_in_proportion_to_the_rate_are_not_taken_for_a_late_field(seed):
    """Between rests at one heading both give the same step; starts and stops differ."""
    rng = np.random.default_rng(seed)
    legs = [Leg(6.0), Leg(25.0, turn_rate=math.tau / 25.0), Leg(6.0)]
    truth = travel(legs, rng, rate=50.0, heading=rng.uniform(-3.0, 3.0))
    drive = simulated_drive(truth, rng, Vehicle(ROBOT), streets=None, wheels=None, receiver=None)
    rate = np.gradient(truth.yaw, truth.period)
    added = 3e-6 * np.outer(rate / rate.max(), [0.0, 1.0, 0.0])
    window = Window(drive.time, drive.field + added, drive.force, drive.rate)
    knowledge = replace(ROBOT.knowledge(0.5e-6, 0.5 * DEGREE), exact_sensors=False)
    outcome = calibrate(collected(window), knowledge)
    gap = heading_errors(outcome.estimate.correction, ROBOT)[:, LEVEL_TILT]
    assert math.sqrt(np.mean(gap**2)) < 0.5 * DEGREE
    assert abs(outcome.estimate.figures[Figure.LATENCY]) < 0.02
