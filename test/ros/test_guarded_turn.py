"""A robot that turns itself while its node is killed, stopped or blocked: real processes."""

import contextlib
import fcntl
import math
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from mobile_base import MobileBase
from sensor_msgs.msg import MagneticField
from support import AT_ONCE, REFERENCE, wait_until

NODE = [sys.executable, "-m", "magcal_ros.ros.main", "--ros-args"]
UNCAUGHT = [
    signal.SIGKILL,
    *(pytest.param(how, marks=pytest.mark.nightly) for how in (signal.SIGSEGV, signal.SIGBUS)),
]


@pytest.fixture
def run_node(graph):
    """Return a function that runs the node's process."""
    processes = []

    def run(**parameters):
        given = {**REFERENCE, "rotate.enabled": True, "rotate.speed_rad_s": 0.8, **parameters}
        command = list(NODE)
        for name, value in {**given, "report_folder": "none"}.items():
            command += ["-p", f"{name}:={str(value).lower()}"]
        processes.append(subprocess.Popen(command, stderr=subprocess.PIPE))
        return processes[-1]

    yield run
    for process in processes:
        process.kill()
        process.communicate()


def wait_for_zero(robot, since):
    """Run the robot until it receives a zero."""
    robot.live(AT_ONCE, lambda: robot.commands[-1][0] > since and not robot.moves)
    assert not robot.moves


def assert_only_zeros_follow(robot, seconds=2.0):
    received = len(robot.commands)
    robot.live(seconds)
    assert set(robot.rates[received - 1 :]) == {0.0}


@pytest.mark.parametrize("how", UNCAUGHT)
def test_the_robot_stops_after_the_node_has_ended(run_node, actor, how):
    process = run_node()
    robot = MobileBase(actor(speed=1.0))
    robot.actor.call("calibrate")
    robot.live_until_moving()
    process.send_signal(how)
    wait_for_zero(robot, time.monotonic())
    assert_only_zeros_follow(robot)
    robot.assert_stopped_and_silent()


def test_a_stopped_guard_ends_the_turn(run_node, actor):
    process = run_node()
    robot = MobileBase(actor(speed=1.0))
    future = robot.actor.call("calibrate")
    robot.live_until_moving()
    guard = next(pid for pid in children_of(process.pid) if "guard" in command_of(pid))
    os.kill(guard, signal.SIGSTOP)
    try:
        wait_for_zero(robot, time.monotonic())
        assert "the guard process has ended, does not answer" in robot.answer(future).message
        robot.assert_stopped_and_silent()
        wait_until(lambda: guard not in children_of(process.pid))
    finally:
        with contextlib.suppress(ProcessLookupError):
            os.kill(guard, signal.SIGKILL)


def children_of(pid):
    reported = [path.read_text() for path in Path(f"/proc/{pid}/task").glob("*/children")]
    return [int(child) for child in " ".join(reported).split()]


def command_of(pid):
    return Path(f"/proc/{pid}/cmdline").read_text()


@pytest.mark.nightly
def test_a_resumed_node_does_not_turn_the_robot(run_node, actor):
    process = run_node()
    robot = MobileBase(actor(speed=1.0))
    future = robot.actor.call("calibrate")
    robot.live_until_moving()
    process.send_signal(signal.SIGSTOP)
    wait_for_zero(robot, time.monotonic())
    assert_only_zeros_follow(robot, 1.0)
    process.send_signal(signal.SIGCONT)
    assert_only_zeros_follow(robot)
    assert "the robot was stopped" in robot.answer(future).message
    robot.assert_stopped_and_silent()


def fill(pipe):
    """Fill a pipe."""
    fcntl.fcntl(pipe, fcntl.F_SETPIPE_SZ, 4096)
    other = os.open(f"/proc/self/fd/{pipe}", os.O_WRONLY | os.O_NONBLOCK)
    try:
        while True:
            os.write(other, b"x")
    except BlockingIOError:
        pass
    finally:
        os.close(other)


@pytest.mark.nightly
def test_a_blocked_terminal_does_not_keep_the_robot_turning(run_node, actor):
    process = run_node()
    robot = MobileBase(actor(speed=1.0))
    robot.actor.call("calibrate")
    robot.live_until_moving()
    fill(process.stderr.fileno())
    # Worth a complaint in the log, and no reason to stop the robot.
    robot.actor.node.create_publisher(MagneticField, "imu/mag", 1)
    robot.live(30.0, lambda: not robot.moves)
    assert not robot.moves
    assert_only_zeros_follow(robot)
    process.send_signal(signal.SIGTERM)
    assert process.wait(AT_ONCE) == 0


@pytest.mark.nightly
def test_a_blocked_log_file_does_not_keep_the_robot_turning(run_node, actor, tmp_path):
    path = tmp_path / "calibration.yaml"
    os.mkfifo(path)
    run_node(calibration_file=path)
    robot = MobileBase(actor(speed=2.0))
    answer = robot.answer(robot.actor.call("calibrate"))
    assert not answer.success
    assert "not saved" in answer.message
    robot.assert_stopped_and_silent()
    turned = sum(
        abs(rate) * (after - before)
        for (before, rate), (after, _) in zip(robot.commands, robot.commands[1:], strict=False)
    )
    # The time of the actor's robot runs twice as fast as its commands.
    assert 2.0 * turned < 2.0 * math.radians(420.0)
