"""Time from a field message to the attitude made of it, as ratios to a bare rclpy relay.

One robot publishes to the relay and to the calibrator in turns, so neither is in the other's way.
Then both receive every message at once while the calibrator is asked for a calibration, with its
previews and its fit. Run it as `python benchmarks/latency.py [seconds per row]`.
"""

from __future__ import annotations

import sys
import tempfile
import threading
import time
from functools import partial
from pathlib import Path

import numpy as np
import rclpy
import stage
from rclpy.node import Node
from sensor_msgs.msg import Imu, MagneticField
from std_srvs.srv import Trigger

from magcal_ros.ros.threads import SensorGroup, Spinner

RATES = ((100, 50), (400, 200))
ROUNDS = 4
APART = "apart/"
STAMP = slice(4, 12)


class Probe:
    """Publishes for one or both and records the time of each answer."""

    def __init__(self, node: Node, imu_rate: int, field_rate: int) -> None:
        self.relay = stage.Load(node, imu_rate, field_rate, (APART,))
        self.calibrator = stage.Load(node, imu_rate, field_rate)
        self._both = stage.Load(node, imu_rate, field_rate, (APART, ""))
        self._faults: list[Exception] = []
        self._sent: dict[tuple[str, bytes], int] = {}
        self._took: dict[str, list[float]] = {APART: [], "": []}
        for load in (self.relay, self.calibrator, self._both):
            load.on_field = self._note_sent
        of_relay, of_calibrator = partial(self._note, APART), partial(self._note, "")
        group = SensorGroup()
        group.subscribe(node, MagneticField, "relayed/imu/mag", of_relay)
        group.subscribe(node, Imu, "compass/mag/enu/imu", of_calibrator)
        self._client = node.create_client(Trigger, "calibrator/calibrate")
        self._spinner = Spinner(node, group, self._faults.append)
        self._thread = threading.Thread(target=self._spinner.spin, daemon=True)
        self._thread.start()

    def _note_sent(self, prefix: str, stamp: bytes) -> None:
        self._sent[prefix, stamp] = time.perf_counter_ns()

    def _note(self, prefix: str, data: bytes) -> None:
        now = time.perf_counter_ns()
        sent = self._sent.pop((prefix, data[STAMP]), None)
        if sent is not None:
            self._took[prefix].append((now - sent) * 1e-6)

    def run(self, load: stage.Load, seconds: float) -> None:
        load.run(seconds)
        time.sleep(0.1)

    def turn(self) -> str:
        """Let both hear a turn, from the call of the service to its answer; returns the answer."""
        answer = self._client.call_async(Trigger.Request())
        self._both.run(60.0, stop=answer.done)
        time.sleep(0.1)
        return str(answer.result().message)

    def taken(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the milliseconds that relay and calibrator took since the last call."""
        took = np.array(self._took[APART]), np.array(self._took[""])
        for each in self._took.values():
            each.clear()
        return took

    def close(self) -> None:
        self._spinner.shutdown()
        self._thread.join()
        assert not self._faults, self._faults


def measure(imu_rate: int, field_rate: int, seconds: float) -> None:
    node = rclpy.create_node("probe")
    probe = Probe(node, imu_rate, field_rate)
    probe.relay.wait()
    probe.calibrator.wait()
    probe.run(probe.relay, 1.0)
    probe.run(probe.calibrator, 1.0)
    probe.taken()
    for _ in range(ROUNDS):
        probe.run(probe.relay, seconds / ROUNDS / 2)
        probe.run(probe.calibrator, seconds / ROUNDS / 2)
    name = f"IMU {imu_rate} Hz, field {field_rate} Hz"
    print_row(name, *probe.taken())
    answer = probe.turn()
    print_row(f"{name}, during a turn", *probe.taken())
    assert answer.startswith("Calibrated"), answer
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
