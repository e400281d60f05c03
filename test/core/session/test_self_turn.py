"""A robot that turns itself, in virtual time: its commands, and every reason to stop it."""

import math

import numpy as np
import pytest
from long_form import first_of
from scene import NO_RATE, Scene

from magcal_ros.core.samples import ImuSample
from magcal_ros.core.session import TurnState
from magcal_ros.core.session.session_tuning import SELF_TURN, SESSION

SPEED = 0.5


def robot(**options):
    scene = Scene(**{"speed": SPEED, **options})
    assert scene.open().success
    return scene


def with_rate(change):
    """Change the rate of the gyro by `change`."""

    def mangle(sample):
        if isinstance(sample, ImuSample):
            return sample._replace(rate=tuple(change(np.array(sample.rate)).tolist()))
        return sample

    return mangle


def test_the_robot_turns_once_each_way_and_ends_at_its_first_heading():
    scene = robot()
    conclusion = scene.until_concluded()
    assert conclusion.success, conclusion.message
    scene.assert_stopped_and_silent()
    rates = np.array([rate for _, rate in scene.stated])
    assert (rates.max(), rates.min()) == (SPEED, -SPEED)
    assert np.abs(np.diff(rates)).max() < 0.5 * 0.1
    assert np.all(np.diff(np.sign(rates[rates != 0.0])) <= 0.0), "left first, then right"
    assert scene.turned == pytest.approx(0.0, abs=0.2)


def test_without_a_gyro_the_compass_controls_the_turn():
    scene = robot(gyro=False)
    assert scene.until_concluded().success
    assert scene.farthest == pytest.approx(math.tau, abs=0.5)
    assert scene.turned == pytest.approx(0.0, abs=0.5)


def test_there_is_no_command_before_both_sensors_and_a_base_are_present():
    scene = robot()
    scene.mangle = lambda sample: sample if isinstance(sample, ImuSample) else None
    scene.live(2.0)
    scene.mangle, scene.listeners = (lambda sample: sample), 0
    scene.live(0.5)
    assert not scene.stated
    scene.listeners = 1
    scene.until_moving()


def test_a_missing_subscription_of_the_commands_is_reported_with_the_topic():
    scene = robot()
    scene.listeners = 0
    assert "nothing subscribes to /cmd_vel" in scene.until_concluded(5.0).message
    assert not scene.stated


def test_without_a_guard_the_turn_does_not_start_and_the_reason_is_given():
    scene = robot()
    scene.is_guarded = False
    words = scene.until_concluded(20.0).message
    assert words.startswith("the robot does not start to turn: the guard")
    assert not scene.stated


@pytest.mark.nightly
def test_the_turn_waits_for_a_slow_guard():
    scene = robot()
    scene.is_guarded = False
    scene.live(5.0)
    assert not scene.stated
    scene.is_guarded = True
    assert scene.until_concluded().success


@pytest.mark.nightly
def test_the_robot_first_stands_still_so_that_a_rest_is_measured():
    scene = robot()
    scene.live(SESSION.rest - 0.3)
    assert not scene.stated
    assert scene.until_concluded().success
    assert scene.turn.last_window.rests[0].seconds > SESSION.rest - 1.0


def test_the_end_of_the_guard_ends_the_turn():
    scene = robot()
    scene.until_moving()
    scene.is_guarded = False
    since = scene.now
    assert (
        "the robot was stopped: the guard process has ended" in scene.until_concluded(1.0).message
    )
    assert scene.now - since < 0.1
    scene.assert_stopped_and_silent()


def test_a_turn_longer_than_the_window_is_refused_at_the_start():
    scene = Scene(speed=SPEED, timeout=20.0)
    answer = scene.open()
    assert not answer.success
    assert "window.timeout_s" in answer.message
    assert scene.turn.state is TurnState.IDLE


@pytest.mark.parametrize(
    ("gain", "words", "gyro"),
    [
        (0.0, "does not turn", True),
        (0.0, "does not turn", False),
        (-1.0, "base turns the wrong way", True),
        (3.0, "far too fast", True),
        (3.0, "far too fast", False),
    ],
)
def test_a_base_that_disobeys_is_stopped_and_the_fault_named(gain, words, gyro):
    scene = robot(gain=gain, gyro=gyro)
    conclusion = scene.until_concluded(10.0)
    assert not conclusion.success
    assert conclusion.message.startswith("the robot was stopped: ")
    assert words in conclusion.message
    scene.assert_stopped_and_silent()


