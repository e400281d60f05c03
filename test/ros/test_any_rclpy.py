"""The executable with another implementation of rclpy calibrates without loss."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from other_rclpy import CALLS
from support import IMU_RATE, PATIENCE, ROBOT
from theatre import PacedRobot

NODE = [sys.executable, "-m", "magcal_ros.ros.main", "--ros-args"]
GIVEN = ["-p", "reference.strength_ut:=48.0", "-p", "reference.inclination_deg:=65.0",
         "-p", "report_folder:=none"]  # fmt: skip
FALLEN_BACK = "rclpy's own executor serves the sensors from now on"
INSIDE = ("_tasks", "_guard", "_sigint_gc", "can_execute", "_spin_once_impl")
ONE_BY_ONE = [pytest.param((name,), marks=pytest.mark.nightly) for name in INSIDE]
"""Together they show as much."""

IN_MID_TURN = 400
SPEED = 3.0
"""Slower than elsewhere: a machine that cannot keep up loses messages too."""

pytestmark = pytest.mark.faults


LOST = 0.25
"""Share of the messages that may be missing: a machine that is busy for longer than a queue lasts
loses best-effort messages by itself, and a loop that died would lose most of them."""


class Run:
    """The executable on an altered rclpy, and a robot that counts what it publishes."""

    def __init__(self, folder, ros_home, alteration):
        (folder / "sitecustomize.py").write_text(f"import other_rclpy\nother_rclpy.{alteration}\n")
        paths = [str(folder), str(Path(__file__).parent)]
        given = os.environ.get("PYTHONPATH")
        self.environment = {
            **os.environ,
            "ROS_HOME": str(ros_home),
            "PYTHONPATH": os.pathsep.join([*paths, given] if given else paths),
        }
        self.process = subprocess.Popen(
            [*NODE, *GIVEN], env=self.environment, stderr=subprocess.PIPE, text=True
        )
        self.published = {"imu/data_raw": 0, "imu/mag": 0}
        self.counted = {}
        self.actor = PacedRobot(rclpy.create_node("actor"), ROBOT, speed=SPEED, imu_rate=IMU_RATE)
        self.actor.mangle = self.count
        self.actor.node.create_subscription(DiagnosticArray, "/diagnostics", self.hear, 10)

    def count(self, sample):
        self.published["imu/data_raw" if hasattr(sample, "force") else "imu/mag"] += 1
        return [sample]

    def hear(self, message):
        for status in message.status:
            values = {pair.key: pair.value for pair in status.values}
            if status.name.endswith("Inputs"):
                self.counted = {
                    topic: int(values[f"/{topic} messages"]) for topic in self.published
                }
                self.counted["errors"] = int(values["callback errors"])

    def meet(self):
        """Wait until the node receives messages; earlier ones are not counted."""
        self.actor.wait_for_node()
        self.actor.run(PATIENCE, stop=lambda: self.published["imu/mag"] > 5)
        self.actor.mangle = lambda _: []
        for _ in range(2):
            self.counted = {}
            self.actor.run(PATIENCE, stop=lambda: self.counted)
        assert min(self.counted[topic] for topic in self.published) > 0
        self.published = {topic: self.counted[topic] for topic in self.published}
        self.actor.mangle = self.count

    def everything_arrived(self):
        """Stand still until the node has counted each message, or some seconds are over."""
        self.actor.mangle = lambda _: []
        self.actor.run(10.0, stop=lambda: self.counted == {**self.published, "errors": 0})
        assert self.counted["errors"] == 0
        for topic, published in self.published.items():
            assert published * (1.0 - LOST) <= self.counted[topic] <= published

    def end(self):
        """End it; returns what it logged."""
        self.process.send_signal(signal.SIGINT)
        _, log = self.process.communicate(timeout=PATIENCE)
        assert self.process.returncode == 0, log
        assert "Traceback" not in log
        return log


@pytest.fixture
def run_altered(graph, tmp_path, ros_home):
    """Return a function that runs the node on an rclpy altered by a call of `other_rclpy`."""
    runs = []

    def run(alteration):
        runs.append(Run(tmp_path, ros_home, alteration))
        runs[-1].meet()
        return runs[-1]

    yield run
    for run in runs:
        if run.process.poll() is None:
            run.process.kill()
        run.process.communicate()
        run.actor.node.destroy_node()


def calibrates_and_answers(run):
    """One turn by a waiting service, another by short ones, and parameters in between."""
    answer = run.actor.calibrate()
    assert answer.success, answer.message
    for service in ("start", "cancel", "save"):
        answer = run.actor.answer(run.actor.call(service))
        assert answer.success, answer.message
    run.actor.run(PATIENCE, stop=lambda: run.actor.yaws)
    assert run.actor.yaws


@pytest.mark.parametrize("names", [INSIDE, *ONE_BY_ONE], ids=",".join)
def test_renamed_internals_are_not_needed(run_altered, tmp_path, names):
    record = tmp_path / "renamed"
    run = run_altered(f"rename({names!r}, {str(record)!r})")
    if not record.exists():
        pytest.skip(f"this rclpy says {' and '.join(names)} nowhere")
    calibrates_and_answers(run)
    run.everything_arrived()
    assert FALLEN_BACK not in run.end()


@pytest.mark.nightly
@pytest.mark.parametrize(("owner", "name"), CALLS)
def test_internals_removed_during_a_turn_cost_one_line_of_the_log(run_altered, owner, name):
    run = run_altered(f"vanish({owner!r}, {name!r}, {IN_MID_TURN})")
    calibrates_and_answers(run)
    run.everything_arrived()
    log = run.end()
    assert log.count(FALLEN_BACK) == 1
    assert name in log
