"""The calibration by a drive, and its sigma."""

import dataclasses
import math

import numpy as np
import pytest
from long_form import first_of
from long_windows import (
    PAPER_SOFT_IRON,
    swaying,
    swaying_robot,
    swaying_window,
)
from simulated.drive import random_vehicle, simulated_drive
from simulated.legs import Leg, circles, city
from simulated.travel import travel
from streets import BOSTON, driven, heading_error, log_from

from magcal_ros.core import Refusal, Window
from magcal_ros.core.calibration import calibration_sigma
from magcal_ros.core.knowledge import knowledge_of
from magcal_ros.core.methods.smoother import fit
from magcal_ros.core.samples import log_of
from magcal_ros.core.smoother import (
    AT,
    DRIVES,
    MICROTESLA,
    SMALL_CIRCLE,
    VELOCITY,
    corrected,
    drive_nodes,
    fit_drive,
    fit_iron,
    likelihood_ratio_of,
    part_with_most_motion,
    priors_of,
    smooth,
)
from magcal_ros.core.smoother.joint import Joint
from magcal_ros.core.smoother.start import start

NOBODY = np.eye(3)


@pytest.fixture(scope="module")
def drive():
    return driven(4, 200.0)


@pytest.fixture(scope="module")
def nodes(drive):
    return drive_nodes(log_from(drive), NOBODY)


@pytest.fixture(scope="module")
def fitted(drive):
    return fit_to(drive)


def fit_to(drive, **options):
    """The smoother's result of a drive."""
    return fit_of(log_from(drive, **options), BOSTON)


def fit_of(log, knowledge):
    return fit_drive(log, drive_nodes(log, NOBODY), knowledge)


def test_a_drive_gives_the_calibration_within_its_sigma(drive, fitted):
    error = heading_error(fitted.posterior.correction, drive.vehicle.robot)
    stated = math.degrees(fitted.posterior.heading_sigma)
    assert error < 3.0
    assert stated < 3.0
    assert error < 2.5 * stated
    assert fitted.fit.converged
    assert fitted.sectors >= 6


def test_the_evidence_has_the_determinant_of_the_expected_curvature(fitted):
    models, points = [fitted.fit.model], [fitted.fit.point]
    by_steps = Joint.at(models, points)
    change = Joint.at(models, points, is_expected=True).log_determinant - by_steps.log_determinant
    assert change < -100.0
    assert by_steps.log_curvature == pytest.approx(change, abs=3.0)


@pytest.mark.nightly
@pytest.mark.parametrize("drive", first_of([(150.0, False), (240.0, False), (240.0, True)]))
def test_a_drive_sampled_once_a_second_is_fitted_within_its_sigma(drive):
    seconds, means = drive
    rng = np.random.default_rng(5)
    vehicle = random_vehicle(rng)
    way = travel(city(rng, seconds), rng, rate=10.0)
    drive = simulated_drive(way, rng, vehicle, receiver=None)
    count = len(drive.time) // 10 * 10

    def thinned(values):
        tens = values[:count].reshape(-1, 10, *values.shape[1:])
        return tens.mean(axis=1) if means else tens[:, 0]

    window = Window(*map(thinned, (drive.time, drive.field, drive.force, drive.rate)))
    estimate = fit(window, BOSTON)
    error, stated = heading_error(estimate.correction, vehicle.robot), calibration_sigma(estimate)
    assert stated < math.radians(5.0)
    assert error < 2.0 * math.degrees(stated)


@pytest.mark.nightly
def test_the_start_follows_a_yaw_that_drifts_by_a_turn_and_more():
    rng = np.random.default_rng(1)
    vehicle = dataclasses.replace(random_vehicle(rng), bias_walk=1e-4)
    way = travel(city(rng, 2400.0), rng, rate=5.0)
    log = log_from(simulated_drive(way, rng, vehicle, receiver=None))
    state, _ = start(drive_nodes(log, NOBODY), priors_of(BOSTON, log.bias_sigma))
    off = state.shared[AT["iron"]] - MICROTESLA * vehicle.robot.hard_iron
    assert np.abs(off[:2]).max() < 2.0


def test_the_part_with_most_motion_is_that_of_changing_force():
    time = np.arange(0.0, 1000.0, 0.5)
    force = np.tile([0.0, 0.0, 9.8], (len(time), 1))
    force[(time > 620.0) & (time < 660.0), 0] += 1.0
    window = Window(time, force, force, np.zeros_like(force))
    part = part_with_most_motion(window)
    assert part.time[0] <= 620.0
    assert part.time[-1] >= 660.0
    assert np.ptp(part.time) == pytest.approx(60.0, abs=1.0)
    assert np.array_equal(part_with_most_motion(log_of(window)).time, part.time)
    assert part_with_most_motion(window.take(time < 100.0)) is None


