"""`magcal doctor` without a recording: it asks, the robot does, and the page says what is wrong."""

import json
import subprocess
import sys
import threading
import time

import numpy as np
import pytest
import rclpy
from support import PATIENCE, ROBOT

from magcal_ros.core.samples.streams import ImuSample
from magcal_ros.core.simulation.ride import Ride
from magcal_ros.ros.sensor_source import SensorSource

COMMAND = [sys.executable, "-m", "magcal_ros.cli.main", "doctor", "--json"]
PLACE = ["--reference-strength-ut", "48", "--reference-inclination-deg", "65"]


class Patient:
    """A robot that does what the command asks for on its standard error."""

    def __init__(self, spoil):
        self.node = rclpy.create_node("patient")
        self.source = SensorSource(self.node)
        self.ride = Ride(ROBOT, np.random.default_rng(1), start=time.time())
        self.spoil = spoil
        self.said = []

    def obey(self, process):
        reader = threading.Thread(target=lambda: self.said.extend(process.stderr), daemon=True)
        reader.start()
        began, doing, since, ticks = time.monotonic(), "", 0.0, 0
        while process.poll() is None and time.monotonic() - began < 3.0 * PATIENCE:
            asked = "".join(self.said).rsplit("[ ]", 1)[-1].strip()[:4]
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
        return process.returncode, process.stdout.read(), "".join(patient.said)

    return run


def test_a_mirrored_gyro_is_named_after_the_guided_half_minute(examined):
    def mirrored(sample):
        if not isinstance(sample, ImuSample):
            return sample
        x, y, z = sample.rate
        return sample._replace(rate=(x, y, -z))

    status, page, said = examined(mirrored)
    assert said.count("[x]") == 3, said
    assert status == 4, said
    wrong = {f["key"]: f for f in json.loads(page)["findings"] if f["grade"] in ("warn", "refused")}
    assert set(wrong) == {"gyro_axes"}, wrong
    assert "z has the wrong sign" in wrong["gyro_axes"]["remedy"]
