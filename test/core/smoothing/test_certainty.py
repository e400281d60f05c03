"""What the smoother says of its own certainty, against simulated places that bend the field."""

import math
from dataclasses import replace

import numpy as np
import pytest
from simulated.drive import random_vehicle, simulated_drive
from simulated.legs import circles, city, joined, standing
from simulated.travel import travel
from streets import BOSTON, driven, heading_error, log_from

from magcal_ros.core.knowledge import Knowledge
from magcal_ros.core.samples.window import Window
from magcal_ros.core.simulation.simulator import Robot
from magcal_ros.core.smoothing.fit import fit_nodes
from magcal_ros.core.smoothing.log import log_of

NOBODY = np.eye(3)


def ringed(seed, seconds=90.0, speed=3.0, radius=8.0, vehicle=None):
    """Circles in one place."""
    legs = joined(standing(5.0), circles(seconds, speed, radius))
    return driven(seed, legs=legs, vehicle=vehicle)


def with_bias(vehicle, degrees):
    return replace(vehicle, robot=replace(vehicle.robot, gyro_bias=np.radians(degrees)))


def fitted(log):
    return fit_nodes(log.nodes(NOBODY), BOSTON)


@pytest.fixture(scope="module")
def rings():
    return [ringed(500 + seed) for seed in range(8)]


@pytest.mark.parametrize("speed", [False, True])
def test_circles_in_one_place_are_as_certain_as_they_are_right(rings, speed):
    fits = [fitted(log_from(drive, speed=speed)) for drive in rings]
    said = np.degrees([fit.twelve.heading_sigma for fit in fits])
    errors = [
        heading_error(fit.twelve.correction, drive.vehicle.robot)
        for fit, drive in zip(fits, rings, strict=True)
    ]
    assert 0.3 < np.mean(np.square(errors) / said**2) < 2.5
    assert np.median(said) < 4.0


def test_more_laps_of_the_same_circle_tell_hardly_more(rings):
    log = log_from(rings[0], speed=True)
    begun = log.time[0] + 5.0
    one, more = (fitted(log.between(begun, begun + laps * 17.0)) for laps in (1.5, 4.5))
    assert more.twelve.heading_sigma > 0.7 * one.twelve.heading_sigma


def rough_rings():
    """Good and bad gyros' circles, and those of a bad one with the rest before them."""
    plain = random_vehicle(np.random.default_rng(7))
    for bias in ((0.1, 0.0, 0.1), (3.5, 2.0, 1.9)):
        drive = ringed(9, speed=4.0, vehicle=with_bias(plain, bias))
        log = log_from(drive)
        yield drive.vehicle.robot, log.between(log.time[0] + 8.0, log.time[-1]), log


def test_circles_by_a_gyro_far_off_are_said_to_be_rough():
    """Nothing but what it does about up shows there that it is off across."""
    (_, usual, _), (robot, rings, whole) = rough_rings()
    good, bad, rested = (fitted(log).twelve for log in (usual, rings, whole))
    error = heading_error(bad.correction, robot)
    assert error > 5.0
    assert error < 4.0 * math.degrees(bad.heading_sigma)
    assert bad.heading_sigma > 1.5 * good.heading_sigma
    # The rest before them tells the bias.
    assert heading_error(rested.correction, robot) < 0.7 * error


def test_new_streets_tell_more():
    rng = np.random.default_rng(3)
    drive = driven(11, legs=city(rng, 300.0))
    log = log_from(drive, speed=True)
    ends = log.time[0] + np.array([100.0, 290.0])
    short, long = (fitted(log.between(log.time[0], end)) for end in ends)
    assert long.twelve.heading_sigma < 0.8 * short.twelve.heading_sigma


def test_a_calmer_place_is_no_excuse_to_be_sure_after_one_circle():
    """What is found of a street within one circle is little of its size."""
    fit = fitted(log_from(ringed(3, seconds=25.0), speed=True))
    assert math.degrees(fit.twelve.heading_sigma) > 1.0


@pytest.mark.parametrize("every", [1, 6])
def test_the_vertical_of_a_drive_is_doubted_by_what_its_up_errs(every):
    """Up errs by a third of how it varies, and more where an IMU comes at 5 Hz."""
    rng = np.random.default_rng(2)
    drive = simulated_drive(travel(city(rng, 900.0), rng, rate=30.0), rng)
    each = (drive.truth.time, drive.field, drive.force, drive.rate)
    log = log_of(Window(*(values[::every] for values in each)))
    twelve = fit_nodes(log.nodes(np.eye(3)), Knowledge()).twelve
    off = abs(twelve.correction.hard_iron[2] - Robot().hard_iron[2])
    assert 3e-6 < off < 2.0 * math.sqrt(twelve.covariance[11, 11])
