"""A robot that turns itself, over real middleware, and its faults."""

import math
import signal
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from mobile_base import MobileBase
from rclpy.parameter import Parameter
from rosgraph_msgs.msg import Clock
from support import AT_ONCE, PATIENCE, REFERENCE

from magcal_ros.core.session import rotation, self_turn
from magcal_ros.ros import guard
from magcal_ros.ros.guard import SIGNALS

TURNING = {**REFERENCE, "rotate.enabled": True, "rotate.speed_rad_s": 0.8}
COMMAND = [sys.executable, "-m", "magcal_ros.cli.main", "calibrate", "--skip-preflight"]


@pytest.fixture
def leisure(monkeypatch):
    """Avoid stops by a busy machine; test/core tests the limits."""
    names = ("silence", "gyro_silence", "listeners_within", "guarded_within")
    patient = replace(self_turn.SELF_TURN, **dict.fromkeys(names, PATIENCE))
    monkeypatch.setattr(self_turn, "SELF_TURN", patient)
    monkeypatch.setattr(self_turn, "SESSION", replace(self_turn.SESSION, rest=0.0))
    monkeypatch.setattr(guard, "SILENCE", PATIENCE)
    monkeypatch.setattr(
        rotation,
        "ROTATION",
        replace(rotation.ROTATION, farthest_beyond=math.pi),
    )


@pytest.fixture
def base(stage, leisure):
    """Return a function that starts the node, a robot and its base."""

    def set_up(parameters=TURNING, gain=1.0, stamped=False, **options):
        return MobileBase(stage(parameters=parameters, **options), stamped, gain)

    return set_up


def test_the_robot_turns_once_each_way_and_ends_at_its_first_heading(base):
    parameters = {**TURNING, "rotate.stamped": True, "rotate.frame_id": "chassis"}
    # Slower than elsewhere: with a fast simulated time commands come late.
    robot = base(parameters, stamped=True, speed=2.0)
    robot.live(0.5)
    assert robot.commands == []
    answer = robot.answer(robot.actor.call("calibrate"))
    assert answer.success, answer.message
    robot.assert_stopped_and_silent()
    rates = np.array(robot.rates)
    assert (rates.max(), rates.min()) == (0.8, -0.8)
    assert np.abs(np.diff(rates)).max() < 0.12
    assert np.all(np.diff(np.sign(rates[rates != 0.0])) <= 0.0), "left first, then right"
    assert {m.header.frame_id for m in robot.messages} == {"chassis"}
    periods = np.diff([moment for moment, _ in robot.commands])
    # Many bases stop after a quarter of a second without a command.
    assert 0.03 < np.median(periods) < 0.25


def test_the_robot_moves_on_request_only(base):
    robot = base({**TURNING, "rotate.enabled": False})
    assert robot.actor.answer(robot.actor.call("start")).success
    robot.live(0.7)
    assert robot.actor.answer(robot.actor.call("cancel")).success
    names = dict(robot.actor.node.get_publisher_names_and_types_by_node("calibrator", "/"))
    assert "/cmd_vel" not in names
    assert robot.commands == []


def test_disabling_rotation_during_the_turn_stops_the_robot(start_node, actor, leisure):
    node = start_node(TURNING)
    robot = MobileBase(actor())
    future = robot.actor.call("calibrate")
    robot.live_until_moving()
    node.set_parameters([Parameter("rotate.enabled", value=False)])
    assert "rotate.enabled was switched off" in robot.answer(future).message
    robot.assert_stopped_and_silent()


def test_a_jump_of_simulated_time_is_named_as_the_reason(base):
    robot = base({**TURNING, "use_sim_time": True})
    clock = robot.actor.node.create_publisher(Clock, "/clock", 10)
    robot.live(PATIENCE, clock.get_subscription_count)
    future = robot.actor.call("calibrate")
    robot.live_until_moving()
    impossible = Clock()
    impossible.clock.sec = -5
    clock.publish(impossible)
    printed = robot.answer(future).message
    assert "the robot was stopped: the simulated time on /clock jumped" in printed
    robot.assert_stopped_and_silent()


def test_a_missing_subscription_of_the_commands_is_reported_with_the_topic(stage, monkeypatch):
    monkeypatch.setattr(self_turn, "SELF_TURN", replace(self_turn.SELF_TURN, listeners_within=0.3))
    actor = stage(parameters=TURNING)
    answer = actor.answer(actor.call("calibrate"))
    assert "nothing subscribes to /cmd_vel" in answer.message


@pytest.mark.nightly
def test_the_command_warns_and_its_ctrl_c_stops_the_robot(base):
    robot = base()
    command = subprocess.Popen(COMMAND, stdout=subprocess.PIPE, text=True)
    robot.live(PATIENCE, lambda: robot.moves)
    command.send_signal(signal.SIGINT)
    robot.live(PATIENCE, lambda: command.poll() is not None)
    robot.live(0.8)
    assert "The robot will turn itself" in command.communicate()[0]
    robot.assert_stopped_and_silent()


FAULTY = """
import dataclasses, sys, threading
from magcal_ros.core.session import self_turn
from magcal_ros.ros import guard, main, node
# Whether a busy machine keeps the node silent, or finds base and guard late, is not asked here.
guard.SILENCE = 10.0
patient = dataclasses.replace(self_turn.SELF_TURN, listeners_within=60.0, guarded_within=60.0)
self_turn.SELF_TURN = patient
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


@pytest.mark.parametrize(
    "how",
    [
        signal.SIGTERM,
        *(pytest.param(how, marks=pytest.mark.nightly) for how in SIGNALS if how != signal.SIGTERM),
    ],
)
def test_the_robot_stops_if_the_process_ends_during_the_turn(process, actor, how):
    robot = MobileBase(actor())
    robot.actor.call("calibrate")
    robot.live_until_moving()
    process.send_signal(how)
    robot.live(AT_ONCE, lambda: process.poll() is not None)
    robot.live(0.2)
    assert robot.rates[-3:] == [0.0] * 3
    assert process.returncode == 0
    assert math.isclose(robot.command, 0.0)


def test_an_error_in_a_callback_stops_the_robot_and_the_node_continues(process, actor):
    robot = MobileBase(actor())
    future = robot.actor.call("calibrate")
    robot.live_until_moving()
    process.stdin.write("now\n")
    process.stdin.flush()
    answer = robot.answer(future)
    assert not answer.success
    assert "the robot was stopped: an error in a callback, RuntimeError in" in answer.message
    robot.assert_stopped_and_silent()
    assert process.poll() is None
    process.send_signal(signal.SIGINT)
    _, log = process.communicate(timeout=PATIENCE)
    assert process.returncode == 0
    assert log.count("a fault of ours") == 1
