"""Up is correct on circles, starts, stops and ramps, and with faulty messages."""

import dataclasses
import math

import numpy as np
import pytest
from examples import examples
from hypothesis import given
from hypothesis import strategies as st
from long_form import first_of
from moving import DEGREE, FORWARD, LEFT, ROBOT, Course, TiltErrors

from magcal_ros.core.samples import ImuSample
from magcal_ros.core.up import LinearAcceleration, UpFollower
from magcal_ros.files import read_csv_folder

G = 9.80665
NO_RATE = (math.nan,) * 3
MIRRORED = (-1.0, -1.0, -1.0)


@pytest.fixture
def watched():
    """Return a robot that can be driven, and the errors of its estimated up."""
    errors = TiltErrors(UpFollower())
    return Course(errors), errors


def test_the_first_message_gives_an_up_vector():
    follower = UpFollower()
    assert follower.at(1.0, 0.2) is None
    follower.add(ImuSample(1.0, (G * math.sin(0.1), 0.0, G * math.cos(0.1)), (0.0, 0.0, 0.01)))
    up = follower.at(1.0, 0.2)
    assert up.direction == pytest.approx((math.sin(0.1), 0.0, math.cos(0.1)))
    assert up.variance > 0.05**2


def test_at_rest_up_is_the_averaged_accelerometer(watched):
    course, errors = watched
    course.ride.stand(0.1, -0.2, 1.0)
    course.go(5.0)
    assert errors.rms(last=200) < 0.15
    assert errors.sigmas[-1] < 0.3


def test_a_circle_does_not_tilt_up(watched):
    """The accelerometer leans by 8.7 degrees."""
    course, errors = watched
    course.go(3.0)
    course.go(1.5, acceleration=2.0 * FORWARD)
    course.circle(30.0)
    assert errors.rms() < 0.6


def test_a_circle_from_the_start_does_not_tilt_up(watched):
    course, errors = watched
    course.circle(30.0)
    assert errors.errors[0] > 8.0
    assert errors.rms(last=1000) < 2.0


@pytest.mark.parametrize("seed", first_of([1, 2, 3]))
def test_starts_and_stops_have_a_short_effect(seed):
    errors = TiltErrors(UpFollower())
    course = Course(errors, seed=seed)
    course.go(3.0)
    for _ in range(4):
        course.go(1.0, acceleration=2.0 * FORWARD)
        course.go(2.0)
        course.go(1.0, acceleration=-2.0 * FORWARD)
        course.go(2.0)
    assert errors.rms() < 0.4


def test_a_ramp_is_followed_immediately(watched):
    course, errors = watched
    course.go(3.0)
    errors.errors.clear()
    course.go(1.0, tipping=-8.0 * DEGREE * LEFT)
    course.go(3.0)
    assert max(errors.errors) < 0.5


def test_a_robot_set_down_elsewhere_is_found_within_a_second(watched):
    course, errors = watched
    course.go(2.0)
    course.ride.stand(6.0 * DEGREE, -4.0 * DEGREE, 2.0)
    course.go(2.0)
    assert max(errors.errors[-100:]) < 0.3


@pytest.mark.nightly
def test_the_variance_is_correct_while_driving():
    ratios = []
    for seed in range(2):
        errors = TiltErrors(UpFollower())
        course = Course(errors, seed=seed)
        course.go(3.0)
        for side in (1.0, -1.0, 1.0):
            course.go(1.0, acceleration=2.0 * FORWARD)
            course.circle(10.0, rate=0.5 * side)
        ratios.append(np.mean(np.square(np.divide(errors.errors, errors.sigmas))))
    assert 0.02 < np.mean(ratios) < 1.3


def with_bias(*bias_deg):
    """A robot whose gyro reads so many degrees per second at rest."""
    robot = dataclasses.replace(ROBOT, gyro_bias=np.array(bias_deg) * DEGREE)
    errors = TiltErrors(UpFollower())
    return Course(errors, robot), errors


