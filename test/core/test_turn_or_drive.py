"""The smoother distinguishes turns on the spot from drives in any window."""

import math
from dataclasses import replace

import numpy as np
import pytest
from honesty_cases import draw_case
from long_form import first_of
from realistic_robots import by_turn, collected, drawn, motors, stop_and_go
from realistic_robots import heading_error as turn_error
from simulated.drive import Streets, random_vehicle
from simulated.legs import circles, city, joined, standing
from simulated.turns import measure, turn
from smoother.streets import BOSTON, driven, heading_error

from magcal_ros.core import Figure, Knowledge, Reason, Window, calibrate
from magcal_ros.core.calibrate import calibrate_drive
from magcal_ros.core.calibration import calibration_sigma
from magcal_ros.core.samples import log_of
from magcal_ros.core.simulation import Robot
from magcal_ros.core.smoother import DRIVES, SMALL_CIRCLE, smooth


@pytest.fixture(scope="module")
def ringed():
    """A robot that drives circles, and its window without the rest before them."""
    vehicle = random_vehicle(np.random.default_rng(7))
    robot = replace(vehicle.robot, gyro_bias=np.radians([0.1, 0.0, 0.1]))
    legs = joined(standing(5.0), circles(80.0, 4.0, 8.0))
    drive = driven(10, legs=legs, vehicle=replace(vehicle, robot=robot))
    rows = drive.time > drive.time[0] + 10.0
    return robot, Window(drive.time[rows], drive.field[rows], drive.force[rows], drive.rate[rows])


def nineteen_seconds(window, start):
    since = window.time - window.time[0] - start
    return window.take((since >= 0.0) & (since < 19.0))


@pytest.mark.nightly
def test_circles_are_recognised_as_a_drive(ringed):
    robot, window = ringed
    outcome = calibrate(window, BOSTON)
    assert outcome.verdict.accepted
    assert outcome.estimate.figures[Figure.HEADINGS_DRIVEN] == 12.0
    error = heading_error(outcome.estimate.correction, robot)
    assert error < 2.0 * math.degrees(calibration_sigma(outcome.estimate, 0.0))
    assert "of movement" in outcome.verdict.summary


@pytest.mark.nightly
@pytest.mark.parametrize("start", first_of([20.0, 0.0]))
def test_nineteen_seconds_of_circles_are_enough_for_a_drive(ringed, start):
    robot, window = ringed
    outcome = calibrate(nineteen_seconds(window, start), BOSTON)
    assert outcome.verdict.accepted
    sigma = math.degrees(calibration_sigma(outcome.estimate, 0.0))
    assert heading_error(outcome.estimate.correction, robot) < 2.0 * sigma
    assert sigma < 12.0


@pytest.mark.nightly
def test_a_large_gyro_bias_by_a_rest_does_no_harm(ringed):
    """On a steady circle a bias looks like centripetal acceleration."""
    robot, window = ringed
    rate = window.angular_rate + np.radians([3.5, 2.0, 1.9])
    unknown = calibrate(replace(window, angular_rate=rate), BOSTON)
    known = calibrate(replace(window, sigma_before=5e-4), BOSTON)
    error = heading_error(known.estimate.correction, robot)
    sigma = math.degrees(calibration_sigma(known.estimate, 0.0))
    assert known.verdict.accepted
    assert error < 2.0 * sigma
    assert sigma < 6.0
    assert error < 0.5 * heading_error(unknown.estimate.correction, robot)


@pytest.mark.parametrize("seed", first_of([8, 2, 21]))
def test_a_slow_drive_through_a_street_is_not_taken_for_a_turn_with_motors(seed):
    """Slow motion causes no force that shows, and local disturbances look like motors."""
    legs = city(np.random.default_rng(seed), 50.0, fastest=3.0)
    vehicle = random_vehicle(np.random.default_rng(seed))
    drive = driven(seed, legs=legs, vehicle=vehicle, streets=Streets(size=5e-6))
    window = Window(drive.time, drive.field, drive.force, drive.rate)
    found = smooth(window, BOSTON)
    assert found.mode in (SMALL_CIRCLE, *DRIVES)
    error = heading_error(found.posterior.correction, vehicle.robot)
    assert error < 2.0 * math.degrees(found.posterior.heading_sigma)


WRONG = {"upside down": 144, "gyro axes": 880, "large installation": 417, "iron beside": 35}
"""Turns on the spot, of the honesty benchmark, that are no good."""


