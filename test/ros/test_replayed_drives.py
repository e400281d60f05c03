"""Recorded drives, replayed by `magcal replay` into the running node."""

import subprocess
import sys

import numpy as np
import pytest
import rclpy
from sensor_msgs.msg import Imu
from std_srvs.srv import Trigger
from support import PATIENCE, rms_deg

from magcal_ros.core.geometry import wrap_angle

BOSTON = {"reference.strength_ut": 51.3, "reference.inclination_deg": 66.3}


class Audience:
    """Receives the compass and calls the node while a drive is replayed."""

    def __init__(self, node):
        self.node = node
        self.headings, self.fused = [], []
        for topic, received in (("mag", self.headings), ("fused", self.fused)):
            node.create_subscription(Imu, f"compass/{topic}/enu/imu", noting(received), 100)

    def during_replay(self, folder, rate, service=None):
        """Replay a drive, calling a service as it begins; returns the service's answer."""
        command = [sys.executable, "-m", "magcal_ros.cli.main", "replay", str(folder)]
        process = subprocess.Popen([*command, "--rate", str(rate)])
        future = None
        if service:
            client = self.node.create_client(Trigger, f"/calibrator/{service}")
            assert client.wait_for_service(PATIENCE)
            future = client.call_async(Trigger.Request())
        while process.poll() is None or (future is not None and not future.done()):
            rclpy.spin_once(self.node, timeout_sec=0.05)
        assert process.returncode == 0
        return None if future is None else future.result()


def noting(received):
    def on_heading(message):
        q, stamp = message.orientation, message.header.stamp
        yaw = np.arctan2(2 * (q.w * q.z + q.x * q.y), 1 - 2 * (q.y * q.y + q.z * q.z))
        received.append((stamp.sec + 1e-9 * stamp.nanosec, yaw))

    return on_heading


@pytest.fixture
def audience(graph):
    node = rclpy.create_node("audience")
    yield Audience(node)
    node.destroy_node()


def heading_rms_against_course(headings, truth):
    """RMS in degrees at the moments of the GPS course, one lag and one offset removed."""
    stamps, yaws = np.array(headings).T
    order = np.argsort(stamps)
    fast = truth[(truth["valid"] == b"True") & (truth["speed"] > 2.0)]
    found = []
    for lag in np.arange(-2.0, 2.01, 0.05):
        moments = fast["t"] + lag
        inside = (moments > stamps.min()) & (moments < stamps.max())
        yaw = np.interp(moments[inside], stamps[order], np.unwrap(yaws[order]))
        error = yaw - fast["yaw"][inside]
        found.append(rms_deg(wrap_angle(error - np.angle(np.exp(1j * error).mean()))))
        assert inside.sum() > 40
    return min(found)


@pytest.mark.nightly
def test_the_yaw_of_a_calibrated_car_agrees_with_its_gps_course(start_node, audience, recording):
    folder = recording("car_circles_neu2025_kiran")
    truth = np.genfromtxt(
        folder / "truth.csv", delimiter=",", names=True, dtype=("f8", "f8", "f8", "f8", "f8", "S5")
    )
    start_node(BOSTON)
    answer = audience.during_replay(folder, 4.0, "calibrate")
    assert answer.success, answer.message
    audience.headings.clear()
    audience.fused.clear()
    audience.during_replay(folder, 4.0)
    rms = heading_rms_against_course(audience.headings, truth)
    fused = heading_rms_against_course(audience.fused, truth)
    print(f"car circles: RMS against GPS course {rms:.2f}, fused {fused:.2f} deg; {answer.message}")
    # The twelve numbers that fit the whole recording's truth best give 2.85 here. Which samples the
    # turn is made of differs from run to run, and the calibration with it.
    assert rms <= 3.0
    assert fused <= 2.5


@pytest.mark.nightly
@pytest.mark.parametrize(
    ("name", "rate"),
    [
        pytest.param("broad05", 30.0, marks=pytest.mark.nightly),
        pytest.param("sailboat_lsm303_level", 10.0, marks=pytest.mark.nightly),
        ("sailboat_lsm303_roll", 40.0),
    ],
)
def test_other_drives_end_with_a_useful_message(start_node, audience, recording, name, rate):
    start_node({"window.silence_s": 1.5})
    answer = audience.during_replay(recording(name), rate, "calibrate")
    print(f"{name}: {answer.success} {answer.message}")
    assert len(answer.message) > 30
    if name == "sailboat_lsm303_roll":
        # One heading, rolled to both sides: there is no turn in it.
        assert not answer.success
