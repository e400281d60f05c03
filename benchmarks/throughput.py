"""CPU per message of the calibrated node, as a ratio to a bare rclpy relay of the same topics.

Both processes hear the same publisher at the same time; each has one listener on every output.
Run it as `python benchmarks/throughput.py [seconds per row]`.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
os.environ["ROS_DOMAIN_ID"] = str(1 + os.getpid() % 100)

import numpy as np
import rclpy
from sensor_msgs.msg import Imu, MagneticField
from std_msgs.msg import Float64

from magcal_ros.core.calibrate import calibrate
from magcal_ros.core.simulator import Robot, measure, turn
from magcal_ros.files.calibration_file import Origin, write_calibration
from magcal_ros.ros.rehearsal import Rehearsal

RATES = ((100, 50), (400, 200))
OUTPUTS = (
    (MagneticField, "imu/mag_unbiased"),
    (Imu, "compass/mag/enu/imu"),
    (Float64, "compass/yaw"),
    (Imu, "relayed/imu/data_raw"),
    (MagneticField, "relayed/imu/mag"),
)


def cpu_seconds(pid: int) -> float:
    """User and system time a process has used."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def store_calibration(path: Path) -> None:
    """Calibrate a simulated robot and leave the file for the node to load."""
    robot = Robot()
    outcome = calibrate(measure(robot, turn(), np.random.default_rng(1)), robot.knowledge())
    assert outcome.calibration is not None
    write_calibration(path, outcome.calibration, Origin.now("mag_link", "imu_link"))


def start(*command: str) -> subprocess.Popen[bytes]:
    return subprocess.Popen([sys.executable, *command])


def measure_rates(pids: list[int], imu_rate: int, field_rate: int, seconds: float) -> list[float]:
    """Microseconds of CPU per incoming message for each process."""
    node = rclpy.create_node("load")
    steps = imu_rate // field_rate
    load = Rehearsal(node, Robot(), imu_rate=float(imu_rate), steps_per_field=steps)
    load.wait_for_node()
    load.run(2.0)
    first, begun = [cpu_seconds(pid) for pid in pids], load.ride.stamp
    load.run(seconds)
    used = [cpu_seconds(pid) - start for pid, start in zip(pids, first, strict=True)]
    messages = (load.ride.stamp - begun) * (imu_rate + field_rate)
    node.destroy_node()
    return [1e6 * seconds / messages for seconds in used]


def main() -> None:
    seconds = float(sys.argv[1]) if len(sys.argv) > 1 else 10.0
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "calibration.yaml"
        store_calibration(path)
        here = Path(__file__).parent
        relay = start(str(here / "relay.py"))
        listener = start(str(here / "throughput.py"), "--listen")
        options = ["--ros-args", "-p", f"calibration_file:={path}"]
        calibrator = start("-m", "magcal_ros.ros.main", *options)
        rclpy.init()
        try:
            time.sleep(2.0)
            print("CPU per incoming message     relay     calibrator   ratio")
            for imu_rate, field_rate in RATES:
                pids = [relay.pid, calibrator.pid]
                bare, ours = measure_rates(pids, imu_rate, field_rate, seconds)
                name = f"IMU {imu_rate} Hz, field {field_rate} Hz"
                print(f"{name:26s}{bare:7.0f} µs {ours:9.0f} µs {ours / bare:9.2f}", flush=True)
        finally:
            rclpy.try_shutdown()
            for process in (relay, listener, calibrator):
                process.send_signal(signal.SIGINT)
                process.wait(timeout=10)


def listen() -> None:
    """Subscribe to every output of both, and do nothing with it."""
    rclpy.init()
    node = rclpy.create_node("listener")
    for kind, topic in OUTPUTS:
        node.create_subscription(kind, topic, lambda _: None, 10, raw=True)
    try:
        rclpy.spin(node)
    except (KeyboardInterrupt, rclpy.executors.ExternalShutdownException):
        pass
    finally:
        rclpy.try_shutdown()


if __name__ == "__main__":
    listen() if "--listen" in sys.argv else main()
