"""An IMU whose z does not point up, as its description says, gives what a flat one does."""

import math
from dataclasses import replace

import numpy as np
import pytest
from fusing import CALIBRATED, Fusing
from long_form import first_of
from moving import Course
from simulated.drive import Vehicle, simulated_drive
from simulated.legs import city
from simulated.travel import travel
from simulated.turns import Motion, measure, turn

from magcal_ros.core import Correction, Knowledge, Mounting, Window, calibrate, calibrate_turns
from magcal_ros.core.calibrate import predicted_sigma
from magcal_ros.core.calibration import calibration_sigma
from magcal_ros.core.doctor import examine_window
from magcal_ros.core.geometry import exp_rotation, rotation_from_rpy
from magcal_ros.core.heading import BaseHeading, MotionDetector
from magcal_ros.core.knowledge import knowledge_of, level_rotation
from magcal_ros.core.methods import known_headings
from magcal_ros.core.monitoring import recheck
from magcal_ros.core.samples import ImuSample, log_of
from magcal_ros.core.self_calibration import DriveJob, examine_drive
from magcal_ros.core.simulation import LEVEL_TILT, Robot, heading_errors
from magcal_ros.core.smoother import KnownHeadingMeasurement

pytestmark = pytest.mark.usefixtures("right_axes", "one_fit")

ROBOT = Robot(noise_field=0.3e-6, noise_force=0.05, noise_rate=2e-3)
QUARTER = 0.5 * math.pi
ON_SIDE = exp_rotation(np.array([QUARTER, 0.0, 0.0]))
TILTS = first_of([(0.0, QUARTER), (QUARTER, 0.0), (math.pi, 0.0)])
"""Of the IMU about x and y, radians."""


def turned(window, pose):
    """Return the samples of an IMU at a pose; the magnetometer is turned with it."""
    there = window.in_axes(pose)
    rests = tuple(replace(rest, field=pose @ rest.field) for rest in there.rests)
    return replace(there, field=window.field @ pose.T, rests=rests)


def known(pose, knowledge=ROBOT.knowledge()):
    return replace(knowledge, mounting=Mounting(forward=pose[:, 0], upward=pose[:, 2]))


def assert_same(found, flat, pose):
    """Assert that two calibrations agree: `found` of the IMU at a pose, `flat` of a flat one."""
    there = flat.correction
    assert found.correction.matrix == pytest.approx(pose @ there.matrix @ pose.T, abs=1e-5)
    assert found.correction.hard_iron == pytest.approx(pose @ there.hard_iron, abs=1e-10)
    assert calibration_sigma(found) == pytest.approx(calibration_sigma(flat), rel=1e-3)


def window_of(seed, lean=0.0):
    motion = turn(samples=500, duration=15.0, start_rpy=(0.0, lean, 0.0))
    return measure(ROBOT, motion, np.random.default_rng(seed), gyro=True)


@pytest.fixture(scope="module")
def flat():
    return calibrate(window_of(1), ROBOT.knowledge())


@pytest.mark.parametrize("tilt", TILTS)
def test_a_turn_gives_the_same_calibration(flat, tilt):
    pose = exp_rotation(np.array([*tilt, 0.0]))
    window = turned(window_of(1), pose)
    outcome = calibrate(window, known(pose))
    assert outcome.verdict.accepted
    assert_same(outcome.calibration, flat.calibration, pose)
    assert outcome.verdict.quality == flat.verdict.quality
    assert outcome.estimate.installation.angle == pytest.approx(
        flat.estimate.installation.angle, abs=1e-5
    )
    assert outcome.estimate.axis == pytest.approx(pose @ flat.estimate.axis, abs=1e-5)
    assert outcome.estimate.gyro.rate == pytest.approx(pose @ flat.estimate.gyro.rate, abs=1e-6)
    expected = predicted_sigma(window_of(1), ROBOT.knowledge())
    assert predicted_sigma(window, known(pose)) == pytest.approx(expected, rel=1e-3)


def test_the_heading_is_right_if_the_imu_is_also_turned_about_the_vertical(flat):
    """The numbers differ: roll and pitch of the installation and spikes are about other axes."""
    pose = rotation_from_rpy(0.7, 0.4, 2.0)
    outcome = calibrate(turned(window_of(1), pose), known(pose))
    found = outcome.calibration.correction
    flat_again = Correction(pose.T @ found.matrix @ pose, pose.T @ found.hard_iron)
    errors = heading_errors(flat_again, ROBOT)[:, LEVEL_TILT]
    expected = heading_errors(flat.calibration.correction, ROBOT)[:, LEVEL_TILT]
    assert errors - errors.mean() == pytest.approx(expected - expected.mean(), abs=1e-3)
    assert math.sqrt(np.mean(errors**2)) < 3.0 * calibration_sigma(outcome.calibration)
    sigmas = [calibration_sigma(each.calibration) for each in (outcome, flat)]
    assert sigmas[0] == pytest.approx(sigmas[1], rel=0.05)


def test_several_turns_give_the_same_calibration():
    pose = ON_SIDE
    windows = [window_of(seed, lean) for seed, lean in ((1, 0.0), (2, 0.1))]
    expected = calibrate_turns(windows, ROBOT.knowledge())
    outcome = calibrate_turns([turned(each, pose) for each in windows], known(pose))
    assert outcome.verdict.accepted
    assert_same(outcome.calibration, expected.calibration, pose)
    assert outcome.window.specific_force[0] == pytest.approx(
        pose @ windows[-1].specific_force[0], abs=1e-9
    )


