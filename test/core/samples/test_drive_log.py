"""The samples that a recorder keeps of a drive, and the gyro's bias at its rests."""

import math

import numpy as np
import pytest

from magcal_ros.core.geometry import integral
from magcal_ros.core.samples import (
    STREAMS,
    DriveRecorder,
    FieldSample,
    ImuSample,
    Pair,
    Pairer,
    Streams,
)

BIAS = np.radians([3.5, -2.0, 1.9])
STEP = 0.02


class Ride:
    """Stands and turns, and passes the samples to a recorder."""

    def __init__(self, recorder, noise=0.002, seed=1):
        self.recorder, self.noise = recorder, noise
        self.rng = np.random.default_rng(seed)
        self.stamp = self.yaw = 0.0
        self.iron, self.switching = np.zeros(3), 0.0

    def go(self, seconds, rate=0.0, bias=BIAS):
        for _ in range(round(seconds / STEP)):
            self.stamp += STEP
            self.yaw += rate * STEP
            field = 1e-6 * np.array([20.0 * math.cos(self.yaw), -20.0 * math.sin(self.yaw), -40.0])
            field += self.rng.normal(0.0, 1e-7, 3) + self.iron
            field += self.switching * self.rng.normal(0.0, 1.0, 3)
            force = np.array([0.0, 0.0, 9.81]) + self.rng.normal(0.0, 0.02, 3)
            spin = bias + np.array([0.0, 0.0, rate]) + self.rng.normal(0.0, self.noise, 3)
            imu = ImuSample(self.stamp, tuple(force), tuple(spin))
            self.recorder.add(Pair(FieldSample(self.stamp, tuple(field)), imu))


@pytest.fixture
def ride():
    return Ride(DriveRecorder(600.0))


def span_of(log, start, end):
    """The rows of a span of stamps, seconds."""
    return log.take((log.time >= start) & (log.time <= end))


def left_over(log, rate):
    """Bias that is left in the rates of a log, rad/s."""
    return log.angular_rate.mean(axis=0) - [0.0, 0.0, rate]


def test_a_rest_shows_the_bias_which_is_subtracted(ride):
    ride.go(8.0)
    ride.go(20.0, rate=0.4)
    log = ride.recorder.log()
    # A rest is recognised only after some seconds.
    turning = span_of(log, log.time[-1] - 15.0, log.time[-1])
    assert np.abs(left_over(turning, 0.4)).max() < 5e-4
    assert log.bias_sigma < 0.035 * np.linalg.norm(BIAS)
    assert turning.bias_sigma == log.bias_sigma


def test_the_bias_is_also_subtracted_before_the_rest(ride):
    ride.go(20.0, rate=0.4)
    before = ride.recorder.log()
    assert math.isinf(before.bias_sigma)
    assert left_over(before, 0.4) == pytest.approx(BIAS, abs=1e-3)
    ride.go(12.0)
    after = span_of(ride.recorder.log(), 0.0, 19.0)
    assert np.abs(left_over(after, 0.4)).max() < 1e-3


def test_a_changing_bias_follows_the_newest_rests(ride):
    ride.go(60.0)
    ride.go(10.0, rate=0.4)
    ride.go(20.0, rate=0.4, bias=1.1 * BIAS)
    ride.go(10.0, rate=0.4, bias=1.2 * BIAS)
    ride.go(90.0, bias=1.2 * BIAS)
    log = ride.recorder.log()
    middle = span_of(log, log.time[-1] - 30.0, log.time[-1] - 10.0)
    assert np.abs(left_over(middle, 0.4)).max() < 1e-3


def test_a_long_rest_gives_the_bias_of_its_end(ride):
    ride.go(60.0)
    ride.go(90.0, bias=1.2 * BIAS)
    ride.go(20.0, rate=0.4, bias=1.2 * BIAS)
    log = ride.recorder.log()
    turning = span_of(log, log.time[-1] - 15.0, log.time[-1])
    assert np.abs(left_over(turning, 0.4)).max() < 2e-2 * np.linalg.norm(BIAS)


@pytest.mark.parametrize("rate", [0.05, -0.4])
def test_an_even_turn_is_no_rest(ride, rate):
    ride.go(30.0, rate=rate)
    assert math.isinf(ride.recorder.log().bias_sigma)


def test_another_sensor_restarts_the_bias(ride):
    ride.go(10.0)
    assert math.isfinite(ride.recorder.log().bias_sigma)
    ride.recorder.begin_anew()
    assert math.isinf(ride.recorder.log().bias_sigma)


def test_without_a_rest_nothing_is_subtracted():
    log = DriveRecorder(600.0).log()
    assert not len(log)
    assert math.isinf(log.bias_sigma)


@pytest.mark.parametrize("jump", [18000.0, 10.0, -18000.0, 2e9])
def test_a_jump_of_time_starts_a_new_piece(ride, jump):
    ride.go(20.0, rate=0.4)
    ride.stamp += jump
    ride.go(20.0, rate=0.4)
    log = ride.recorder.log()
    steps = np.diff(log.time)
    assert 36.0 < ride.recorder.seconds < 41.0
    assert (steps > 0.0).all()
    assert np.count_nonzero(steps > STREAMS.longest_gyro_step) == 1