BIASES = [(2.2, 0.0, 0.0), (3.5, 2.0, 1.9), (5.0, -5.0, 5.0), (0.0, 0.0, 5.0)]


@pytest.mark.parametrize("bias", first_of(BIASES))
def test_a_large_bias_is_learnt_at_rest_and_in_the_variance_before(bias):
    course, errors = with_bias(*bias)
    course.go(10.0)
    assert np.max(np.divide(errors.errors, errors.sigmas)[:200]) < 2.5
    assert errors.errors[-1] < 0.5
    assert errors.sigmas[-1] < 0.5
    assert np.degrees(errors.follower.gyro_bias.rate) == pytest.approx(bias, abs=0.1)
    course.go(1.0, acceleration=2.0 * FORWARD)
    course.circle(20.0)
    assert errors.rms(last=2000) < 0.8


@pytest.mark.parametrize("bias", first_of(BIASES))
def test_the_bias_at_rest_is_available_after_a_rest_only(bias):
    course, errors = with_bias(*bias)
    follow = errors.follower
    course.circle(15.0)
    assert follow.gyro_at_rest is None
    course.go(10.0)
    reported = follow.gyro_at_rest
    assert np.abs(np.array(reported.rate) - np.radians(bias)).max() < 1e-3
    assert 0.0 < reported.sigma < 1e-3
    course.go(1.0, acceleration=2.0 * FORWARD)
    course.circle(30.0)
    assert np.abs(np.array(follow.gyro_at_rest.rate) - np.radians(bias)).max() < 3e-3


def test_without_a_field_a_bias_about_up_remains_and_up_is_correct():
    course, errors = with_bias(5.0, 0.0, 5.0)
    follow = errors.follower
    follow.add_field = lambda stamp, field: None
    course.go(10.0)
    assert errors.errors[-1] < 0.5
    assert math.degrees(follow.gyro_bias.rate[0]) == pytest.approx(5.0, abs=0.1)


def test_a_slow_even_circle_is_not_taken_for_rest():
    """At 0.08 rad/s and 6 m/s the accelerometer leans by 2.8 degrees, and all is steady."""
    course, errors = with_bias(0.0, 0.0, 0.0)
    course.circle(20.0, rate=0.08, speed=6.0)
    assert abs(errors.follower.gyro_bias.rate[2]) < 0.01
    assert not errors.follower.is_at_rest
    errors.errors.clear()
    course.go(3.0)
    course.circle(20.0, rate=0.08, speed=6.0)
    assert errors.rms(last=2000) < 0.8


def test_a_car_with_a_gyro_bias_has_a_correct_up(recording):
    """It stands for fifteen seconds; the gyro reads 3.5, 2.0 and 1.9 degrees per second."""
    follower = UpFollower()
    samples = read_csv_folder(recording("car_neu2024_yash"))
    still = samples.imu[samples.imu[:, 0] < samples.imu[0, 0] + 15.0]
    mean = still[:, 1:4].mean(axis=0)
    for sample in samples.samples():
        if sample.stamp > still[-1, 0]:
            break
        if isinstance(sample, ImuSample):
            follower.add(sample)
        else:
            follower.add_field(sample.stamp, sample.field)
    up = follower.at(still[-1, 0], 0.2).direction
    assert np.degrees(np.arccos(up @ mean / np.linalg.norm(mean))) < 1.0


def test_a_car_that_circles_from_the_start_has_a_correct_up(recording):
    """Its mean specific force leans by 5 degrees, and by 2 more or less from lap to lap."""
    follower = UpFollower()
    samples = read_csv_folder(recording("car_neu2024_harshith"))
    mean = samples.imu[:, 1:4].mean(axis=0)
    leans = []
    for sample in samples.samples():
        if sample.stamp > samples.imu[0, 0] + 80.0:
            break
        if isinstance(sample, ImuSample):
            follower.add(sample)
            up = follower.at(sample.stamp, 0.2).direction
            leans.append(np.degrees(np.arccos(up @ mean / np.linalg.norm(mean))))
        else:
            follower.add_field(sample.stamp, sample.field)
    assert math.sqrt(np.mean(np.square(leans))) < 5.0


