"""A day of messages, as fast as the node takes them: `python benchmarks/soak.py [--hours 24]`.

The real node runs in a process of its own. It calibrates once an hour of stamps, and its resident
memory is written down; the exit status is 1 if it grew, or if a calibration or a yaw failed.
"""

from __future__ import annotations

import argparse
import math
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import rclpy
from sensor_msgs.msg import MagneticField
from std_msgs.msg import Float64

from magcal_ros.cli.live_view import use_local_traffic
from magcal_ros.core.geometry.attitude import wrap_angle
from magcal_ros.core.simulation import Robot
from magcal_ros.ros.rehearsal import Rehearsal

use_local_traffic()

IMU_RATE = 100.0
"""Hertz of stamps; a field sample comes with every second one."""

STEPS_AT_ONCE = 4
"""IMU samples between two looks at what came back: fewer than a sensor's queue holds."""

PATIENCE = 0.05
"""Seconds after which what has not come back is lost."""

MOST_GROWTH_MB = 10.0
MOST_LOST = 0.05
MOST_MORE = 3
"""Open files or threads: a report or a fit may be under way at either mark."""

WORST_YAW = math.radians(5.0)


@dataclass(frozen=True)
class Mark:
    """The state of the node after some hours of stamps."""

    hours: float
    messages: int
    lost: int
    calibrations: int
    resident_mb: float
    handles: int
    threads: int
    yaw_error: float


class Feeder:
    """Publishes what the robot measures, and waits for each corrected field."""

    def __init__(self, actor: Rehearsal) -> None:
        self._actor = actor
        self._back = 0
        self.sent = self.lost = 0
        node = actor.node
        node.create_subscription(MagneticField, "imu/mag_unbiased", self._on_field, 50, raw=True)
        self.yaws: list[float] = []
        node.create_subscription(Float64, "compass/yaw", self._on_yaw, 10)
        assert node.executor is not None
        self._executor = node.executor

    def _on_yaw(self, message: Float64) -> None:
        self.yaws.append(message.data)

    def _on_field(self, _: bytes) -> None:
        self._back += 1

    def step(self, yaw_rate: float = 0.0) -> None:
        """Run the robot for a few samples."""
        awaited = 0
        for _ in range(STEPS_AT_ONCE):
            samples = self._actor.ride.step(yaw_rate)
            awaited += len(samples) - 1
            self.sent += len(samples)
            for sample in samples:
                self._actor.source.publish(sample)
        self._back, deadline = 0, time.monotonic() + PATIENCE
        while self._back < awaited and time.monotonic() < deadline:
            self._executor.spin_once(timeout_sec=PATIENCE)
        self.lost += max(0, awaited - self._back)

    def calibrate(self) -> bool:
        """Call the service and turn until it answers."""
        future = self._actor.call("calibrate")
        while not future.done():
            self.step(0.5)
        return bool(future.result().success)


def resident_mb(pid: int) -> float:
    """Resident memory of a process."""
    pages = int(Path(f"/proc/{pid}/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


def handles_and_threads(pid: int) -> tuple[int, int]:
    """How many open files and how many threads a process has."""
    place = Path(f"/proc/{pid}")
    return len(list((place / "fd").iterdir())), len(list((place / "task").iterdir()))


def soak(
    hours: float,
    marks: int,
    tell: Callable[[Mark], None] = lambda _: None,
    imu_rate: float = IMU_RATE,
) -> list[Mark]:
    """Feed a node; one calibration and one mark after each of equal parts of the time.

    The first mark is made after the first calibration, when everything is loaded.
    """
    robot = Robot()
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
        command = [sys.executable, "-m", "magcal_ros.ros.main", "--ros-args"]
        command += ["-p", f"reference.strength_ut:={robot.strength * 1e6}"]
        command += ["-p", f"reference.inclination_deg:={math.degrees(robot.inclination)}"]
        process = subprocess.Popen(command, env={**os.environ, "ROS_HOME": folder})
        node = rclpy.create_node("soak")
        try:
            actor = Rehearsal(node, robot, imu_rate=imu_rate, speed=400.0 / imu_rate)
            actor.wait_for_node()
            assert actor.calibrate().success
            return _live(actor, process.pid, hours, marks, tell)
        finally:
            process.send_signal(signal.SIGINT)
            status = process.wait(timeout=20)
            node.destroy_node()
            assert status == 0


def _live(
    actor: Rehearsal, pid: int, hours: float, marks: int, tell: Callable[[Mark], None]
) -> list[Mark]:
    feeder, found = Feeder(actor), list[Mark]()
    start, part = actor.ride.stamp, 3600.0 * hours / marks
    for number in range(marks + 1):
        while actor.ride.stamp - start < number * part:
            feeder.step()
        calibrated = feeder.calibrate()
        # The first yaws after a turn may still be of the turn: a loaded machine is late.
        for _ in range(2):
            feeder.yaws.clear()
            for _ in range(100):
                feeder.step()
        seen = math.atan2(sum(map(math.sin, feeder.yaws)), sum(map(math.cos, feeder.yaws)))
        error = float(wrap_angle(seen - actor.ride.magnetic_yaw))
        done = (found[-1].calibrations if found else 0) + calibrated
        lived = (actor.ride.stamp - start) / 3600.0
        held = handles_and_threads(pid)
        mark = Mark(lived, feeder.sent, feeder.lost, done, resident_mb(pid), *held, error)
        found.append(mark)
        tell(mark)
    return found


def faults(marks: list[Mark], most_growth_mb: float = MOST_GROWTH_MB) -> list[str]:
    """Return the faults, in words."""
    found = []
    growth = marks[-1].resident_mb - marks[min(1, len(marks) - 1)].resident_mb
    if growth > most_growth_mb:
        found.append(f"resident memory grew by {growth:.1f} MB")
    first = marks[min(1, len(marks) - 1)]
    if (
        marks[-1].handles > first.handles + MOST_MORE
        or marks[-1].threads > first.threads + MOST_MORE
    ):
        found.append(
            f"open files went from {first.handles} to {marks[-1].handles}, threads from "
            f"{first.threads} to {marks[-1].threads}"
        )
    if marks[-1].lost > MOST_LOST * marks[-1].messages:
        found.append(f"{marks[-1].lost} of {marks[-1].messages} messages were lost")
    if marks[-1].calibrations < len(marks):
        found.append(f"{len(marks) - marks[-1].calibrations} calibrations failed")
    worst = max(abs(mark.yaw_error) for mark in marks)
    if worst > WORST_YAW:
        found.append(f"the yaw was off by {math.degrees(worst):.1f}°")
    return found


def print_mark(mark: Mark) -> None:
    print(
        f"{mark.hours:8.2f}{mark.messages:12d}{mark.lost:8d}{mark.calibrations:14d}"
        f"{mark.resident_mb:14.1f}{mark.handles:9d}{mark.threads:9d}{math.degrees(mark.yaw_error):+12.2f}",
        flush=True,
    )


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--hours", type=float, default=24.0, help="of stamps")
    parser.add_argument(
        "--rate", type=float, default=IMU_RATE, help="Hz of the IMU; of the field half"
    )
    arguments = parser.parse_args()
    rclpy.init()
    print("   hours    messages    lost  calibrations  resident MB  handles  threads  yaw error°")
    start = time.monotonic()
    marks = soak(arguments.hours, max(2, round(arguments.hours)), print_mark, arguments.rate)
    took = time.monotonic() - start
    print(f"{marks[-1].messages / took:.0f} messages a second")
    for words in (wrong := faults(marks)):
        print(words)
    rclpy.try_shutdown()
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
