"""`magcal doctor` without a recording: guided movements, then a report of the faults."""

import argparse
import json
import os
import pty
import subprocess
import sys
import threading
import time
from dataclasses import replace

import numpy as np
import pytest
import rclpy
from rclpy.executors import SingleThreadedExecutor
from sensor_msgs.msg import MagneticField
from std_msgs.msg import String
from support import PATIENCE, ROBOT, wait_until

from magcal_ros.cli import doctor
from magcal_ros.cli.doctor import GuidePrompts, gathered
from magcal_ros.core import Mounting
from magcal_ros.core.doctor import Guide, GuideStep
from magcal_ros.core.samples import ImuSample, SensorLog
from magcal_ros.core.simulation import Ride
from magcal_ros.ros.preflight import Listener
from magcal_ros.ros.rehearsal import SensorSource
from magcal_ros.ros.sensor_frames import LATCHED

COMMAND = [sys.executable, "-m", "magcal_ros.cli.main", "doctor", "--json"]
PLACE = ["--reference-strength-ut", "48", "--reference-inclination-deg", "65"]


class Patient:
    """A robot that makes the movements that the command asks for on its standard error."""

    def __init__(self, spoil):
        self.node = rclpy.create_node("patient")
        self.source = SensorSource(self.node)
        self.ride = Ride(ROBOT, np.random.default_rng(1), start=time.time())
        self.spoil = spoil
        self.printed = []

    def obey(self, process):
        reader = threading.Thread(target=lambda: self.printed.extend(process.stderr), daemon=True)
        reader.start()
        began, doing, since, ticks = time.monotonic(), "", 0.0, 0
        while process.poll() is None and time.monotonic() - began < 3.0 * PATIENCE:
            asked = "".join(self.printed).rsplit("[ ]", 1)[-1].strip()[:4]
            if asked != doing:
                doing, since = asked, self.ride.stamp
            rate, pitch = self.moves(doing, self.ride.stamp - since)
            for sample in self.ride.step(rate, tipping=np.array([0.0, pitch, 0.0])):
                self.source.publish(self.spoil(sample))
            ticks += 1
            time.sleep(max(0.0, began + ticks * self.ride.period - time.monotonic()))
        reader.join(PATIENCE)
        self.node.destroy_node()

    def moves(self, doing, gone):
        if doing == "turn":
            return (0.8 if 0.5 < gone < 3.0 else 0.0), 0.0
        if doing == "lift":
            return 0.0, -0.35 if 0.3 < gone < 1.3 else 0.35 if 1.6 < gone < 2.6 else 0.0
        return 0.0, 0.0


@pytest.fixture
def examined(graph):
    def run(spoil=lambda sample: sample):
        patient = Patient(spoil)
        process = subprocess.Popen(
            [*COMMAND, *PLACE], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        )
        patient.obey(process)
        return process.returncode, process.stdout.read(), "".join(patient.printed)

    return run


@pytest.mark.nightly
def test_a_mirrored_gyro_is_named_after_the_guided_half_minute(examined):
    def mirrored(sample):
        if not isinstance(sample, ImuSample):
            return sample
        x, y, z = sample.rate
        return sample._replace(rate=(x, y, -z))

    status, page, printed = examined(mirrored)
    assert printed.count("[x]") == 3, printed
    assert status == 4, printed
    wrong = {f["key"]: f for f in json.loads(page)["findings"] if f["grade"] in ("warn", "refused")}
    assert set(wrong) == {"gyro_axes"}, wrong
    assert "z has the wrong sign" in wrong["gyro_axes"]["remedy"]


URDF = """<robot name="mule"><joint name="mag" type="fixed"><parent link="imu_link"/>
<child link="mag_link"/><origin rpy="{}"/></joint></robot>"""