def test_with_a_known_acceleration_stop_and_go_does_not_tilt_up():
    """Never at rest, accelerations of up to 12 degrees; the derivative of the speed errs."""
    errors = TiltErrors(UpFollower())
    printable = TiltErrors(UpFollower())
    rng = np.random.default_rng(4)

    def listen(sample, ride):
        if isinstance(sample, ImuSample):
            noise = 0.15 * rng.standard_normal(3)
            errors.take(sample, ride, LinearAcceleration(tuple(1.03 * linear + noise), 0.15, 0.02))
        printable(sample, ride)

    course = Course(listen, rate=50.0)
    for _ in range(6):
        for forward, rate in ((2.0, 0.0), (0.3, 0.4), (-1.5, 0.0), (-0.8, -0.3)):
            linear = forward * FORWARD + 4.0 * rate * LEFT
            course.go(2.5, acceleration=linear, yaw_rate=rate)
    assert np.percentile(errors.errors, 90) <= 3.0
    assert np.percentile(errors.errors, 90) < 0.5 * np.percentile(printable.errors, 90)


def test_a_wrong_acceleration_tilts_up_little_more_than_none():
    """A speed that is frozen: the measured acceleration is zero all the time."""
    errors, without = TiltErrors(UpFollower()), TiltErrors(UpFollower())

    def listen(sample, ride):
        if isinstance(sample, ImuSample):
            errors.take(sample, ride, LinearAcceleration((0.0, 0.0, 0.0), 0.15, 1.0))
        without(sample, ride)

    course = Course(listen, rate=50.0)
    course.go(5.0)
    for _ in range(6):
        for forward, rate in ((2.0, 0.0), (0.3, 0.4), (-1.5, 0.0), (-0.8, -0.3)):
            course.go(2.5, acceleration=forward * FORWARD + 4.0 * rate * LEFT, yaw_rate=rate)
    assert errors.rms() < 1.1 * without.rms() + 0.1


class TestWithoutGyro:
    def test_the_accelerometer_is_smoothed(self):
        errors = TiltErrors(UpFollower())
        Course(errors, gyro=False).go(3.0)
        assert not errors.follower.is_propagated
        assert 0.0 < errors.rms(last=200) < 0.3

    def test_an_acceleration_tilts_up_and_is_in_the_variance(self):
        errors = TiltErrors(UpFollower())
        course = Course(errors, gyro=False)
        course.go(3.0)
        calm = errors.sigmas[-1]
        for _ in range(3):
            course.go(1.0, acceleration=2.0 * FORWARD)
            course.go(1.0, acceleration=-2.0 * FORWARD)
        assert errors.sigmas[-1] > 10.0 * calm
        assert np.mean(np.square(np.divide(errors.errors, errors.sigmas))[400:]) < 3.0

    def test_a_gyro_that_stops_and_returns_is_used_again(self, watched):
        course, errors = watched
        course.go(3.0)
        course.listener = lambda sample, ride: errors(
            sample._replace(rate=NO_RATE) if isinstance(sample, ImuSample) else sample, ride
        )
        course.go(2.0)
        assert not errors.follower.is_propagated
        course.listener = errors
        course.go(0.02)
        assert errors.follower.is_propagated
        course.go(3.0)
        assert errors.rms() < 0.8

    def test_unset_rates_count_as_no_gyro(self):
        follower = UpFollower()
        for k in range(100):
            follower.add(ImuSample(1.0 + 0.01 * k, (0.0, 0.0, G), (0.0, 0.0, 0.0)))
        assert not follower.is_propagated


