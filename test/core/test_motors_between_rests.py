"""A turn between two rests is on the spot, whatever the field of the motors."""

import math
from dataclasses import replace

import numpy as np
import pytest
from long_form import first_of
from realistic_robots import heading_error, with_motors
from remembered import remembered
from uneven_turns import ROBOT, collected, driven, evenly

from magcal_ros.core import Figure, calibrate, check
from magcal_ros.core.calibration import MotorState, predicted_heading_sigma
from magcal_ros.core.simulation import DEGREE, LEVEL_TILT, heading_errors

pytestmark = pytest.mark.usefixtures("right_axes")

KNOWLEDGE = replace(ROBOT.knowledge(1.5e-6, 1.0 * DEGREE), exact_sensors=False)


@remembered
def fitted(size, by_rate):
    """Return the result of a turn, and the largest rate of the motors, whose field has a size."""
    motion, window = driven(evenly, ROBOT, 6.0)
    rate = motion.angular_rate[:, 2]
    full = float(np.abs(rate).max())
    shape = rate / full if by_rate else (np.abs(rate) > 0.02).astype(float)
    field = window.field + size * np.outer(shape, [0.6, -0.8, 0.0])
    return calibrate(collected(replace(window, field=field)), KNOWLEDGE), full


@pytest.mark.parametrize(
    "case", first_of([(6e-6, True), (15e-6, False), (3e-6, True), (3e-6, False), (15e-6, True)])
)
def test_the_heading_at_rest_is_correct_and_the_motors_are_reported(case):
    size, by_rate = case
    outcome, _ = fitted(size, by_rate)
    gap = heading_errors(outcome.estimate.correction, ROBOT)[:, LEVEL_TILT]
    error, figures = math.sqrt(np.mean(gap**2)), outcome.estimate.figures
    assert error < 0.5 * DEGREE
    assert error < 3.0 * predicted_heading_sigma(outcome.estimate, 0.0)
    assert Figure.HEADINGS_DRIVEN not in figures
    assert figures[Figure.ON_THE_SPOT] > 0.8
    assert figures[Figure.MOTOR_FIELD] == pytest.approx(size, rel=0.1)
    assert "between rest and turn the field changes" in outcome.verdict.summary


@pytest.mark.parametrize("case", first_of([("in step", 20e-6, 504), ("switching", 10e-6, 3000)]))
def test_a_badly_explained_turn_on_the_spot_is_not_taken_for_a_drive(case):
    """Drives with errors of 17 and 65 degrees, at sigmas of 1.9 and .5, were accepted."""
    shape, size, number = case
    scene, knowledge = with_motors(shape, size)(number)
    outcome = calibrate(collected(scene.window), knowledge)
    assert Figure.HEADINGS_DRIVEN not in outcome.estimate.figures
    sigma = predicted_heading_sigma(outcome.estimate)
    error = heading_error(scene, outcome.estimate.correction)
    assert not outcome.verdict.accepted or error < 3.0 * sigma


@pytest.mark.parametrize("by_rate", first_of([True, False]))
def test_the_motor_field_is_kept_with_its_covariance(by_rate):
    """A turn at one rate shows the sum of step, side and rate well, the rest by its start only."""
    size = 6e-6
    outcome, full = fitted(size, by_rate)
    motors = outcome.calibration.motors
    for turn_rate, least, most in ((full, 0.02e-6, 0.5e-6), (0.0, 0.2e-6, 6e-6)):
        inputs, _ = motors.known(MotorState(1.0, turn_rate, side=1.0))
        u = np.kron(inputs, np.eye(3))
        found = u @ motors.gain.ravel()
        sigma = np.sqrt(np.diag(u @ motors.covariance @ u.T))
        true = size * np.array([0.6, -0.8, 0.0]) * (turn_rate / full if by_rate else 1.0)
        assert (sigma > least).all()
        assert (sigma < most).all()
        assert (np.abs(found - true) < 3.0 * sigma).all()