def test_known_headings_give_the_same_calibration():
    pose, rng = ON_SIDE, np.random.default_rng(5)
    attitudes = [rotation_from_rpy(0.0, 0.0, yaw).T for yaw in (0.1, 1.7, 3.3, 4.9)]
    still = measure(ROBOT, Motion(np.arange(4.0), np.array(attitudes)), rng)
    flat = [
        KnownHeadingMeasurement(field, force, yaw, 0.01)
        for field, force, yaw in zip(
            still.field, still.specific_force, (0.1, 1.7, 3.3, 4.9), strict=True
        )
    ]
    there = [
        replace(each.in_axes(pose), field=pose @ each.field, forward=pose[:, 0]) for each in flat
    ]
    expected = known_headings.fit(flat, ROBOT.knowledge())
    assert_same(known_headings.fit(there, known(pose)), expected, pose)
    words = known_headings.next_in_words(there, known(pose))
    assert words == known_headings.next_in_words(flat, ROBOT.knowledge())


def test_a_drive_gives_the_same_candidates():
    pose, rng = ON_SIDE, np.random.default_rng(4)
    place = knowledge_of(51.3, inclination_deg=66.3)
    robot = Robot(strength=51.3e-6, inclination=math.radians(66.3), noise_field=0.3e-6)
    drive = simulated_drive(travel(city(rng, 90.0), rng, rate=10.0), rng, Vehicle(robot))
    window = Window(drive.time, drive.field, drive.force, drive.rate)

    def candidates(window, knowledge):
        (first,) = examine_drive(DriveJob(log_of(window), knowledge, None, (60.0,))).candidates
        watched = DriveJob(log_of(window), knowledge, first.calibration, (80.0,))
        return first, *examine_drive(watched).candidates

    there = candidates(turned(window, pose), known(pose, place))
    for found, flat in zip(there, candidates(window, place), strict=True):
        assert_same(found.calibration, flat.calibration, pose)
        assert found.sigma == pytest.approx(flat.sigma, rel=1e-3)
        assert found.in_motion.matrix == pytest.approx(found.calibration.correction.matrix)


def test_a_check_of_a_calibration_says_the_same(flat):
    pose = ON_SIDE
    outcome = calibrate(turned(window_of(1), pose), known(pose))
    moved = replace(ROBOT, hard_iron=ROBOT.hard_iron + np.array([3e-6, 0.0, 0.0]))
    fresh = measure(moved, turn(samples=500, duration=15.0), np.random.default_rng(7), gyro=True)
    expected = recheck.check(fresh, flat.calibration)
    found = recheck.check(turned(fresh, pose), outcome.calibration)
    assert found.state == expected.state != "holds"
    assert found.verdict.summary == expected.verdict.summary


def seen_by(pose, sample):
    """Return a message of sensors at a pose."""
    if isinstance(sample, ImuSample):
        force, rate = (tuple(pose @ each) for each in (sample.force, sample.rate))
        return sample._replace(force=force, rate=rate)
    return sample._replace(field=tuple(pose @ sample.field))


def fused_yaw(pose):
    """Return the fused yaw of the base, with its sigma, during a ride."""
    there = replace(CALIBRATED.in_axes(pose), upward=pose[:, 2])
    matrix = there.correction.matrix @ pose.T
    hard_iron = pose @ there.correction.hard_iron
    fusing = Fusing(replace(there, correction=Correction(matrix, hard_iron)))
    base, found = BaseHeading(pose.T), []

    def listen(sample, ride):
        count = len(fusing.found)
        fusing(seen_by(pose, sample), ride)
        if len(fusing.found) > count:
            heading = base.heading(fusing.fused.heading())
            found.append((heading.yaw, math.sqrt(heading.yaw_variance)))

    course = Course(listen)
    course.go(5.0)
    course.circle(15.0, rate=0.4, speed=2.0)
    course.go(5.0, yaw_rate=-0.5)
    return np.unwrap(np.array(found), axis=0)


@pytest.mark.parametrize("tilt", TILTS)
def test_the_fused_yaw_of_the_base_is_the_same(tilt):
    """Also if the IMU's x points up, so that its own yaw is not defined."""
    expected = fused_yaw(np.eye(3))
    assert fused_yaw(exp_rotation(np.array([*tilt, 0.0]))) == pytest.approx(expected, abs=1e-4)


def test_motors_turn_about_the_top_of_the_vehicle():
    state = MotionDetector().at(0.0, (0.0, 0.8, 0.1), False, 0.0, 0.0, upward=(0.0, 1.0, 0.0))
    assert state.turn_rate == pytest.approx(0.8)


def test_the_doctor_finds_the_same(flat):
    window = window_of(1)
    expected = examine_window(window, ROBOT.knowledge()).findings
    found = examine_window(turned(window, ON_SIDE), known(ON_SIDE)).findings
    assert [(f.key, f.grade) for f in found] == [(f.key, f.grade) for f in expected]


def test_an_imu_that_lies_flat_is_not_turned():
    window = window_of(1)
    turn = level_rotation(Mounting().upward)
    assert (turn == np.eye(3)).all()
    assert (window.in_axes(turn).specific_force == window.specific_force).all()
    assert Knowledge().in_axes(turn).mounting.pose.tolist() == np.eye(3).tolist()