def test_a_mirrored_gyro_is_detected(watched):
    course, errors = watched

    def mirror(sample, ride):
        if isinstance(sample, ImuSample):
            sample = sample._replace(rate=tuple(-x for x in sample.rate))
        errors(sample, ride)

    course.listener = mirror
    course.go(2.0)
    for _ in range(6):
        course.go(1.0, tipping=-10.0 * DEGREE * LEFT)
        course.go(1.0, tipping=10.0 * DEGREE * LEFT)
    assert not errors.follower.gyro_is_consistent
    assert errors.rms(last=300) < 3.0


class TestAtAStamp:
    def turning(self):
        follower = UpFollower()
        errors = TiltErrors(follower)
        course = Course(errors)
        course.go(2.0)
        course.go(1.0, tipping=0.5 * FORWARD)
        return follower, course

    def test_before_the_newest_message_up_is_interpolated(self):
        follower, _ = self.turning()
        up = follower.at(12.495, 0.2).direction
        expected = 0.5 * (12.495 - 12.0)
        assert math.atan2(up[1], up[2]) == pytest.approx(expected, abs=0.01)

    def test_after_the_newest_message_the_rotation_continues(self):
        follower, _ = self.turning()
        angles = [
            math.atan2(up.direction[1], up.direction[2])
            for up in (follower.at(13.0, 0.2), follower.at(13.1, 0.2))
        ]
        assert angles[1] - angles[0] == pytest.approx(0.05, abs=0.003)

    def test_beyond_the_largest_gap_there_is_no_up(self):
        follower, _ = self.turning()
        assert follower.at(13.21, 0.2) is None
        assert follower.at(9.0, 0.2) is None


@pytest.mark.parametrize("gap", [0.6, -1.0])
def test_a_gap_or_a_step_back_restarts_the_filter(gap):
    follower = UpFollower()
    Course(TiltErrors(follower)).go(2.0)
    follower.add(ImuSample(12.0 + gap, (G, 0.0, 0.0), (0.0, 0.0, 0.4)))
    up = follower.at(12.0 + gap, 0.2)
    assert up.direction == pytest.approx((1.0, 0.0, 0.0))
    assert up.variance > 0.1**2


@pytest.mark.nightly
@pytest.mark.parametrize("rate", [5.0, 20.0, 1000.0])
def test_slow_and_fast_imus(rate):
    errors = TiltErrors(UpFollower())
    course = Course(errors, rate=rate)
    course.go(3.0)
    course.circle(10.0)
    assert errors.rms() < 1.5


numbers = st.floats(allow_nan=True, allow_infinity=True)
triples = st.one_of(st.tuples(numbers, numbers, numbers), st.tuples(*[st.floats(-20, 20)] * 3))
samples = st.builds(ImuSample, st.floats(0.0, 3.0), triples, triples)


@examples(40)
@given(st.lists(samples, max_size=30))
def test_any_input_gives_a_unit_vector_with_a_variance(messages):
    follower = UpFollower()
    for message in messages:
        follower.add(message)
        for stamp in (message.stamp, message.stamp + 0.1, message.stamp - 0.1):
            up = follower.at(stamp, 0.2)
            if up is not None:
                assert np.linalg.norm(up.direction) == pytest.approx(1.0)
                assert 0.0 < up.variance < math.inf


@examples(3)
@given(st.integers(0, 10_000))
def test_lost_repeated_and_late_messages_do_little_harm(seed):
    rng = np.random.default_rng(seed)
    errors = TiltErrors(UpFollower())
    kept = []

    def mangle(sample, ride):
        if not isinstance(sample, ImuSample):
            return
        chance = rng.random()
        if chance < 0.1:
            return
        kept.append(sample)
        errors(sample, ride)

    course = Course(mangle, ROBOT, seed=seed)
    course.go(3.0)
    course.circle(10.0)
    assert errors.rms() < 1.5