def test_a_mirrored_gyro_is_not_blamed_on_the_base():
    scene = robot()
    scene.mangle = with_rate(lambda rate: -rate)
    assert "the gyro is mirrored" in scene.until_concluded(10.0).message


def test_an_emergency_stop_in_the_turn_ends_it():
    scene = robot()
    scene.until_moving()
    scene.gain = 0.0
    assert "emergency stop" in scene.until_concluded(10.0).message


@pytest.mark.parametrize(("kind", "topic"), [(True, "/imu"), (False, "/mag")])
def test_a_silent_sensor_stops_the_robot_long_before_the_session_ends(kind, topic):
    scene = robot()
    scene.until_moving()
    scene.mangle = lambda s: None if isinstance(s, ImuSample) is kind else s
    since = scene.now
    words = scene.until_concluded(5.0).message
    assert words.startswith(f"the robot was stopped: {topic} has been silent")
    assert scene.now - since < 1.2
    scene.assert_stopped_and_silent()


def test_a_fault_of_the_conditions_stops_only_a_robot_that_turns_itself():
    scene = robot()
    scene.until_moving()
    scene.tell("stop_robot", "an error in a callback", scene.now)
    assert scene.stated[-1] == (scene.now, 0.0)
    assert scene.conclusion.message.startswith("the robot was stopped: an error in a callback")
    scene.assert_stopped_and_silent()
    by_hand = Scene()
    by_hand.open()
    by_hand.tell("stop_robot", "an error in a callback", by_hand.now)
    assert by_hand.turn.state is TurnState.COLLECTING


def test_disabling_rotation_stops_the_robot():
    scene = robot()
    scene.until_moving()
    scene.is_allowed = False
    scene.live(0.1)
    assert "rotate.enabled was switched off" in scene.conclusion.message
    scene.assert_stopped_and_silent()


@pytest.mark.parametrize("event", ["cancel", "finish"])
def test_ending_the_turn_stops_the_robot_immediately(event):
    scene = robot()
    scene.until_moving()
    scene.tell(event, *([scene.now] if event == "finish" else []))
    assert scene.stated[-1] == (scene.now, 0.0)
    scene.assert_stopped_and_silent()


def test_a_new_turn_may_begin_while_the_zeros_of_the_last_are_sent():
    scene = robot()
    scene.until_moving()
    scene.tell("cancel")
    scene.live(0.1)
    assert scene.open().success
    scene.until_moving()
    rates = [rate for _, rate in scene.stated]
    assert rates[rates.index(0.0) :][: SELF_TURN.zeros] == [0.0] * SELF_TURN.zeros
    scene.live(60.0, stop=lambda: len(scene.concluded) > 1)
    assert scene.conclusion.success


