"""The field that follows the current of a battery, during a turn."""

import math
from dataclasses import replace

import numpy as np
import pytest
from currents import ELECTRONICS, LARGEST, turn_with_current
from long_form import first_of
from realistic_robots import collected, heading_error
from remembered import remembered

from magcal_ros.core import Compass, Correction, calibrate, calibrate_turns
from magcal_ros.core.calibration import MotorInput, calibration_sigma
from magcal_ros.core.heading import MotionDetector
from magcal_ros.core.samples import FieldSample, ImuSample
from magcal_ros.core.self_calibration import MotorLearning
from magcal_ros.core.session import SampleCollector

pytestmark = pytest.mark.usefixtures("right_axes", "one_fit")

SIZE = 10e-6


@remembered
def fitted(shape, number, size=SIZE, *, battery=True, **how):
    scene, known, messages = turn_with_current(shape, size, number, **how)
    outcome = calibrate(collected(scene.window, messages if battery else ()), known)
    return scene, outcome


def at_current(calibration, current):
    """Return the correction of the robot at a current, A."""
    motors = calibration.motors
    gain = motors.gain[motors.inputs.index(MotorInput.CURRENT)]
    iron = calibration.correction.hard_iron + (current - motors.reference) * gain
    return Correction(calibration.correction.matrix, iron)


@pytest.mark.parametrize("course", first_of(["even", "stops"]))
def test_a_robot_held_by_its_motors_is_calibrated_for_zero_current(course):
    scene, outcome = fitted("hold", 3, course=course)
    found = outcome.calibration
    motors = found.motors
    at = motors.inputs.index(MotorInput.CURRENT)
    # The battery's currents are negative.
    assert np.linalg.norm(motors.gain[at]) == pytest.approx(
        SIZE / LARGEST, abs=3 * motors.sigma(at)
    )
    assert motors.sigma(at) < 0.1 * SIZE / LARGEST
    error = heading_error(scene, at_current(found, -ELECTRONICS))
    assert error < 3.0 * calibration_sigma(found) < math.radians(2.0)
    _, without = fitted("hold", 3, battery=False, course=course)
    assert heading_error(scene, without.calibration.correction) > 2.0 * error


@pytest.mark.nightly
@pytest.mark.parametrize("seed", [4, 5, 6, 7])
def test_a_battery_of_one_message_a_second_shows_the_field_of_hold_currents(seed):
    scene, outcome = fitted("hold", seed, gap=1.0)
    found = outcome.calibration
    sigma = calibration_sigma(found)
    assert heading_error(scene, at_current(found, -ELECTRONICS)) < 3.0 * sigma < math.radians(6.0)
    _, without = fitted("hold", seed, battery=False)
    assert heading_error(scene, without.calibration.correction) > 3.0 * sigma


@pytest.mark.nightly
@pytest.mark.parametrize("case", first_of([("step, hold", SIZE), ("none", 0.0)]))
def test_an_irrelevant_current_does_no_harm(case):
    shape, size = case
    _, with_it = fitted(shape, 5, size)
    scene, without = fitted(shape, 5, size, battery=False)
    sigmas = [calibration_sigma(each.calibration) for each in (with_it, without)]
    assert sigmas[0] < 1.15 * sigmas[1]
    assert heading_error(scene, with_it.calibration.correction) < 3.0 * sigmas[0]
    assert MotorInput.CURRENT not in with_it.calibration.motors.inputs
    assert math.isnan(with_it.calibration.motors.reference)


def test_without_a_battery_the_motors_have_no_current():
    _, outcome = fitted("hold", 3, battery=False, course="even")
    motors = outcome.calibration.motors
    assert MotorInput.CURRENT not in motors.inputs
    assert math.isnan(motors.reference)


def test_learning_while_driving_starts_with_the_result_of_the_turn():
    _, outcome = fitted("hold", 3, course="even")
    known = outcome.calibration.motors
    learning = MotorLearning(outcome.calibration).motors
    here, there = (each.inputs.index(MotorInput.CURRENT) for each in (known, learning))
    assert learning.reference == known.reference
    assert learning.gain[there] == pytest.approx(known.gain[here], abs=0.01e-6)
    assert learning.sigma(there) == pytest.approx(known.sigma(here), rel=0.01)


def test_several_turns_share_the_reference_current():
    turns = [turn_with_current("hold", SIZE, number, course="even") for number in (3, 3)]
    windows = [collected(scene.window, messages) for scene, _, messages in turns]
    shifted = replace(windows[1].battery, reference=windows[1].battery.reference - 1.0)
    windows[1] = replace(windows[1], battery=shifted)
    scene, known, _ = turns[0]
    outcome = calibrate_turns(windows, known)
    found = outcome.calibration
    assert found.motors.reference == windows[0].battery.reference
    error = heading_error(scene, at_current(found, -ELECTRONICS))
    assert error < 3.0 * calibration_sigma(found)


def test_the_fit_uses_the_currents_of_a_recording():
    scene, known, messages = turn_with_current("hold", SIZE, 3)
    window = replace(scene.window, time=scene.window.time + 100.0)
    messages = [(stamp + 100.0, current) for stamp, current in messages]
    sensors = window.time, window.field, window.specific_force, window.angular_rate
    readings = []
    for stamp, field, force, rate in zip(*(each.tolist() for each in sensors), strict=True):
        readings += [ImuSample(stamp, force, rate), FieldSample(stamp, field)]
    collector = SampleCollector(known.mounting)
    collector.take(readings, (), messages)
    found, live = collector.window().battery, collected(window, messages).battery
    assert np.array_equal(found.current, live.current)
    assert found.reference == live.reference


def test_a_hold_current_is_subtracted_at_rest():
    scene, outcome = fitted("hold", 3, course="even")
    found = outcome.calibration
    compass, sense, motors = Compass(found), MotionDetector(), found.motors
    rng, gain = np.random.default_rng(4), motors.gain[motors.inputs.index(MotorInput.CURRENT)]
    seen = []
    for k in range(600):
        stamp, holding = 0.05 * k, -3.0 if k % 200 < 100 else 0.0
        current = -ELECTRONICS + holding
        raw = scene.robot.hard_iron + scene.robot.field_enu + rng.normal(0.0, 0.3e-6, 3)
        raw += (current - motors.reference) * gain
        motor_state = sense.at(stamp, (0.0, 0.0, 0.0), True, math.nan, current, motors.reference)
        assert motor_state.moving == 0.0 or k == 0
        field, doubt = compass.at_rest(stamp, tuple(raw), (0.0, 0.0, 0.0), motor_state)
        seen.append(field)
        # A tenth of the field follows no input.
        assert 0.0 <= np.trace(doubt.lasting) < SIZE**2 / 4.0
    expected = compass.correct(tuple(scene.robot.hard_iron + scene.robot.field_enu))
    off = np.reshape(seen, (-1, 100, 3))[:, 30:].mean(axis=1) - expected
    assert np.abs(off).max() < 0.3e-6


@pytest.mark.nightly
def test_without_a_gyro_the_current_is_used_too():
    scene, known, messages = turn_with_current("hold", SIZE, 3, course="even")
    window = replace(scene.window, angular_rate=None)
    found = calibrate(collected(window, messages), known).calibration
    motors = found.motors
    at = motors.inputs.index(MotorInput.CURRENT)
    assert np.linalg.norm(motors.gain[at]) == pytest.approx(
        SIZE / LARGEST, abs=3 * motors.sigma(at)
    )
    assert heading_error(scene, at_current(found, -ELECTRONICS)) < 3.0 * calibration_sigma(found)
