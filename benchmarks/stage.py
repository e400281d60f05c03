"""Common parts of the benchmarks of the running node: processes, simulated messages, CPU time."""

from __future__ import annotations

import contextlib
import os
import signal
import struct
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import shared_cases  # noqa: F401
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from rclpy.serialization import serialize_message
from sensor_msgs.msg import Imu, MagneticField
from simulated.turns import measure, turn

from magcal_ros.cli.live_view import use_local_traffic
from magcal_ros.core.calibrate import calibrate
from magcal_ros.core.samples.streams import ImuSample
from magcal_ros.core.simulation import Ride, Robot
from magcal_ros.files.calibration_file import Origin, write_calibration

os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
use_local_traffic()

HERE = Path(__file__).parent
TURN_RATE = 0.5
STAMP_PLACE = 4
CALIBRATOR = ("-m", "magcal_ros.ros.main")
RELAY = (str(HERE / "relay.py"),)


def store_calibration(path: Path) -> None:
    """Calibrate a simulated robot and leave the file for the node to load."""
    robot = Robot()
    outcome = calibrate(measure(robot, turn(), np.random.default_rng(1)), robot.knowledge())
    assert outcome.calibration is not None
    write_calibration(path, outcome.calibration, Origin.now("mag_link", "imu_link"))


@contextlib.contextmanager
def running(*arguments: str) -> Iterator[subprocess.Popen[bytes]]:
    """Run a Python program until the block ends; what it logs is not of interest."""
    process = subprocess.Popen([sys.executable, *arguments], stderr=subprocess.DEVNULL)
    try:
        yield process
    finally:
        process.send_signal(signal.SIGINT)
        process.wait(timeout=10)


def cpu_seconds(pid: int) -> float:
    """User and system time a process has used."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def resident_mib(pid: int) -> float:
    """Memory of a process that is in the machine's RAM."""
    pages = int(Path(f"/proc/{pid}/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 2**20


class Load:
    """A robot that turns and turns: its sensors' messages, serialized beforehand.

    Parameters
    ----------
    node : rclpy.node.Node
        Where the publishers live.
    imu_rate, field_rate : int
        Hertz.
    prefixes : tuple of str
        What stands before the two topics, once for each pair of them; all say the same.
    """

    def __init__(
        self, node: Node, imu_rate: int, field_rate: int, prefixes: tuple[str, ...] = ("",)
    ) -> None:
        sensor_data = qos_profile_sensor_data
        self._outs = [
            (
                prefix,
                node.create_publisher(Imu, f"{prefix}imu/data_raw", sensor_data),
                node.create_publisher(MagneticField, f"{prefix}imu/mag", sensor_data),
            )
            for prefix in prefixes
        ]
        self._period = 1.0 / imu_rate
        self._steps = list(_steps(imu_rate, imu_rate // field_rate))
        self._at = 0
        self.on_field: Callable[[str, bytes], None] = lambda _, __: None

    @property
    def is_received(self) -> bool:
        """Whether both topics have a listener."""
        return all(out.get_subscription_count() for _, *outs in self._outs for out in outs)

    def wait(self) -> None:
        """Wait until somebody listens."""
        while not self.is_received:
            time.sleep(0.05)

    def run(self, seconds: float, stop: Callable[[], bool] = lambda: False) -> int:
        """Publish in real time, stamped now; returns how many messages a pair of topics had."""
        began, sent, ticks = time.perf_counter(), 0, 0
        while ticks * self._period < seconds and not stop():
            stamp = struct.pack("<iI", *divmod(time.time_ns(), 10**9))
            imu, field = self._steps[self._at]
            self._at = (self._at + 1) % len(self._steps)
            self._outs.reverse()
            for prefix, imu_out, field_out in self._outs:
                imu_out.publish(_stamped(imu, stamp))
                if field is not None:
                    self.on_field(prefix, stamp)
                    field_out.publish(_stamped(field, stamp))
            sent += 1 + (field is not None)
            ticks += 1
            time.sleep(max(0.0, began + ticks * self._period - time.perf_counter()))
        return sent


def _steps(imu_rate: int, steps_per_field: int) -> Iterator[tuple[bytearray, bytearray | None]]:
    """One turn of the robot, step by step."""
    robot, rng = Robot(), np.random.default_rng(2)
    ride = Ride(robot, rng, start=1.0, imu_rate=float(imu_rate), steps_per_field=steps_per_field)
    imu, field = Imu(), MagneticField()
    imu.header.frame_id, field.header.frame_id = "imu_link", "mag_link"
    for _ in range(round(2.0 * np.pi / TURN_RATE * imu_rate)):
        of_field = None
        for sample in ride.step(TURN_RATE):
            if isinstance(sample, ImuSample):
                _fill(imu.linear_acceleration, sample.force)
                _fill(imu.angular_velocity, sample.rate)
            else:
                _fill(field.magnetic_field, sample.field)
                of_field = bytearray(serialize_message(field))
        yield bytearray(serialize_message(imu)), of_field


def _fill(vector: Any, numbers: tuple[float, float, float]) -> None:
    vector.x, vector.y, vector.z = numbers


def _stamped(data: bytearray, stamp: bytes) -> bytes:
    data[STAMP_PLACE : STAMP_PLACE + len(stamp)] = stamp
    return bytes(data)