class TestGyro:
    """A gyro that controls the robot must keep sending, and be correct."""

    @pytest.mark.parametrize("rate", [NO_RATE, (math.inf, 0.0, 0.0)])
    @pytest.mark.parametrize("moment", first_of([11.0, 3.0, 16.0]))
    def test_a_silent_gyro_stops_the_robot_within_half_a_second(self, rate, moment):
        scene = robot()
        scene.live(moment)
        scene.mangle = with_rate(lambda _: np.array(rate))
        since, before = scene.now, scene.swept
        words = scene.until_concluded(20.0).message
        assert "the gyro sends no data" in words
        assert "/imu has had no angular velocity" in words
        assert scene.now - since < SELF_TURN.gyro_silence + 0.15
        scene.assert_stopped_and_silent()
        assert scene.swept - before < math.radians(30.0)

    @pytest.mark.parametrize("gain", first_of([-1.0, 0.0, 3.0]))
    def test_zeros_follow_if_gyro_and_base_fail_together(self, gain):
        scene = robot()
        scene.live(3.0)
        scene.gain = gain
        scene.mangle = with_rate(lambda _: np.array(NO_RATE))
        since = scene.now
        assert not scene.until_concluded(20.0).success
        assert scene.now - since < SELF_TURN.gyro_silence + 0.15
        scene.assert_stopped_and_silent()

    @pytest.mark.nightly
    def test_a_short_dropout_does_not_stop_the_robot(self):
        scene = robot()
        scene.live(3.0)
        scene.mangle = with_rate(lambda _: np.array(NO_RATE))
        scene.live(0.3)
        scene.mangle = lambda sample: sample
        assert scene.until_concluded().success

    @pytest.mark.parametrize("frozen_at", first_of([0.1, 0.02, 0.2]))
    def test_a_gyro_that_freezes_below_the_rate_is_detected_within_a_quarter_turn(self, frozen_at):
        scene = robot()
        scene.mangle = with_rate(lambda rate: np.array([0.0, 0.0, min(rate[2], frozen_at)]))
        words = scene.until_concluded().message
        assert "the gyro" in words
        assert scene.farthest < math.radians(115.0)
        scene.assert_stopped_and_silent()

    def test_a_frozen_gyro_is_detected_although_the_base_is_blocked(self):
        scene = robot()
        scene.until_moving(0.45)
        scene.gain = 0.0
        scene.mangle = with_rate(lambda _: np.array([0.0, 0.0, SPEED]))
        since = scene.now
        words = scene.until_concluded().message
        assert "but the field did not change" in words
        assert scene.now - since < math.radians(115.0) / SPEED

    def test_a_frozen_gyro_is_not_attributed_to_the_base_and_the_turn_stays_short(self):
        scene = robot()
        scene.until_moving(0.45)
        scene.mangle = with_rate(lambda _: np.array([0.0, 0.0, SPEED]))
        assert "the gyro measured" in scene.until_concluded().message
        assert scene.farthest < math.tau + math.radians(60.0)
        scene.assert_stopped_and_silent()

    def test_saturation_at_a_third_of_the_rate_is_detected(self):
        scene = robot(speed=0.9)
        scene.mangle = with_rate(lambda rate: np.clip(rate, -0.3, 0.3))
        assert "the gyro measured" in scene.until_concluded().message
        assert scene.farthest < math.radians(115.0)

    def test_a_slipping_base_with_a_correct_gyro_is_not_stopped(self):
        scene = robot(gain=0.7)
        assert scene.until_concluded().success


class TestBounds:
    def test_a_base_that_does_not_stop_ends_the_turn_beyond_a_full_circle(self):
        scene = robot(speed=1.0)
        scene.live(60.0, stop=lambda: scene.turned > math.radians(330.0))

        def run_on(sample):
            scene.rate = 1.0
            return sample

        scene.mangle = run_on
        conclusion = scene.until_concluded(20.0)
        assert "outside the planned turn from 0° to 360°" in conclusion.message
        assert scene.farthest < math.radians(415.0)

    def test_commands_end_even_without_a_fault(self):
        scene = robot(gain=0.45)
        conclusion = scene.until_concluded(200.0)
        commanded = sum(
            abs(rate) * (after - before)
            for (before, rate), (after, _) in zip(scene.stated, scene.stated[1:], strict=False)
        )
        assert commanded < 1.55 * 2.0 * math.tau
        assert not conclusion.success
        assert "were commanded, but the turn is not complete: +2" in conclusion.message

    def test_the_deadline_ends_a_slow_turn_and_its_samples_are_used(self):
        scene = robot(gain=0.75, timeout=29.0)
        conclusion = scene.until_concluded(60.0)
        assert "did not complete its turn in time" in conclusion.message
        assert scene.stated[-1][1] == 0.0

    @pytest.mark.parametrize("phase", [3.0, 15.0])
    def test_after_a_pause_of_the_supervision_the_robot_is_stopped(self, phase):
        scene = robot()
        scene.live(phase)
        before = len(scene.stated)
        scene.freeze(12.9)
        scene.live(0.2)
        assert [rate for _, rate in scene.stated[before:]] == [0.0] * (len(scene.stated) - before)
        assert "too busy to supervise the robot for 1" in scene.conclusion.message
        scene.assert_stopped_and_silent()

    @pytest.mark.nightly
    def test_a_short_pause_of_the_supervision_is_allowed(self):
        scene = robot()
        scene.live(3.0)
        scene.freeze(0.8 * SELF_TURN.gyro_silence)
        assert scene.until_concluded().success
