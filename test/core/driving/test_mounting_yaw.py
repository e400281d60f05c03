"""The yaw of the IMU in the vehicle from force and speed, with wrong speeds as well."""

import math

import numpy as np
import pytest
from follow_drive import ROBOT, driven, follow
from long_form import first_of
from simulated import (
    Leg,
    Receiver,
    Vehicle,
    Wheels,
    circles,
    city,
    joined,
    motorway,
    parking,
    reversing,
    standing,
)

from magcal_ros.core.driving import SpeedFault, SpeedSource, fault_words

DEGREE = math.pi / 180.0
ODOMETRY, VELOCITY, FIXES = SpeedSource


def city_legs(seed, seconds=150.0):
    return city(np.random.default_rng(seed), seconds)


def error(found, true):
    return math.degrees(math.remainder(found.yaw - true, math.tau))


@pytest.mark.parametrize("yaw_deg", first_of([-170.0, 90.0, -30.0, 4.0]))
def test_the_yaw_is_found_for_every_orientation(yaw_deg):
    vehicle = Vehicle(ROBOT, imu_yaw=yaw_deg * DEGREE, imu_roll=0.1, imu_ahead=1.2)
    found = follow(driven(city_legs(2), 2, vehicle)).known_mounting
    assert found is not None
    assert abs(error(found, vehicle.imu_yaw)) < 3.0 * math.degrees(found.sigma)
    assert math.degrees(found.sigma) < 1.2
    assert found.scale == pytest.approx(1.0, abs=0.1)


@pytest.mark.parametrize(
    "receiver", first_of([Receiver(multipath=0.02), Receiver(speed_noise=0.1)])
)
def test_a_receiver_suffices(receiver):
    vehicle = Vehicle(ROBOT, imu_yaw=0.5)
    drive = driven(city_legs(3), 3, vehicle, wheels=None, receiver=receiver)
    found = follow(drive).known_mounting
    assert abs(error(found, 0.5)) < 3.0 * math.degrees(found.sigma)


@pytest.mark.nightly
def test_after_four_minutes_the_yaw_is_known_to_a_degree():
    errors, sigmas = [], []
    for seed in range(40):
        yaw = np.random.default_rng(seed).uniform(-math.pi, math.pi)
        vehicle = Vehicle(ROBOT, imu_yaw=yaw, imu_ahead=seed % 3 - 0.5)
        found = follow(driven(city_legs(seed, 240.0), seed, vehicle)).known_mounting
        errors.append(error(found, yaw))
        sigmas.append(math.degrees(found.sigma))
    assert np.sqrt(np.mean(np.square(errors))) < 1.0
    assert 0.3 < np.mean(np.square(np.divide(errors, sigmas))) < 2.0


def test_one_circle_and_a_rest_do_not_determine_the_yaw_to_a_degree():
    """The lever arm rotates the acceleration of an even circle as a rotated IMU does."""
    circling = driven(circles(90.0), 4, Vehicle(ROBOT, imu_yaw=0.2, imu_ahead=1.0))
    found = follow(circling).known_mounting
    assert found is None or abs(error(found, 0.2)) < 3.0 * math.degrees(found.sigma)
    assert found is None or found.sigma > 1.5 * DEGREE
    assert follow(driven(standing(120.0), 4)).known_mounting is None


def test_a_motorway_without_starts_gives_a_large_sigma():
    legs = motorway(np.random.default_rng(1), 100.0)
    found = follow(driven(legs, 5, Vehicle(ROBOT, imu_yaw=0.2))).known_mounting
    assert found is None or abs(error(found, 0.2)) < 3.0 * math.degrees(found.sigma)


@pytest.mark.parametrize(
    ("wheels", "fault", "words"),
    [
        (Wheels(scale=3.6), SpeedFault.SCALE, "km/h"),
        pytest.param(Wheels(scale=0.5), SpeedFault.SCALE, "0.5", marks=pytest.mark.nightly),
        (Wheels(delay=4.0), SpeedFault.LATE, "late by 4"),
        (Wheels(jumps=0.1), SpeedFault.JUMPS, "jumps"),
        (Wheels(frozen_from=1.0), SpeedFault.FROZEN, "does not change"),
    ],
)
def test_wrong_odometry_is_named_and_replaced_by_the_receiver(wheels, fault, words):
    vehicle = Vehicle(ROBOT, imu_yaw=0.3)
    estimator = follow(driven(city_legs(6), 6, vehicle, wheels=wheels))
    watch = estimator.mounting
    assert watch.faults[ODOMETRY] is fault
    assert words in fault_words("/odom", fault, watch.checked[ODOMETRY])
    assert estimator.source is FIXES
    found = estimator.known_mounting
    assert abs(error(found, 0.3)) < 3.0 * math.degrees(found.sigma)


@pytest.mark.parametrize("seed", first_of([0, 4]))
def test_frozen_odometry_is_replaced_immediately(seed):
    drive = driven(city_legs(seed, 100.0), seed, wheels=Wheels(frozen_from=80.0))
    named = []

    def watch(estimator, stamp):
        if not named and estimator.mounting.faults.get(ODOMETRY) is SpeedFault.FROZEN:
            named.append(stamp - drive.time[0])

    follow(drive, watch=watch)
    assert 80.0 < named[0] < 105.0


