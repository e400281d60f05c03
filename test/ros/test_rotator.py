"""A robot that turns itself, over real middleware: it obeys cmd_vel or fails to."""

import math
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
from mobile_base import MobileBase
from rclpy.parameter import Parameter
from support import REFERENCE, rms_deg

from magcal_ros.core.streams import FieldSample, ImuSample

TURNING = {**REFERENCE, "rotate.enabled": True, "rotate.speed_rad_s": 0.5}
COMMAND = [sys.executable, "-m", "magcal_ros.cli.main", "calibrate", "--skip-preflight"]
AT_REST = [(0.0, 0.0)]


@pytest.fixture
def base(stage):
    """Return a function that starts the node, a robot and its base."""

    def set_up(parameters=TURNING, gain=1.0, stamped=False, **options):
        return MobileBase(stage(parameters=parameters, **options), stamped, gain)

    return set_up


def test_it_turns_once_each_way_and_stands_where_it_stood(base):
    robot = base({**TURNING, "rotate.stamped": True, "rotate.frame_id": "chassis"}, stamped=True)
    robot.live(0.5)
    assert robot.commands == []
    answer = robot.answer(robot.actor.call("calibrate"))
    assert answer.success, answer.message
    robot.assert_stopped_and_silent()
    rates = np.array(robot.rates)
    assert (rates.max(), rates.min()) == (0.5, -0.5)
    assert np.abs(np.diff(rates)).max() < 0.12
    assert np.all(np.diff(np.sign(rates[rates != 0.0])) <= 0.0), "left first, then right"
    assert {m.header.frame_id for m in robot.messages} == {"chassis"}
    periods = np.diff([moment for moment, _ in robot.commands])
    assert 0.03 < np.median(periods) < 0.08
    assert rms_deg(robot.actor.published_errors(AT_REST, 6)) <= 0.7


def test_without_a_gyro_the_compass_shows_the_turn(base):
    robot = base(gyro=False)
    robot.actor.call("calibrate")
    robot.live(20.0, lambda: robot.command == -0.5)
    assert robot.command == -0.5
    assert robot.actor.answer(robot.actor.call("finish")).success


def test_it_does_not_move_unless_it_is_asked_to(base):
    robot = base({**TURNING, "rotate.enabled": False})
    assert robot.actor.answer(robot.actor.call("start")).success
    robot.live(0.7)
    assert robot.actor.answer(robot.actor.call("cancel")).success
    names = dict(robot.actor.node.get_publisher_names_and_types_by_node("calibrator", "/"))
    assert "/cmd_vel" not in names
    assert robot.commands == []


@pytest.mark.parametrize(
    ("gain", "words"),
    [(0.0, "does not turn"), (-1.0, "base turns the wrong way"), (3.0, "far too fast")],
)
def test_a_base_that_does_not_do_as_told_is_stopped_and_named(base, gain, words):
    robot = base(gain=gain)
    answer = robot.answer(robot.actor.call("calibrate"), 10.0)
    assert not answer.success
    assert answer.message.startswith("the robot ")
    assert words in answer.message
    robot.assert_stopped_and_silent()


def test_a_mirrored_gyro_is_not_blamed_on_the_base(base):
    robot = base()

    def mirror(sample):
        if isinstance(sample, ImuSample):
            return [sample._replace(rate=tuple(-rate for rate in sample.rate))]
        return [sample]

    robot.actor.mangle = mirror
    answer = robot.answer(robot.actor.call("calibrate"), 10.0)
    assert not answer.success
    assert "the gyro is mirrored" in answer.message
    robot.assert_stopped_and_silent()


def test_an_emergency_stop_in_the_turn_ends_it(base):
    robot = base()
    future = robot.actor.call("calibrate")
    robot.live_until_moving()
    robot.gain = 0.0
    answer = robot.answer(future, 10.0)
    assert "emergency stop" in answer.message
    robot.assert_stopped_and_silent()


