"""A check by a drive distinguishes added iron from disturbances of its streets."""

from dataclasses import replace

import numpy as np
import pytest
from simulated import Streets, city, random_vehicle, simulated_drive, travel
from simulated.legs import circles
from simulated.turns import measure, turn

from magcal_ros.core import Figure, Grade, Refusal, Window, calibrate, check
from magcal_ros.core.samples import log_of

pytestmark = pytest.mark.usefixtures("right_axes")


def a_drive(seconds):
    """The window of a drive, and the calibration of its vehicle by a turn."""
    rng = np.random.default_rng(5)
    vehicle = random_vehicle(rng)
    drive = simulated_drive(
        travel(city(rng, seconds), rng), rng, vehicle, wheels=None, receiver=None
    )
    made = calibrate(measure(vehicle.robot, turn(), rng, gyro=True), vehicle.robot.knowledge())
    window = Window(drive.time, drive.field, drive.force, drive.rate)
    return window, made.calibration


@pytest.fixture(scope="module")
def driven():
    return a_drive(240.0)


def swing(drive, calibration):
    """The check of the heading's swing."""
    checks = check(drive, calibration, drive=drive).verdict.checks
    return next(each for each in checks if each.figure is Figure.HEADING_SWING)


def with_iron(window, *microtesla):
    return replace(window, field=window.field + 1e-6 * np.array(microtesla))


@pytest.mark.nightly
def test_disturbances_of_streets_are_not_taken_for_iron(driven):
    window, calibration = driven
    assert swing(log_of(window), calibration).grade is Grade.GOOD


@pytest.mark.nightly
@pytest.mark.parametrize("added", [(0.0, -6.0, 0.0), (6.0, 0.0, 0.0)])
def test_iron_is_not_taken_for_a_street(driven, added):
    window, calibration = driven
    found = swing(log_of(with_iron(window, *added)), calibration)
    assert found.grade is Grade.REFUSED


@pytest.mark.nightly
def test_a_check_uses_the_hard_iron_by_the_drive(driven):
    window, calibration = driven
    changed = with_iron(window, 6.0, 0.0, 0.0)
    seldom = changed.take(np.arange(0, len(changed), 20))
    found = check(seldom, calibration, drive=log_of(changed))
    assert found.state == "stale"


def test_a_short_drive_shows_nothing():
    window, calibration = a_drive(30.0)
    part = window.take(window.time <= window.time[0] + 20.0)
    with pytest.raises(Refusal, match="headings"):
        check(part, calibration, drive=log_of(part))


@pytest.mark.nightly
def test_an_accelerometer_bias_is_not_taken_for_iron():
    """A car that circles and never rests: gravity that seems too weak leans up in its bends."""
    rng = np.random.default_rng(3)
    vehicle = random_vehicle(rng)
    truth = travel(circles(50.0), rng, rate=20.0)
    options = {"streets": Streets(size=1e-6), "wheels": None, "receiver": None}
    drive = simulated_drive(truth, rng, vehicle, **options)
    made = calibrate(measure(vehicle.robot, turn(), rng, gyro=True), vehicle.robot.knowledge())
    force = drive.force + np.array([0.0, 0.0, -0.15])
    window = Window(drive.time, drive.field, force, drive.rate)
    circling = window.take(np.flatnonzero(drive.time > 1008.0))
    assert swing(log_of(circling), made.calibration).grade is Grade.GOOD


@pytest.mark.nightly
def test_one_street_is_not_enough_to_call_a_calibration_stale():
    rng = np.random.default_rng(6)
    vehicle = random_vehicle(rng)
    truth = travel(city(rng, 200.0), rng, rate=20.0)
    drive = simulated_drive(truth, rng, vehicle, streets=Streets(size=5e-6))
    made = calibrate(measure(vehicle.robot, turn(), rng, gyro=True), vehicle.robot.knowledge())
    window = Window(drive.time, drive.field, drive.force, drive.rate)
    part = window.take(np.flatnonzero(drive.time < 1090.0))
    assert check(part, made.calibration, drive=log_of(part)).state == "doubtful"
    changed = with_iron(part, 30.0, 0.0, 0.0)
    assert check(changed, made.calibration, drive=log_of(changed)).state == "stale"
