"""What speed, fixes and self-calibration cost: `python benchmarks/driving_cost.py [s] [Hz]`.

Four nodes receive one simulated drive through a city at the same time: two with odometry and fixes
that keep their calibration by driving, two without, which only watch whether it holds. Processes of
the same kind differ by a tenth and more, the same all along, so that one pair says little: run it
again for other processes.
Printed are the CPU of each node's own process per second of the drive, the ratio of the means, and
what the processes that fit beside them took. `Hz` is the rate of IMU and field.
"""

from __future__ import annotations

import contextlib
import math
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import rclpy
import shared_cases  # noqa: F401
import stage
from nav_msgs.msg import Odometry
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import NavSatFix
from simulated.drive import Drive, random_vehicle, simulated_drive
from simulated.legs import city
from simulated.travel import travel

from magcal_ros.core.samples.streams import FieldSample, ImuSample, PositionSample, SpeedSample
from magcal_ros.ros.rehearsal import SensorSource, set_time

WARM_UP = 30.0
APART = 3e-3
"""Seconds by which the messages of the wheels, from another device, are later than the IMU's."""
UNUSED = tuple(f"{topic}:=unused/{topic}" for topic in ("odom", "gps/fix", "gps/vel"))
KINDS = {
    "without": ("-p", "self_calibration:='off'", *(p for name in UNUSED for p in ("-r", name))),
    "beside": ("-p", "self_calibration:=propose"),
}


class Car:
    """Publishes a drive in real time, starting now."""

    def __init__(self, drive: Drive) -> None:
        self._node = rclpy.create_node("car")
        self._sensors = SensorSource(self._node)
        self._odom = self._node.create_publisher(Odometry, "odom", qos_profile_sensor_data)
        self._fix = self._node.create_publisher(NavSatFix, "gps/fix", qos_profile_sensor_data)
        self._samples = iter(drive.samples())
        self._first = next(self._samples).stamp
        self._began = time.time()

    def drive(self, until: float) -> None:
        """Go on until so many seconds after the start."""
        for sample in self._samples:
            stamp = sample.stamp - self._first + self._began
            received = stamp + APART if isinstance(sample, SpeedSample) else stamp
            time.sleep(max(0.0, received - time.time()))
            if isinstance(sample, (ImuSample, FieldSample)):
                self._sensors.publish(sample._replace(stamp=stamp))
            elif isinstance(sample, SpeedSample):
                self._tell_speed(sample, stamp)
            elif isinstance(sample, PositionSample):
                self._tell_position(sample, stamp)
            if stamp - self._began > until:
                return

    def _tell_speed(self, sample: SpeedSample, stamp: float) -> None:
        message = Odometry(child_frame_id="base_link")
        set_time(message.header.stamp, stamp)
        message.twist.twist.linear.x = sample.speed
        self._odom.publish(message)

    def _tell_position(self, sample: PositionSample, stamp: float) -> None:
        message = NavSatFix(latitude=48.0 + math.degrees(sample.north / 6.371e6))
        set_time(message.header.stamp, stamp)
        message.longitude = math.degrees(sample.east / 6.371e6 / math.cos(math.radians(48.0)))
        self._fix.publish(message)


def children_seconds(pid: int) -> float:
    """CPU of the processes that a process has started and that still run."""
    tasks = Path(f"/proc/{pid}/task").iterdir()
    children = [child for task in tasks for child in (task / "children").read_text().split()]
    return sum(stage.cpu_seconds(int(child)) for child in children)


def main() -> None:
    length = float(sys.argv[1]) if len(sys.argv) > 1 else 180.0
    hertz = float(sys.argv[2]) if len(sys.argv) > 2 else 50.0
    rng = np.random.default_rng(1)
    way = travel(city(rng, WARM_UP + length + 20.0), rng, rate=hertz)
    car = Car(simulated_drive(way, rng, random_vehicle(rng)))
    with tempfile.TemporaryDirectory() as folder, contextlib.ExitStack() as nodes:
        pids = []
        for name, (kind, arguments) in zip("abcd", 2 * list(KINDS.items()), strict=True):
            path = Path(folder) / f"{name}.yaml"
            stage.store_calibration(path)
            named = ("--ros-args", "-r", f"__node:={kind}_{name}")
            alike = ("-p", f"calibration_file:={path}", "-p", "report_folder:=none")
            started = stage.running(*stage.CALIBRATOR, *named, *alike, *arguments)
            pids.append(nodes.enter_context(started).pid)
        time.sleep(5.0)
        car.drive(WARM_UP)
        before = [(stage.cpu_seconds(pid), children_seconds(pid)) for pid in pids]
        car.drive(WARM_UP + length)
        after = [(stage.cpu_seconds(pid), children_seconds(pid)) for pid in pids]
    used = 1e3 / length * (np.array(after) - before)
    without, beside = used[0::2], used[1::2]
    reported = [" and ".join(f"{each:.1f}" for each in kind[:, 0]) for kind in (without, beside)]
    print(
        f"CPU, ms a second: without {reported[0]}, with all {reported[1]}, ratio of the means"
        f" {beside[:, 0].mean() / without[:, 0].mean():.2f}; fitting beside each:"
        f" {without[:, 1].mean():.1f} and {beside[:, 1].mean():.1f}"
    )


if __name__ == "__main__":
    rclpy.init()
    main()
    rclpy.try_shutdown()
