"""Time from a field message to the attitude made of it, as ratios to a bare rclpy relay.

One robot publishes to the relay and to the calibrator in turns, so neither is in the other's way.
Then the calibrator is asked for a calibration while it goes on, with its previews and its fit; the
share of these messages is small, so they are also shown alone. Run it as
`python benchmarks/latency.py [seconds per row]`.
"""

from __future__ import annotations

import sys
import tempfile
import threading
import time
from pathlib import Path

import numpy as np
import rclpy
import stage
from rclpy.node import Node
from sensor_msgs.msg import Imu, MagneticField
from std_srvs.srv import Trigger

from magcal_ros.ros.straight import executor_for

RATES = ((100, 50), (400, 200))
ROUNDS = 4
APART = "apart/"
STAMP = slice(4, 12)


class Probe:
    """Publishes for both and notes when each answer comes."""

    def __init__(self, node: Node, imu_rate: int, field_rate: int) -> None:
        self.relay = stage.Load(node, imu_rate, field_rate, APART)
        self.calibrator = stage.Load(node, imu_rate, field_rate)
        self._sent: dict[bytes, int] = {}
        self._took: list[float] = []
        for load in (self.relay, self.calibrator):
            load.on_field = self._note_sent
        answers = [
            node.create_subscription(MagneticField, "relayed/imu/mag", self._note, 10, raw=True),
            node.create_subscription(Imu, "compass/mag/enu/imu", self._note, 10, raw=True),
        ]
        self._client = node.create_client(Trigger, "calibrator/calibrate")
        self._executor = executor_for(node, answers)
        self._thread = threading.Thread(target=self._executor.spin, daemon=True)
        self._thread.start()

    def _note_sent(self, stamp: bytes) -> None:
        self._sent[stamp] = time.perf_counter_ns()

    def _note(self, data: bytes) -> None:
        now = time.perf_counter_ns()
        sent = self._sent.pop(data[STAMP], None)
        if sent is not None:
            self._took.append((now - sent) * 1e-6)

    def run(self, load: stage.Load, seconds: float) -> np.ndarray:
        """Return the milliseconds that each field message took."""
        self._took.clear()
        load.run(seconds)
        time.sleep(0.1)
        return np.array(self._took)

    def turn(self) -> np.ndarray:
        """Return the same for a turn from the call of the service to its answer."""
        answer = self._client.call_async(Trigger.Request())
        self._took.clear()
        self.calibrator.run(60.0, stop=answer.done)
        print(f"    ({answer.result().message[:60]} ...)")
        return np.array(self._took)

    def close(self) -> None:
        self._executor.shutdown()
        self._thread.join()


def measure(imu_rate: int, field_rate: int, seconds: float) -> None:
    node = rclpy.create_node("probe")
    probe = Probe(node, imu_rate, field_rate)
    probe.relay.wait()
    probe.calibrator.wait()
    probe.run(probe.relay, 1.0)
    probe.run(probe.calibrator, 1.0)
    relay, ours = [], []
    for _ in range(ROUNDS):
        relay.append(probe.run(probe.relay, seconds / ROUNDS))
        ours.append(probe.run(probe.calibrator, seconds / ROUNDS))
    bare = np.concatenate(relay)
    name = f"IMU {imu_rate} Hz, field {field_rate} Hz"
    print_row(name, bare, np.concatenate(ours))
    print_row(f"{name}, during a turn", bare, probe.turn())
    probe.close()
    node.destroy_node()


def print_row(name: str, bare: np.ndarray, ours: np.ndarray) -> None:
    row = f"{name:40s}"
    for percent in (50, 99):
        a, b = np.percentile(bare, percent), np.percentile(ours, percent)
        row += f"{a:9.2f} ms {b:9.2f} ms {b / a:7.2f}"
    print(row, flush=True)


def main() -> None:
    seconds = float(sys.argv[1]) if len(sys.argv) > 1 else 20.0
    print(f"{'field in, attitude out':40s}{'relay':>9s}{'p50':>13s}{'ratio':>10s}"
          f"{'relay':>9s}{'p99':>13s}{'ratio':>10s}")  # fmt: skip
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "calibration.yaml"
        stage.store_calibration(path)
        options = ("--ros-args", "-p", f"calibration_file:={path}", "-p", "report_folder:=none")
        apart = [
            part
            for topic in ("imu/data_raw", "imu/mag")
            for part in ("-r", f"{topic}:={APART}{topic}")
        ]
        with (
            stage.running(*stage.RELAY, "--ros-args", *apart),
            stage.running(*stage.CALIBRATOR, *options),
        ):
            rclpy.init()
            for imu_rate, field_rate in RATES:
                measure(imu_rate, field_rate, seconds)
            rclpy.try_shutdown()


if __name__ == "__main__":
    main()