@pytest.mark.nightly
def test_forty_minutes_of_driving_are_not_taken_for_a_turn_on_the_spot():
    rng = np.random.default_rng(1752)
    way = travel(city(rng, 2400.0), rng, rate=10.0)
    log = log_from(simulated_drive(way, rng, random_vehicle(rng), receiver=None))
    found = smooth(dataclasses.replace(log, speed=np.full(len(log), math.nan)), BOSTON)
    assert set(found.fits) <= {*DRIVES, SMALL_CIRCLE}


@pytest.mark.nightly
def test_a_gyro_bias_that_changes_over_a_drive_of_90_minutes_does_no_harm():
    rng = np.random.default_rng(4)
    vehicle = dataclasses.replace(random_vehicle(rng), bias_walk=5e-5)
    way = travel(city(rng, 5400.0), rng, rate=5.0)
    drive = simulated_drive(way, rng, vehicle, receiver=None)
    found = fit_to(drive)
    assert heading_error(found.posterior.correction, vehicle.robot) < 1.0
    assert math.degrees(found.posterior.heading_sigma) < 0.85


@pytest.mark.nightly
def test_a_start_eighty_degrees_off_converges(drive):
    vehicle = dataclasses.replace(
        drive.vehicle,
        robot=dataclasses.replace(drive.vehicle.robot, hard_iron=np.array([90e-6, -60e-6, 40e-6])),
    )
    other = driven(5, 150.0, vehicle=vehicle)
    found = fit_to(other)
    assert heading_error(found.posterior.correction, vehicle.robot) < 4.0


def test_a_gyro_that_turns_the_other_way_is_refused(drive):
    log = log_from(drive)
    log = log.take(log.time <= log.time[0] + 80.0)
    with pytest.raises(Refusal, match="axes of both sensors"):
        fit_of(dataclasses.replace(log, angular_rate=-log.angular_rate), BOSTON)


def test_a_short_drive_is_refused(drive):
    log = log_from(drive)
    with pytest.raises(Refusal, match="drive for longer"):
        fit_of(log.take(log.time <= log.time[0] + 8.0), BOSTON)


def test_the_speed_of_the_wheels_is_the_velocity_ahead(drive):
    speed = drive.truth.speed
    found = fit_to(drive, speed=True).fit
    by_time = np.interp(found.model.nodes.time, drive.time, speed)
    ahead = found.state.local[:, VELOCITY.start]
    assert np.median(np.abs(ahead - by_time)) < 0.3


def test_pieces_separated_by_gyro_gaps_give_one_calibration(drive):
    """Ten seconds are missing, in which the vehicle may have turned anyhow."""
    log = log_from(drive)
    middle = log.time[0] + 100.0
    rows = (log.time < middle) | (log.time > middle + 10.0)
    holed = log.take(rows)
    nodes = drive_nodes(holed, NOBODY)
    assert np.count_nonzero(~nodes.is_tied) == 1
    found = fit_of(holed, BOSTON)
    error = heading_error(found.posterior.correction, drive.vehicle.robot)
    assert error < 2.5 * math.degrees(found.posterior.heading_sigma)


def test_added_iron_is_found_in_ninety_seconds(drive):
    robot = drive.vehicle.robot
    changed = drive.vehicle.with_iron(np.array([8e-6, -6e-6, 0.0]))
    other = driven(9, 90.0, vehicle=changed)
    found = fit_iron(drive_nodes(log_from(other), NOBODY), robot.true_correction, BOSTON)
    before = heading_error(robot.true_correction, changed.robot)
    after = heading_error(found.posterior.correction, changed.robot)
    assert before > 10.0
    assert after < min(6.0, 3.0 * math.degrees(found.posterior.heading_sigma))


@pytest.mark.nightly
def test_the_true_calibration_is_likelier_than_a_wrong_one(drive, nodes):
    true = drive.vehicle.robot.true_correction
    wrong = drive.vehicle.with_iron(np.array([5e-6, 0.0, 0.0])).robot.true_correction
    old, new = (corrected(nodes, each, NOBODY) for each in (wrong, true))
    assert likelihood_ratio_of(old, new, BOSTON).gain > 12.0


def test_a_drive_with_bursts_of_stamps_is_refused_with_the_reason(drive):
    """A buffer that is read once a second: the rotation in between is unknown."""
    window = Window(drive.time, drive.field, drive.force, drive.rate)
    read = np.floor(window.time)
    bursts = dataclasses.replace(window, time=read + 0.05 * (window.time - read))
    log = log_of(bursts)
    with pytest.raises(Refusal, match="in bursts"):
        fit_of(log, BOSTON)
    assert fit_iron(drive_nodes(log, NOBODY), drive.vehicle.robot.true_correction, BOSTON) is None


LONG = knowledge_of(47.3, inclination_deg=60.5)


