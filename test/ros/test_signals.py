"""SIGINT and SIGTERM in any state end the node quickly, without output or loss."""

import os
import random
import signal
import subprocess
import sys
import time

import pytest
import rclpy
from long_form import rounds
from support import AT_ONCE, IMU_RATE, PATIENCE, ROBOT, store_calibration, turn_by
from theatre import ListeningRobot

from magcal_ros.files import read_calibration, read_samples

pytestmark = pytest.mark.faults

KNOWN = ["-p", "reference.strength_ut:=48.0", "-p", "reference.inclination_deg:=65.0"]
chance = random.Random(11)


@pytest.fixture
def run_node(graph, ros_home):
    """Return a function that runs the node's process and brings a robot to it."""
    processes, nodes = [], []

    def run(*arguments, code=("-m", "magcal_ros.ros.main")):
        environment = {**os.environ, "ROS_HOME": str(ros_home)}
        process = subprocess.Popen(
            [sys.executable, *code, "--ros-args", *KNOWN, *arguments],
            env=environment,
            stderr=subprocess.PIPE,
            text=True,
        )
        processes.append(process)
        nodes.append(rclpy.create_node("actor"))
        actor = ListeningRobot(nodes[-1], ROBOT, speed=8.0, imu_rate=IMU_RATE)
        actor.wait_for_node()
        return process, actor

    yield run
    for process in processes:
        if process.poll() is None:
            process.kill()
        process.communicate()
    for node in nodes:
        node.destroy_node()


def end(process, how):
    """End it; returns its output."""
    process.send_signal(how)
    start = time.monotonic()
    process.wait(PATIENCE)
    assert time.monotonic() - start < AT_ONCE
    errors = process.stderr.read()
    assert process.returncode == 0, errors
    assert "Traceback" not in errors
    assert "rror" not in errors, errors


def wait_for(path, patience=PATIENCE):
    deadline = time.monotonic() + patience
    while not path.exists() and time.monotonic() < deadline:
        time.sleep(0.1)
    return path.exists()


@pytest.mark.nightly
@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_while_the_node_publishes(run_node, tmp_path, how):
    path = store_calibration(tmp_path / "calibration.yaml")
    before = path.read_bytes()
    process, actor = run_node("-p", f"calibration_file:={path}")
    actor.run(PATIENCE, stop=lambda: actor.yaws)
    assert actor.yaws
    end(process, how)
    assert path.read_bytes() == before


HANGING = """
import sys, threading
from magcal_ros.ros import main, node
main.LAST_RESORT = 1.0
node.Calibrator.close = lambda self: threading.Event().wait()
sys.exit(main.main())
"""


@pytest.mark.nightly
def test_a_signal_while_a_call_blocks(run_node, tmp_path):
    path = store_calibration(tmp_path / "calibration.yaml")
    process, actor = run_node("-p", f"calibration_file:={path}", code=("-c", HANGING))
    actor.run(PATIENCE, stop=lambda: actor.yaws)
    end(process, signal.SIGTERM)


@pytest.mark.parametrize("attempt", range(rounds(1, 100)))
def test_a_signal_at_random_times_of_fitting_saving_and_reporting(run_node, ros_home, attempt):
    """What the answer promised is there: the calibration, and the report with its samples."""
    process, actor = run_node()
    actor.answer(actor.call("start"))
    turn_by(actor, 240.0)
    done = actor.call("finish")
    actor.run(chance.uniform(0.0, 0.6), 0.5, stop=lambda: attempt % 2 == 0 and done.done())
    end(process, chance.choice([signal.SIGINT, signal.SIGTERM]))
    stored = list((ros_home / "magcal").glob("*.yaml"))
    for path in stored:
        read_calibration(path)
    assert not list((ros_home / "magcal").glob(".*unfinished"))
    if not done.done():
        return
    answer = done.result()
    assert answer.success, answer.message
    assert stored
    page = answer.message.rpartition("Report: ")[2].removesuffix(".")
    (folder,) = (ros_home / "magcal" / "reports").iterdir()
    assert page == str(folder / "report.html")
    assert wait_for(folder / "report.html")
    assert len(read_samples(folder / "samples.csv")) > 50
