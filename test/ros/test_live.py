"""The output of `magcal calibrate` on a terminal and in a log file."""

import contextlib
import math
import os
import pty
import signal
import subprocess
import sys
import threading

import pytest
import rclpy
from sensor_msgs.msg import Imu
from support import PATIENCE

from magcal_ros.ros.preflight import inspect

COMMAND = [sys.executable, "-m", "magcal_ros.cli.main", "calibrate"]


@pytest.fixture
def run_beside():
    """Return a function that runs the command while the robot sends."""
    processes = []

    def run(actor, *arguments, yaw_rate=0.5, after=lambda _: None, stdout=subprocess.PIPE):
        process = subprocess.Popen(
            [*COMMAND, *arguments], stdout=stdout, stderr=subprocess.PIPE, text=True
        )
        processes.append(process)
        actor.run(2.0 * PATIENCE, yaw_rate, lambda: after(process) or process.poll() is not None)
        return process

    yield run
    for process in processes:
        if process.poll() is None:
            process.kill()
            process.communicate()


def test_in_a_pipe_the_checks_are_followed_by_lines(stage, run_beside):
    actor = stage(speed=2.0)
    process = run_beside(actor, yaw_rate=1.5)
    output, errors = process.communicate()
    assert process.returncode == 0, output + errors
    lines = output.splitlines()
    assert any(line.startswith("/imu/data_raw: ") and "imu_link" in line for line in lines)
    assert any(line.startswith("/imu/mag: ") and "µT" in line for line in lines)
    progress = [line for line in lines if line.startswith("[")]
    assert progress
    assert "turn left" in progress[0]
    assert "Calibrated, quality" in lines[-1]
    assert "\x1b" not in output


@pytest.mark.nightly
def test_on_a_terminal_a_ring_is_drawn(stage, run_beside):
    actor = stage()
    leader, follower = pty.openpty()
    os.set_blocking(leader, False)
    screen = bytearray()

    def drain(_):
        with contextlib.suppress(BlockingIOError):
            screen.extend(os.read(leader, 65536))

    process = run_beside(actor, after=drain, stdout=follower)
    drain(None)
    os.close(follower)
    os.close(leader)
    assert process.returncode == 0
    text = screen.decode(errors="replace")
    assert "one turn" in text
    assert "missing" in text
    assert "Calibrated, quality" in text


@pytest.mark.nightly
def test_ctrl_c_cancels_the_turn(stage, run_beside):
    actor = stage()

    def interrupt(process):
        progress = actor.status.get("progress") or {}
        if progress.get("samples", 0) > 50 and not hasattr(process, "reported"):
            process.reported = True
            process.send_signal(signal.SIGINT)

    process = run_beside(actor, after=interrupt)
    _, errors = process.communicate()
    assert process.returncode == 130
    assert "Traceback" not in errors
    actor.run(1.2)
    assert actor.status["state"] == "uncalibrated"
    assert "cancelled" in actor.status["answer"]["message"]


def published_for(actor, seconds):
    """The result of the preflight while the robot sends."""
    looker = rclpy.create_node("looker")
    found = []
    look = threading.Thread(target=lambda: found.append(inspect(looker, "/calibrator", seconds)))
    look.start()
    actor.run(PATIENCE, stop=lambda: not look.is_alive())
    looker.destroy_node()
    return found[0]


def test_a_sensor_that_does_not_arrive_is_explained(stage):
    actor = stage()
    actor.mangle = lambda sample: [sample] if hasattr(sample, "force") else []
    found = published_for(actor, 0.5)
    assert not found.ready
    assert "/imu/mag: nothing arrives (1 publishers)" in found.lines


def test_a_sensor_on_another_topic_is_found(stage):
    actor = stage()
    actor.mangle = lambda _: []
    driver = actor.node.create_publisher(Imu, "vendor/imu", 1)
    found = published_for(actor, 0.5)
    actor.node.destroy_publisher(driver)
    reported = [line for line in found.lines if "the same type is published" in line]
    assert reported == ["  the same type is published on /vendor/imu: remap to it with -r"]


def test_stamps_in_bursts_are_reported_before_the_turn(stage):
    actor = stage()
    actor.mangle = lambda sample: [sample._replace(stamp=math.ceil(sample.stamp / 0.4) * 0.4)]
    found = published_for(actor, 2.0)
    assert sum("the stamps come in bursts, 0.40 s apart" in line for line in found.lines) == 2


@pytest.mark.nightly
def test_a_missing_node_is_reported(graph):
    done = subprocess.run(
        [*COMMAND, "--node", "nobody"], capture_output=True, text=True, check=False, timeout=60
    )
    assert done.returncode == 1
    assert "the node /nobody was not found" in done.stderr