def weak_motion(seconds, turns, soft_iron, seed):
    """Error and sigma of the heading, degrees, of a robot that sways where it is."""
    robot = swaying_robot(soft_iron)
    window = swaying_window(robot, swaying(seconds, turns=turns), np.random.default_rng(seed))
    found = fit_of(log_of(window), LONG)
    error = heading_error(found.posterior.correction, robot)
    return error, math.degrees(found.posterior.heading_sigma)


@pytest.mark.nightly
@pytest.mark.parametrize("turns", first_of([True, False]))
@pytest.mark.parametrize("soft_iron", first_of([PAPER_SOFT_IRON, np.zeros((3, 3))]))
def test_two_minutes_of_weak_motion_have_a_correct_sigma(turns, soft_iron):
    """A robot that sways on the spot is not taken to drive."""
    error, stated = weak_motion(120.0, turns, soft_iron, 1)
    assert error < 0.6
    assert error < 2.5 * stated
    assert stated < 0.6


@pytest.mark.nightly
@pytest.mark.timeout(900)
@pytest.mark.parametrize("turns", [False, True])
@pytest.mark.parametrize("soft_iron", [np.zeros((3, 3)), PAPER_SOFT_IRON])
@pytest.mark.parametrize("seconds", [120.0, 600.0])
def test_weak_motion_has_a_correct_sigma_over_many_windows(seconds, turns, soft_iron):
    errors, stated = np.array([weak_motion(seconds, turns, soft_iron, k) for k in range(20)]).T
    assert math.sqrt(np.mean(errors**2)) < 0.45
    assert np.mean((errors / stated) ** 2) < 2.0


@pytest.mark.nightly
def test_slow_driving_in_a_street_has_a_correct_sigma():
    """There is no acceleration here either, but the street is in the residuals of the field."""
    drive = driven(3, legs=city(np.random.default_rng(3), 120.0, fastest=0.4))
    found = fit_to(drive)
    error = heading_error(found.posterior.correction, drive.vehicle.robot)
    stated = math.degrees(found.posterior.heading_sigma)
    assert error < 2.5 * stated
    assert stated > 1.0


@pytest.mark.parametrize("seed", first_of([403200, 403201, 403202]))
def test_a_gyro_that_measures_about_z_alone_is_enough(seed):
    drive = driven(seed, legs=city(np.random.default_rng(seed), 240.0))
    about_z = drive.rate * [0.0, 0.0, 1.0]
    found = fit_of(log_of(Window(drive.time, drive.field, drive.force, about_z)), BOSTON)
    error = heading_error(found.posterior.correction, drive.vehicle.robot)
    stated = math.degrees(found.posterior.heading_sigma)
    assert found.fit.model.nodes.working == (False, False, True)
    assert error < 2.5 * stated
    assert stated < 4.0


@pytest.mark.nightly
@pytest.mark.parametrize("seed", first_of([183101, 183104]))
def test_small_circles_are_fitted_within_their_sigma(seed):
    """Each round passes the same covers and parked cars."""
    drive = driven(seed, legs=circles(90.0, radius=4.0))
    found = fit_to(drive)
    error = heading_error(found.posterior.correction, drive.vehicle.robot)
    assert error < 1.8 * math.degrees(found.posterior.heading_sigma)
    true = math.sqrt(np.mean(drive.disturbance**2))
    assert true / 1.5 < found.street < 1.5 * true


@pytest.mark.nightly
@pytest.mark.parametrize("seed", [691000, 691001, 691002, 691003])
def test_a_steady_circle_without_a_rest_has_a_correct_sigma(seed):
    """Its constant force could be that of a robot that leans on the spot, with a gyro bias."""
    drive = driven(seed, legs=circles(80.0, speed=2.0, radius=4.0))
    window = Window(*(each[1000::2] for each in (drive.time, drive.field, drive.force, drive.rate)))
    found = smooth(window, BOSTON)
    error = heading_error(found.posterior.correction, drive.vehicle.robot)
    assert error < 2.5 * math.degrees(found.posterior.heading_sigma) < 15.0


@pytest.mark.parametrize("seed", first_of([60002, 60000, 60001]))
def test_a_fast_circle_without_a_rest_is_not_taken_for_a_tilt(seed):
    """Its acceleration rotates in the swaying body as gravity does: only the speed is lower."""
    drive = driven(seed, legs=circles(60.0, speed=8.5, radius=21.0))
    window = Window(*(each[250:] for each in (drive.time, drive.field, drive.force, drive.rate)))
    found = smooth(window, BOSTON)
    error = heading_error(found.posterior.correction, drive.vehicle.robot)
    assert error < 2.5 * math.degrees(found.posterior.heading_sigma) < 25.0
    assert np.median(found.fit.state.local[:, VELOCITY.start]) == pytest.approx(8.5, abs=0.5)