def test_a_robot_without_motors_has_no_motor_field():
    _, window = driven(evenly, ROBOT, 6.0)
    knowledge = replace(ROBOT.knowledge(1.5e-6, 1.0 * DEGREE), exact_sensors=False)
    motors = calibrate(collected(window), knowledge).calibration.motors
    assert np.abs(motors.gain).max() < 0.15e-6
    assert motors.sigma(0) < 0.3e-6


def test_a_saturated_magnetometer_is_reported():
    _, window = driven(evenly, ROBOT, 6.0)
    knowledge = replace(ROBOT.knowledge(1.5e-6, 1.0 * DEGREE), exact_sensors=False)
    limit = float(np.quantile(np.abs(window.field[:, 0]), 0.7))
    field = np.clip(window.field, -limit, limit)
    outcome = calibrate(collected(replace(window, field=field)), knowledge)
    assert not outcome.verdict.accepted
    assert "saturates" in outcome.verdict.summary


def test_an_axis_always_at_its_limit_gives_no_calibration():
    """On the level it looked like hard iron along the axis, of excellent quality."""
    level = replace(ROBOT, roll=0.0, pitch=0.0)
    _, window = driven(evenly, level, 6.0)
    knowledge = replace(level.knowledge(1.5e-6, 1.0 * DEGREE), exact_sensors=False)
    field = window.field * [1.0, 1.0, 0.0]
    outcome = calibrate(collected(replace(window, field=field)), knowledge)
    assert not outcome.verdict.accepted
    assert "its range ends" in outcome.verdict.summary


@pytest.mark.nightly
def test_motors_of_half_the_level_field_are_no_reason_to_refuse():
    motion, window = driven(evenly, ROBOT, 6.0)
    runs = (np.abs(motion.angular_rate[:, 2]) > 0.02).astype(float)
    field = window.field + 25e-6 * np.outer(runs, [0.6, -0.8, 0.0])
    knowledge = replace(ROBOT.knowledge(1.5e-6, 1.0 * DEGREE), exact_sensors=False)
    outcome = calibrate(collected(replace(window, field=field)), knowledge)
    assert outcome.verdict.accepted
    assert "subtracts this field while the robot moves" in outcome.verdict.summary
    gap = heading_errors(outcome.estimate.correction, ROBOT)[:, LEVEL_TILT]
    assert math.sqrt(np.mean(gap**2)) < 3.0 * predicted_heading_sigma(outcome.estimate)


@pytest.mark.nightly
@pytest.mark.parametrize("by_rate", first_of([True, False]))
def test_without_a_gyro_the_unobservable_motor_field_is_reported(by_rate):
    """The sigma was half as large: an even start seemed to determine the angle."""
    motion, window = driven(evenly, ROBOT, 6.0)
    rate = motion.angular_rate[:, 2]
    shape = rate / np.abs(rate).max() if by_rate else (np.abs(rate) > 0.02).astype(float)
    field = window.field + 7e-6 * np.outer(shape, [0.6, -0.8, 0.0])
    knowledge = replace(ROBOT.knowledge(1.5e-6, 1.0 * DEGREE), exact_sensors=False)
    blind = replace(collected(replace(window, field=field)), angular_rate=None)
    outcome = calibrate(blind, knowledge)
    gap = heading_errors(outcome.estimate.correction, ROBOT)[:, LEVEL_TILT]
    assert math.sqrt(np.mean(gap**2)) < 3.0 * predicted_heading_sigma(outcome.estimate)
    assert "without a gyro, a part of it cannot be measured" in "; ".join(outcome.verdict.reasons)


def test_a_check_does_not_take_the_motors_for_a_change_of_the_robot():
    """The calibration is right at rest; the motors turn the compass only while the robot turns."""
    scene, knowledge = with_motors("by rate", 7e-6)(303000)
    window = collected(scene.window)
    found = calibrate(window, knowledge).calibration
    right = replace(found, correction=scene.robot.true_correction)
    result = check(window, right)
    swing, gyro, *_ = result.findings
    assert swing.value < 2.0
    assert result.state == "doubtful"
    assert not gyro.is_judged
    assert "iron nearby or the motors change the field" in gyro.words