def test_a_frozen_speed_stays_a_fault_while_the_vehicle_stands():
    named = []

    def watch(estimator, stamp):
        named.append(estimator.mounting.faults.get(ODOMETRY))

    vehicle = Vehicle(ROBOT, imu_yaw=0.1, imu_roll=0.05)
    wheels = Wheels(frozen_from=40.0)
    follow(driven(city_legs(2, 100.0), 2, vehicle, wheels=wheels, receiver=None), watch=watch)
    first = named.index(SpeedFault.FROZEN)
    assert set(named[first:]) == {SpeedFault.FROZEN}


def test_a_constant_speed_is_not_called_frozen():
    rng = np.random.default_rng(3)
    legs = joined(city(rng, 70.0), standing(20.0), motorway(rng, 60.0))
    wheels = Wheels(noise=0.0, step=0.2)
    assert not follow(driven(legs, 3, wheels=wheels)).mounting.faults


@pytest.mark.parametrize("delay", first_of([0.6, 2.0, 0.0]))
def test_the_latency_of_a_speed_is_measured(delay):
    wheels = Wheels(delay=delay)
    estimator = follow(driven(city_legs(8), 8, wheels=wheels, receiver=None))
    assert estimator.speedometer.tracks[ODOMETRY].delay == pytest.approx(delay, abs=0.2)


def directions(drive, after):
    """Signs of travel at the ends of trips: estimated and true."""
    ends = np.flatnonzero(
        (np.abs(drive.truth.speed[:-1]) > 0.8) & (np.abs(drive.truth.speed[1:]) <= 0.8)
    )
    moments = iter([t for t in drive.time[ends] if t > drive.time[0] + after])
    true, taken = [], []
    moment = next(moments)

    def watch(estimator, stamp):
        nonlocal moment
        if stamp >= moment:
            true.append(np.sign(np.interp(moment - 0.3, drive.time, drive.truth.speed)))
            # Slow parking stays undecided, and counts as forwards until then.
            trip = estimator.acceleration.trip_at(stamp)
            taken.append(trip.sign if trip.is_clear else 0.0)
            moment = next(moments, math.inf)

    follow(drive, watch=watch)
    return np.array(true), np.array(taken)


@pytest.mark.nightly
def test_an_unsigned_speed_gets_its_sign_from_the_force():
    rng = np.random.default_rng(9)
    legs = joined(city(rng, 100.0), reversing(rng, 12, share=0.5))
    drive = driven(legs, 9, Vehicle(ROBOT, imu_yaw=0.4), wheels=Wheels(is_signed=False))
    true, taken = directions(drive, 100.0)
    assert len(true) > 8
    assert (true < 0.0).any()
    assert (true * taken >= 0.0).all()
    assert np.count_nonzero(taken) > 0.7 * len(true)


UNSIGNED = {
    "wheels": {"wheels": Wheels(is_signed=False)},
    "receiver": {"wheels": None, "receiver": Receiver(speed_noise=0.1)},
}


@pytest.mark.nightly
@pytest.mark.parametrize("seed", first_of([13, 35]))
def test_driving_backwards_right_after_forwards_is_detected(seed):
    """The forces of the way before, of another sign, are no part of what this one tells."""
    rng = np.random.default_rng(seed)
    legs = joined(city(rng, 100.0), reversing(rng, 2, share=0.8))
    drive = driven(legs, seed, Vehicle(ROBOT, imu_yaw=0.4), **UNSIGNED["wheels"])
    true, taken = directions(drive, 100.0)
    assert (true < 0.0).any()
    assert (true * taken > 0.0).all()


@pytest.mark.nightly
@pytest.mark.timeout(900)
@pytest.mark.parametrize("reported", UNSIGNED.values(), ids=UNSIGNED)
def test_the_direction_of_travel_is_correct_in_a_thousand_trips(reported):
    wrong = undecided = trips = 0
    for seed in range(50):
        rng = np.random.default_rng(seed)
        legs = joined(city(rng, 100.0), reversing(rng, 20), parking(rng))
        drive = driven(legs, seed, Vehicle(ROBOT, imu_yaw=0.4), **reported)
        true, taken = directions(drive, 100.0)
        trips, wrong = trips + len(true), wrong + int((true * taken < 0.0).sum())
        undecided += int((taken == 0.0).sum())
    assert trips > 1000
    assert wrong == 0
    assert undecided < 0.01 * trips


def test_parking_does_not_reverse_the_direction():
    rng = np.random.default_rng(10)
    legs = joined(city(rng, 120.0), parking(rng), [Leg(5.0)])
    vehicle = Vehicle(ROBOT, imu_yaw=-0.3)
    found = follow(driven(legs, 10, vehicle, wheels=Wheels(is_signed=False))).known_mounting
    assert abs(error(found, -0.3)) < 3.0 * math.degrees(found.sigma)