PARKING = [
    *(Leg(6.0), Leg(3.0, 5.0), Leg(3.0, 5.0, 0.13), Leg(3.0, 3.0, 0.13), Leg(3.0, 4.0, 0.13)),
    *(Leg(4.0, 2.0, 0.13), Leg(3.0, 3.0), Leg(3.0), Leg(5.0)),
]
"""A car turns round, and stops."""


@pytest.mark.nightly
@pytest.mark.parametrize("seed", first_of([193105, 193102, 193103]))
def test_a_car_that_turns_round_is_not_taken_for_a_robot_on_the_spot(seed):
    """On the spot its acceleration counts as noise of the force, and no fit may remain there."""
    drive = driven(seed, legs=PARKING)
    found = smooth(Window(drive.time, drive.field, drive.force, drive.rate), BOSTON)
    assert found.mode in DRIVES
    assert found.fit.point.sizes["force"] < 0.15
    error = heading_error(found.posterior.correction, drive.vehicle.robot)
    assert error < 2.5 * math.degrees(found.posterior.heading_sigma)


def fit_about_z(drive, begin=0.0):
    """Fit a drive from `begin` on, in seconds, by a gyro that measures about z alone."""
    log = log_from(drive)
    log = log.take(log.time > log.time[0] + begin)
    found = smooth(
        dataclasses.replace(log, angular_rate=log.angular_rate * [0.0, 0.0, 1.0]), BOSTON
    )
    error = heading_error(found.posterior.correction, drive.vehicle.robot)
    return found, error, math.degrees(found.posterior.heading_sigma)


@pytest.mark.nightly
@pytest.mark.parametrize("seed", first_of([190200, 190202, 190203, 190401]))
def test_a_gyro_that_measures_about_z_alone_calibrates_a_drive(seed):
    """The tilt of a car on a road is limited: a larger one is acceleration."""
    found, error, stated = fit_about_z(driven(seed, 200.0))
    assert found.mode in DRIVES
    assert error < 2.5 * stated < 8.0


@pytest.mark.nightly
@pytest.mark.parametrize("seed", first_of([192500, 192501, 192502, 192503]))
def test_without_a_rest_a_gyro_about_z_alone_leaves_open_whether_the_robot_drives(seed):
    """A steady circle tilts the force as a leaning robot on the spot does."""
    drive = driven(seed, legs=circles(120.0, radius=14.0))
    found, error, stated = fit_about_z(drive, begin=20.0)
    assert set(found.fits) <= {*DRIVES, SMALL_CIRCLE}
    assert error < 2.5 * stated


@pytest.mark.nightly
def test_a_constant_field_at_rest_does_not_determine_the_disturbance():
    """Where nothing passes the robot, streets that change from place to place stay as large."""
    drive = driven(12, 120.0)
    found = fit_to(drive, speed=False)
    error = heading_error(found.posterior.correction, drive.vehicle.robot)
    assert error < 2.5 * math.degrees(found.posterior.heading_sigma)
    assert found.street > 1.5e-6
    assert found.fit.point.sizes["traffic"] < 0.02


@pytest.mark.nightly
@pytest.mark.timeout(900)
@pytest.mark.parametrize("seconds", [120.0, 300.0])
@pytest.mark.parametrize("speed", [False, True])
def test_the_sigma_is_correct_over_many_drives(seconds, speed):
    errors, stated = [], []
    for seed in range(100):
        drive = driven(seed, seconds)
        found = fit_to(drive, speed=speed)
        errors.append(heading_error(found.posterior.correction, drive.vehicle.robot))
        stated.append(math.degrees(found.posterior.heading_sigma))
    wrong, predicted = (math.sqrt(np.mean(np.square(each))) for each in (errors, stated))
    assert wrong < (3.0 if seconds > 200.0 else 4.5)
    assert 1.0 / 1.5 < wrong / predicted < 1.5
    assert 0.3 < np.mean((np.array(errors) / stated) ** 2) < 2.0


@pytest.mark.nightly
@pytest.mark.parametrize("walk", [2e-5, 5e-5])
def test_a_random_walk_of_the_bias_is_not_taken_for_gyro_noise(walk):
    """Half an hour: the rate is off by .05 to .1 °/s at the end, and not at the beginning."""
    drive = driven(7, 1800.0)
    second = np.diff(drive.time, prepend=drive.time[0])[:, None]
    steps = np.random.default_rng(1).normal(0.0, walk, drive.rate.shape) * np.sqrt(second)
    log = log_from(dataclasses.replace(drive, rate=drive.rate + np.cumsum(steps, axis=0)))
    found = fit_of(log, BOSTON)
    assert found.fit.point.sizes["gyro_up"] < 0.002
    error = heading_error(found.posterior.correction, drive.vehicle.robot)
    assert error < 3.0 * math.degrees(found.posterior.heading_sigma)