@pytest.fixture
def looked(graph):
    """The report on a robot whose magnetometer has x forward, y right, z down."""
    node, other = rclpy.create_node("doctor"), rclpy.create_node("robot")

    def run(rpy, more=()):
        samples = []
        others = [each.create_publisher(MagneticField, "imu/mag", 10) for each in more]
        source = SensorSource(other)
        out = other.create_publisher(String, "robot_description", LATCHED)
        out.publish(String(data=URDF.format(rpy)))
        listener = Listener(node, "/imu/data_raw", "/imu/mag", samples.append)
        wait_until(lambda: source.listeners > 0)
        wait_until(lambda: len(listener.several_publishers) == bool(others))
        mounted = replace(ROBOT, mounting=Mounting(pose=np.diag([1.0, -1.0, -1.0])))
        executor, sent = SingleThreadedExecutor(), 0
        executor.add_node(node)
        ride = Ride(mounted, np.random.default_rng(1), start=100.0, imu_rate=50.0)
        for tick in range(700):
            turning = 0.9 if 100 < tick < 480 else 0.0
            lift = -0.35 * (500 < tick < 550) + 0.35 * (580 < tick < 630)
            for sample in ride.step(turning, tipping=np.array([0.0, lift, 0.0])):
                source.publish(sample)
                sent += 1
            hear(executor, lambda: came(listener) == sent)  # noqa: B023
        hear(executor, lambda: listener.described_pose is not None)
        executor.shutdown()
        parser = argparse.ArgumentParser()
        doctor.add_doctor(parser.add_subparsers())
        received = gathered(parser.parse_args(["doctor", *PLACE]), listener, samples, Guide(0.0))
        return received.report_of(SensorLog.of(samples))

    yield run
    for each in (node, other):
        each.destroy_node()


def hear(executor, is_heard):
    """Spin until it is received, without a pause between the many messages."""
    deadline = time.monotonic() + PATIENCE
    while not is_heard():
        assert time.monotonic() < deadline, "it was not heard"
        executor.spin_once(0.01)


def came(listener):
    return sum(each.messages for each in listener.sensors)


def wrong_lines(page):
    return {finding.key: finding for finding in page.findings if finding.is_wrong}


def test_a_correct_description_is_reported_as_correct(looked):
    page = looked("3.14159265 0 0")
    assert wrong_lines(page) == {}
    assert "description" in {finding.key for finding in page.findings}


def test_a_description_that_differs_and_another_publisher_are_named(looked, graph):
    intruder = rclpy.create_node("intruder")
    wrong = wrong_lines(looked("0 0 0", more=[intruder]))
    intruder.destroy_node()
    assert set(wrong) == {"field_axes", "driver", "description", "publishers"}
    assert "ICM-20948" in wrong["driver"].evidence
    assert 'rpy="3.142 0 0"' in wrong["description"].remedy
    assert "intruder" in wrong["publishers"].evidence


def test_the_enter_key_skips_a_step(monkeypatch):
    keyboard, terminal = pty.openpty()
    with os.fdopen(terminal) as there:
        monkeypatch.setattr(sys, "stdin", there)
        asking = GuidePrompts()
        assert not asking.is_skipped()
        os.write(keyboard, b"\n")
        wait_until(asking.is_skipped)
        assert not asking.is_skipped()
    os.close(keyboard)


def test_the_remaining_seconds_are_shown_on_a_terminal(monkeypatch, capsys):
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    asking, guide = GuidePrompts(), Guide(0.0)
    asking.count_down(guide, 0.0)
    asking.count_down(guide, 0.1)
    asking.count_down(guide, 5.0)
    printed = capsys.readouterr().err
    assert printed.count("45 s left") == printed.count("40 s left") == 1


def test_a_skipped_step_is_called_skipped(capsys):
    guide = Guide(0.0)
    guide.ended[GuideStep.STAND] = True
    assert guide.skip(1.0)
    GuidePrompts().tick(guide, missed="skipped")
    assert capsys.readouterr().err.endswith("and stop: skipped\n")