@pytest.mark.parametrize("name", first_of(WRONG))
def test_faults_of_a_robot_are_not_explained_by_a_drive(name):
    _, case = draw_case(7, WRONG[name])
    assert not calibrate(case.window, case.knowledge).verdict.accepted


@pytest.mark.nightly
@pytest.mark.parametrize("turned", first_of([("even", 10), ("bent ground", 77), ("even", 73)]))
def test_a_bias_of_the_gyro_is_not_taken_for_the_acceleration_of_a_drive(turned):
    """Cheap sensors that turn on the spot without a rest, the gyro off by up to 7 degrees/s."""
    kind, number = turned
    scene, known = by_turn(kind, "cheap", "open")(number)
    estimate = calibrate(scene.window, known).estimate
    assert Figure.HEADINGS_DRIVEN not in estimate.figures
    assert turn_error(scene, estimate.correction) < 3.0 * calibration_sigma(estimate, 0.0)


@pytest.mark.nightly
def test_motors_between_rests_are_not_explained_by_a_drive():
    """A drive explains their field by the place, with a large sigma."""
    rng = np.random.default_rng([1, 2])
    scene, known = drawn(rng, stop_and_go)
    scene = motors(6e-6)(np.random.default_rng([2, 2]), scene)
    window = collected(scene.window)
    drive, outcome = calibrate_drive(log_of(window), known), calibrate(window, known)
    driven_error = turn_error(scene, drive.estimate.correction)
    error = turn_error(scene, outcome.estimate.correction)
    assert driven_error < 2.0 * calibration_sigma(drive.estimate, 0.0)
    assert error < math.radians(0.5)
    assert "between rest and turn the field changes" in outcome.verdict.summary
    assert error < 2.0 * calibration_sigma(outcome.estimate, 0.0)


@pytest.mark.nightly
@pytest.mark.parametrize("turned", [("slope", 11), ("there and back", 8)])
def test_a_gyro_bias_of_degrees_per_second_does_no_harm(turned):
    kind, number = turned
    scene, known = by_turn(kind, "cheap", "open")(number)
    outcome = calibrate(scene.window, known)
    sigma = calibration_sigma(outcome.estimate, 0.0)
    assert outcome.verdict.accepted
    assert turn_error(scene, outcome.estimate.correction) < 3.0 * sigma
    assert sigma < math.radians(1.2)


@pytest.mark.nightly
@pytest.mark.parametrize("ned", first_of([False, True]))
def test_a_drive_with_an_upside_down_accelerometer_is_refused(ned):
    drive = driven(3, 90.0)
    sign = np.array([1.0, -1.0, -1.0]) if ned else -np.ones(3)
    window = Window(drive.time, drive.field, sign * drive.force, drive.rate)
    outcome = calibrate_drive(log_of(window), BOSTON)
    assert not outcome.verdict.accepted
    assert "z points down" in outcome.verdict.summary


def of_a_drive(axes):
    """The verdict on a drive whose magnetometer has such axes."""
    drive = driven(3, 220.0)
    window = Window(drive.time, drive.field @ axes, drive.force, drive.rate)
    return calibrate_drive(log_of(window), BOSTON)


@pytest.mark.nightly
def test_a_drive_whose_magnetometer_has_other_axes_is_refused_for_them():
    outcome = of_a_drive(np.diag([1.0, -1.0, -1.0]))
    assert outcome.reason is Reason.AXES_DISAGREE
    assert "axes" in outcome.verdict.summary


@pytest.mark.nightly
def test_a_drive_with_correct_axes_is_not_refused():
    assert of_a_drive(np.eye(3)).verdict.accepted


@pytest.mark.nightly
@pytest.mark.parametrize("case", [(4, 60.0), (5, 170.0)])
def test_swapped_axes_on_a_drive_are_not_taken_for_a_small_circle(case):
    drive = driven(*case)
    window = Window(drive.time, drive.field[:, [1, 0, 2]], drive.force, drive.rate)
    outcome = calibrate(window, BOSTON)
    assert not outcome.verdict.accepted
    assert "check that the axes of both sensors match" in outcome.verdict.summary


def test_a_drive_without_a_gyro_is_refused_in_words():
    """An assertion failed."""
    window = measure(Robot(), turn(samples=50), np.random.default_rng(1))
    outcome = calibrate_drive(window, Knowledge())
    assert "needs a gyro" in outcome.verdict.summary