@pytest.mark.parametrize(
    ("kind", "topic"), [(ImuSample, "/imu/data_raw"), (FieldSample, "/imu/mag")]
)
def test_a_sensor_that_dies_stops_the_robot_long_before_the_session_ends(base, kind, topic):
    robot = base()
    future = robot.actor.call("calibrate")
    robot.live_until_moving()
    robot.actor.mangle = lambda sample: [] if isinstance(sample, kind) else [sample]
    answer = robot.answer(future, 5.0)
    assert f"the robot was stopped: {topic} has been silent" in answer.message
    robot.assert_stopped_and_silent()


@pytest.mark.parametrize("service", ["cancel", "finish"])
def test_services_that_end_the_turn_stop_the_robot(base, service):
    robot = base()
    assert robot.answer(robot.actor.call("start")).success
    robot.live_until_moving()
    robot.answer(robot.actor.call(service))
    robot.assert_stopped_and_silent()


def test_switching_it_off_in_the_turn_stops_the_robot(start_node, actor):
    node = start_node(TURNING)
    robot = MobileBase(actor())
    future = robot.actor.call("calibrate")
    robot.live_until_moving()
    node.set_parameters([Parameter("rotate.enabled", value=False)])
    assert "rotate.enabled was switched off" in robot.answer(future, 5.0).message
    robot.assert_stopped_and_silent()


def test_a_turn_that_would_not_fit_into_the_window_is_refused_before_it_begins(base):
    robot = base({**TURNING, "window.timeout_s": 20.0})
    answer = robot.answer(robot.actor.call("calibrate"), 5.0)
    assert not answer.success
    assert "window.timeout_s" in answer.message
    assert robot.commands == []


def test_a_base_that_does_not_listen_is_said_with_the_topic(stage):
    actor = stage(parameters=TURNING)
    answer = actor.answer(actor.call("calibrate"))
    assert "nobody listens to /cmd_vel" in answer.message


def test_the_command_warns_and_its_ctrl_c_stops_the_robot(base):
    robot = base()
    command = subprocess.Popen(COMMAND, stdout=subprocess.PIPE, text=True)
    robot.live(10.0, lambda: robot.moves)
    command.send_signal(signal.SIGINT)
    robot.live(5.0, lambda: command.poll() is not None)
    robot.live(0.8)
    assert "The robot will turn itself" in command.communicate()[0]
    robot.assert_stopped_and_silent()


FAULTY = """
import sys, threading
from magcal_ros.ros import main, node
fault = threading.Event()
def look(self):
    if fault.is_set():
        raise RuntimeError("a fault of ours")
    ticked(self)
ticked, node.Calibrator._on_tick = node.Calibrator._on_tick, look
threading.Thread(target=lambda: (sys.stdin.readline(), fault.set()), daemon=True).start()
sys.exit(main.main())
"""


@pytest.fixture
def process():
    """Run the calibrator in a process of its own, with a callback that fails on a word."""
    arguments = ["--ros-args"]
    for name, value in TURNING.items():
        arguments += ["-p", f"{name}:={str(value).lower()}"]
    running = subprocess.Popen(
        [sys.executable, "-c", FAULTY, *arguments],
        stdin=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    yield running
    if running.poll() is None:
        running.kill()
    running.communicate()


@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP, "fault"])
def test_a_process_that_ends_in_mid_turn_leaves_a_robot_that_stands(process, actor, how):
    robot = MobileBase(actor())
    robot.actor.call("calibrate")
    robot.live_until_moving()
    if how == "fault":
        process.stdin.write("now\n")
        process.stdin.flush()
    else:
        process.send_signal(how)
    told = time.monotonic()
    robot.live(5.0, lambda: process.poll() is not None)
    assert time.monotonic() - told < 2.0
    robot.live(0.2)
    assert robot.rates[-3:] == [0.0] * 3
    assert process.returncode == (1 if how == "fault" else 0)
    errors = process.stderr.read()
    assert ("a fault of ours" in errors) == (how == "fault")
    assert math.isclose(robot.command, 0.0)
