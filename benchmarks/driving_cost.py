"""What speed, fixes and self-calibration cost the node: `python benchmarks/driving_cost.py [s]`.

Two nodes hear one simulated drive through a city at the same time: one with odometry and fixes that
keeps its calibration by driving, one without. Printed are the CPU of each node's own process per
second of the drive, their ratio, and what the processes that fit beside the node took.
"""

from __future__ import annotations

import math
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import rclpy
import stage
from nav_msgs.msg import Odometry
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import NavSatFix

from magcal_ros.core.samples.streams import FieldSample, ImuSample
from magcal_ros.core.samples.travel_samples import PositionSample, SpeedSample
from magcal_ros.core.simulation.drive import Drive, random_vehicle, simulated_drive
from magcal_ros.core.simulation.legs import city
from magcal_ros.core.simulation.travel import travel
from magcal_ros.ros.sensor_source import SensorSource, set_time

WARM_UP = 30.0
RENAMED = ("__node:=without", *(f"{t}:=nobody/{t}" for t in ("odom", "gps/fix", "gps/vel")))


class Car:
    """Publishes a drive in its own time, as if it began now."""

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
            time.sleep(max(0.0, stamp - time.time()))
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
    rng = np.random.default_rng(1)
    way = travel(city(rng, WARM_UP + length + 20.0), rng)
    car = Car(simulated_drive(way, rng, random_vehicle(rng)))
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "calibration.yaml"
        stage.store_calibration(path)
        alike = ("--ros-args", "-p", f"calibration_file:={path}", "-p", "report_folder:=none")
        renamed = (part for name in RENAMED for part in ("-r", name))
        off = (*alike, "-p", "self_calibration:='off'", *renamed)
        on = (*alike, "-p", "self_calibration:=propose")
        with (
            stage.running(*stage.CALIBRATOR, *off) as without,
            stage.running(*stage.CALIBRATOR, *on) as beside,
        ):
            time.sleep(3.0)
            car.drive(WARM_UP)
            pids = (without.pid, beside.pid)
            before = [stage.cpu_seconds(pid) for pid in pids]
            fitted = children_seconds(beside.pid)
            car.drive(WARM_UP + length)
            used = [stage.cpu_seconds(pid) - b for pid, b in zip(pids, before, strict=True)]
            fitted = children_seconds(beside.pid) - fitted
    shares = [1e3 * each / length for each in used]
    print(
        f"CPU, ms a second: without {shares[0]:.1f}, with all {shares[1]:.1f}, "
        f"ratio {shares[1] / shares[0]:.2f}; beside the node, fitting: {1e3 * fitted / length:.1f}"
    )


if __name__ == "__main__":
    rclpy.init()
    main()
    rclpy.try_shutdown()
