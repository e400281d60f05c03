"""With a speed, up is correct in starts, stops and bends; a wrong speed does not make it worse."""

import functools
import math

import numpy as np
import pytest
from follow_drive import ROBOT, driven, tilts
from long_form import first_of
from simulated import Receiver, Vehicle, Wheels, circles, city

from magcal_ros.core.driving import TravelEstimator
from magcal_ros.core.samples import ImuSample, PositionSample, SpeedSample, VelocitySample

VEHICLE = Vehicle(ROBOT, imu_yaw=0.1, imu_roll=0.05)
KINDS = {
    "odometry": {"receiver": None},
    "velocity": {"wheels": None, "receiver": Receiver(speed_noise=0.1)},
    "fixes": {"wheels": None, "receiver": Receiver()},
}


def city_legs(seed, seconds=150.0):
    return city(np.random.default_rng(seed), seconds)


@functools.cache
def tilts_without(seed):
    """Without a speed; the samples of wheels and receiver change no other sensor."""
    return tilts(driven(city_legs(seed), seed, VEHICLE))


@pytest.mark.nightly
@pytest.mark.parametrize("case", first_of([("fixes", 1.2), ("odometry", 0.5), ("velocity", 1.3)]))
def test_stop_and_go_does_not_tilt_up(case):
    kind, bound = case
    drive = driven(city_legs(1), 1, VEHICLE, **KINDS[kind])
    with_it, without = tilts(drive, TravelEstimator()), tilts_without(1)
    assert np.percentile(with_it, 90) < bound
    assert np.percentile(with_it, 90) < np.percentile(without, 90) + 0.2


@pytest.mark.nightly
@pytest.mark.parametrize(
    "wheels",
    first_of(
        [
            Wheels(scale=3.6),
            Wheels(delay=3.0),
            Wheels(frozen_from=40.0),
            Wheels(jumps=0.1),
            Wheels(frozen_from=0.0),
            Wheels(is_signed=False),
        ],
    ),
)
def test_wrong_odometry_does_not_make_up_worse(wheels):
    with_it, without = [], []
    for seed in range(2, 10):
        drive = driven(city_legs(seed), seed, VEHICLE, wheels=wheels, receiver=None)
        with_it.append(tilts(drive, TravelEstimator()))
        without.append(tilts_without(seed))
    rms = [math.sqrt(np.mean(np.square(np.concatenate(each)))) for each in (with_it, without)]
    assert rms[0] < 1.1 * rms[1]


@pytest.mark.nightly
@pytest.mark.parametrize("wheels", first_of([Wheels(rate=1.0), Wheels(jumps=0.01)]))
def test_slow_wheels_and_single_outliers_do_no_harm(wheels):
    drive = driven(city_legs(2), 2, VEHICLE, wheels=wheels, receiver=None)
    with_it = np.percentile(tilts(drive, TravelEstimator()), 90)
    assert with_it < 1.3
    assert with_it < np.percentile(tilts_without(2), 90) + 0.2


def test_a_reversed_imu_is_detected_before_it_does_harm():
    drive = driven(city_legs(3), 3, Vehicle(ROBOT, imu_yaw=3.0), receiver=None)
    with_it, without = tilts(drive, TravelEstimator()), tilts(drive)
    assert np.percentile(with_it, 90) < np.percentile(without, 90)


@pytest.mark.nightly
def test_a_circle_by_fixes_alone_does_not_tilt_up():
    drive = driven(circles(60.0), 4, VEHICLE, **KINDS["fixes"])
    with_it, without = tilts(drive, TravelEstimator()), tilts(drive)
    assert np.percentile(with_it, 90) < np.percentile(without, 90) + 0.3


def test_without_a_speed_nothing_is_subtracted():
    estimator = TravelEstimator()
    assert estimator.add_imu(ImuSample(1.0, (0.0, 0.0, 9.8), (0.0, 0.0, 0.1)), (0.0,) * 3) is None
    assert not estimator.has_samples


@pytest.mark.parametrize("wild", [math.nan, math.inf, -math.inf, 1e300])
def test_impossible_speeds_are_left_out(wild):
    estimator = TravelEstimator()
    drive = driven(city_legs(5, 20.0), 5, VEHICLE)
    for count, sample in enumerate(drive.samples()):
        if isinstance(sample, ImuSample):
            acceleration = estimator.add_imu(sample, (0.0,) * 3)
            assert acceleration is None or math.isfinite(sum(acceleration.vector))
        if count % 50 == 0:
            estimator.add_travel(SpeedSample(sample.stamp, wild))
            estimator.add_travel(VelocitySample(sample.stamp, wild, 0.0, 0.1))
            estimator.add_travel(PositionSample(sample.stamp, 0.0, wild))
            estimator.add_travel(SpeedSample(wild, 3.0))
        if isinstance(sample, SpeedSample):
            estimator.add_travel(sample)
            # A stamp that goes back is ignored.
            estimator.add_travel(sample._replace(stamp=sample.stamp - 1.0, speed=50.0))
    assert estimator.speedometer.track is not None


def test_time_that_is_set_back_restarts_the_estimate():
    estimator = TravelEstimator()
    drive = driven(city_legs(6, 40.0), 6, VEHICLE)
    for _ in range(2):
        for sample in drive.samples():
            if isinstance(sample, ImuSample):
                acceleration = estimator.add_imu(sample, (0.0,) * 3)
                assert acceleration is None or max(map(abs, acceleration.vector)) < 20.0
            elif isinstance(sample, SpeedSample):
                estimator.add_travel(sample)
    assert estimator.acceleration.is_measured