@pytest.mark.parametrize("seconds", [0.1, 1.0, 4.0])
@pytest.mark.parametrize("jump", [18000.0, -18000.0])
def test_a_single_wrong_stamp_is_dropped(ride, jump, seconds):
    ride.go(20.0, rate=0.4)
    ride.stamp += jump
    ride.go(seconds, rate=-0.4)
    ride.stamp -= jump
    ride.go(20.0, rate=0.4)
    assert 36.0 < ride.recorder.seconds < 41.0
    assert (ride.recorder.log().angular_rate[:, 2] > 0.0).all()


def test_constant_jumps_of_time_leave_no_log(ride):
    for _ in range(20):
        ride.go(2.0, rate=0.4)
        ride.stamp += 100.0
    assert ride.recorder.seconds < 4.0


def test_beginning_and_end_of_a_rest_are_kept(ride):
    ride.go(20.0, rate=0.4)
    ride.go(60.0)
    ride.go(20.0, rate=0.4)
    log = ride.recorder.log()
    assert 6.0 < 0.1 * np.count_nonzero(log.rested) < 10.0
    moving = np.abs(log.angular_rate[:, 2]) > 0.2
    assert not (log.rested & moving).any()
    assert np.diff(log.time) == pytest.approx(np.full(len(log) - 1, 0.1), abs=0.03)


def test_added_iron_does_not_end_a_rest(ride):
    ride.go(20.0, rate=0.4)
    ride.go(30.0)
    ride.iron = np.array([10e-6, 0.0, 0.0])
    ride.go(2.5)
    ride.go(20.0, rate=0.4)
    log = ride.recorder.log()
    strength = np.linalg.norm(log.field[:, :2], axis=1)[log.rested]
    assert strength.min() == pytest.approx(20e-6, abs=1e-6)
    field = log.field[log.rested]
    assert np.linalg.norm(field[-1] - field[0]) == pytest.approx(10e-6, abs=1e-6)


def test_a_switching_field_makes_a_rest_uncertain(ride):
    ride.go(20.0, rate=0.4)
    ride.go(12.0)
    ride.switching = 4e-6
    ride.go(4.0)
    ride.switching = 0.0
    ride.go(20.0, rate=0.4)
    log = ride.recorder.log()
    spread = log.field[log.rested].std(axis=0)
    assert spread.max() < 0.5e-6
    assert log.rested.sum() < 60


def test_a_gap_at_rest_does_not_advance_the_clock(ride):
    ride.go(20.0, rate=0.4)
    ride.go(20.0)
    before = ride.recorder.clock
    ride.stamp += 600.0
    ride.go(20.0, rate=0.4)
    assert ride.recorder.clock - before < 22.0


def test_discarded_movement_still_counts():
    long, short = Ride(DriveRecorder(600.0)), Ride(DriveRecorder(20.0))
    for ride in (long, short):
        ride.go(8.0)
        ride.stamp += 500.0
        ride.go(3.0, rate=0.4)
        ride.stamp += 1000.0
        ride.go(60.0, rate=0.4)
    assert short.recorder.seconds < 25.0
    assert short.recorder.moved == long.recorder.moved == long.recorder.seconds


def turned_by(log):
    """Return the angles turned to the left by the window of a log."""
    attitude = log.steps.attitude
    return np.unwrap(np.arctan2(attitude[:, 0, 1], attitude[:, 0, 0]))


def test_the_path_contains_every_imu_sample():
    """Once a field sample comes, the gyro has turned by more than its last rate shows."""
    recorder, streams = DriveRecorder(600.0), Streams(STREAMS.max_gap)
    pairer, stamps = Pairer(streams), 1.0 + 0.01 * np.arange(6000)
    rates = 0.3 + 2.0 * np.cos(math.tau * 7.3 * stamps)
    angles = integral(stamps, rates)
    for row, (stamp, rate, angle) in enumerate(zip(stamps, rates, angles, strict=True)):
        imu = ImuSample(stamp, (0.0, 0.0, 9.81), (0.0, 0.0, rate))
        streams.add_imu(imu)
        if row % 11 == 0:
            field = 20e-6 * math.cos(angle), -20e-6 * math.sin(angle), -40e-6
            pairer.offer(FieldSample(stamp, field))
            for pair in pairer.take():
                recorder.add(pair)
    log = recorder.log()
    turned = turned_by(log)
    truth = np.interp(log.time, stamps, angles)
    np.testing.assert_allclose(turned, truth - truth[0], atol=1e-6)
    np.testing.assert_allclose(log.steps.velocity[:, 2], 1.0791, atol=1e-9)
    half = span_of(log, 20.0, 40.0)
    assert len(half.missed.velocity) == len(half) - 1
    np.testing.assert_allclose(half.steps.velocity[:, 2], 1.0791, atol=1e-9)


def test_the_path_is_straight_across_an_omitted_rest(ride):
    ride.go(20.0, rate=0.4)
    ride.go(120.0)
    ride.go(20.0, rate=0.4)
    log = ride.recorder.log()
    turned = turned_by(log)
    assert turned[-1] == pytest.approx(16.0, abs=0.3)
