from collections import Counter

import pytest

from magcal_ros.core.samples import (
    DropReason,
    FieldSample,
    ImuSample,
    InputCounts,
    Streams,
    complaints,
)


def streams(field_ahead=0.0, max_gap=0.2):
    both = Streams(max_gap)
    for k in range(50):
        stamp = 1e5 + 0.01 * k
        both.add_imu(ImuSample(stamp, (0.0, 0.0, 9.8), (0.0, 0.0, 0.0)))
        both.add_field(FieldSample(stamp + field_ahead, (2e-5, 1e-9 * k, -4e-5)))
    return both


def stated(both=None, imu=None, mag=None):
    imu, mag = imu or InputCounts("/imu", 100), mag or InputCounts("/mag", 100)
    return complaints(both or streams(), imu, mag)


def test_correct_streams_cause_no_complaint():
    assert stated() == []


@pytest.mark.parametrize(
    "drop", [DropReason.NOT_FINITE, DropReason.ZERO, DropReason.BACKWARD_STAMP]
)
def test_dropped_samples_are_reported_with_topic_and_count(drop):
    (words,) = stated(imu=InputCounts("/imu", 100, Counter({drop: 7})))
    assert words.startswith("/imu: 7 of 100 ")
    assert stated(mag=InputCounts("/mag", 1000, Counter({drop: 7}))) == []


def test_an_imu_beyond_every_unit_is_reported():
    (words,) = stated(imu=InputCounts("/imu", 100, Counter({DropReason.TOO_LARGE: 50})))
    assert "too large for an acceleration in m/s² or a rate in rad/s" in words


@pytest.mark.parametrize("ahead", [-9.0, -1.5, 0.4, 0.6, 3.0, 86_400.0])
def test_an_offset_between_stamps_is_reported(ahead):
    (words,) = stated(streams(ahead))
    assert f"{ahead:+.1f} s apart" in words


def test_bursts_are_reported_with_their_topic():
    both = Streams(0.2)
    for k in range(500):
        read = 1e5 + k // 40 + 0.0025 * (k % 40)
        both.add_imu(ImuSample(1e5 + 0.025 * k, (0.0, 0.0, 9.8), (0.0, 0.0, 0.0)))
        both.add_field(FieldSample(read, (2e-5, 1e-9 * k, -4e-5)))
    (words,) = stated(both)
    assert words.startswith("/mag: the stamps come in bursts, 0.90 s apart")


@pytest.mark.parametrize("ahead", [-0.6, -0.05, 0.0, 0.05, 0.2])
def test_a_late_or_slightly_early_field_causes_no_complaint(ahead):
    assert stated(streams(ahead)) == []


def test_a_slow_imu_within_the_allowed_gap_causes_no_complaint():
    assert stated(streams(0.5, max_gap=0.5)) == []


@pytest.mark.parametrize("dies", [ImuSample, FieldSample])
def test_the_last_stamp_of_a_silent_sensor_shows_no_clock_offset(dies):
    both = streams()
    for k in range(500):
        if dies is FieldSample:
            both.add_imu(ImuSample(1e5 + 1.0 + k, (0.0, 0.0, 9.8), (0.0, 0.0, 0.0)))
        else:
            both.add_field(FieldSample(1e5 + 1.0 + k, (2e-5, 1e-9 * k, -4e-5)))
    assert stated(both) == []


def test_an_earlier_fault_causes_no_complaint_later():
    then = InputCounts("/imu", 1000, Counter({DropReason.NOT_FINITE: 900}))
    now = InputCounts("/imu", 2000, Counter({DropReason.NOT_FINITE: 905}))
    assert stated(imu=now)
    assert stated(imu=now.since(then)) == []


def test_a_fault_after_a_long_correct_time_is_reported():
    then = InputCounts("/mag", 10**8, Counter({DropReason.ZERO: 3}))
    now = InputCounts("/mag", 10**8 + 3000, Counter({DropReason.ZERO: 3003}))
    assert stated(mag=now) == []
    (words,) = stated(mag=now.since(then))
    assert words.startswith("/mag: 3000 of 3000 samples are all zero: the driver reads nothing")


def test_a_value_that_stays_while_the_robot_turns_is_that_of_a_frozen_sensor():
    both = streams()
    for k in range(5):
        both.add_field(FieldSample(2e5 + k, (2e-5, 0.0, -4e-5)), 0.3 * k)
    (words,) = [each for each in stated(both) if "repeats" in each]
    assert words == (
        "/mag repeats one value although the robot has turned by 69°: the sensor is frozen, "
        "restart its driver"
    )
    both.add_field(FieldSample(3e5, (2e-5, 1e-9, -4e-5)), 1.5)
    assert not any("repeats" in each for each in stated(both))
