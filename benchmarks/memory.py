"""Memory of the calibrated node over many messages, and of a collection that does not end.

The node receives IMU and field at 2000 Hz each, with a listener on its outputs, until it has
received the given number of messages. Its memory after the first tenth is compared with that at
the end. Run it as `python benchmarks/memory.py [messages]`.
"""

from __future__ import annotations

import math
import sys
import tempfile
import tracemalloc
from pathlib import Path

import rclpy
import stage
from diagnostic_msgs.msg import DiagnosticArray

from magcal_ros.core.knowledge import Mounting
from magcal_ros.core.samples.streams import FieldSample, ImuSample, Pair
from magcal_ros.core.session.session import Limits, Session

RATE = 2000
HOUR = 3600


class Count:
    """The number of messages that the node reports."""

    def __init__(self) -> None:
        self._node = rclpy.create_node("count")
        self._node.create_subscription(DiagnosticArray, "/diagnostics", self._note, 10)
        self._executor = rclpy.executors.SingleThreadedExecutor()
        self._executor.add_node(self._node)
        self.messages = 0

    def _note(self, report: DiagnosticArray) -> None:
        values = [value for status in report.status for value in status.values]
        self.messages = sum(int(v.value) for v in values if v.key.endswith(" messages"))

    def has_reached(self, messages: int) -> bool:
        self._executor.spin_once(timeout_sec=0.0)
        return self.messages >= messages


def over_messages(messages: int) -> None:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "calibration.yaml"
        stage.store_calibration(path)
        throughput = str(stage.HERE / "throughput.py")
        options = ("--ros-args", "-p", f"calibration_file:={path}")
        with (
            stage.running(throughput, "--listen"),
            stage.running(*stage.CALIBRATOR, *options) as calibrator,
        ):
            rclpy.init()
            load, count = stage.Load(rclpy.create_node("load"), RATE, RATE), Count()
            load.wait()
            load.run(math.inf, lambda: count.has_reached(messages // 10))
            before = stage.resident_mib(calibrator.pid)
            load.run(math.inf, lambda: count.has_reached(messages))
            after = stage.resident_mib(calibrator.pid)
            rclpy.try_shutdown()
    name = f"the node, {count.messages / 1e6:.2f} million messages"
    print(f"{name:40s}{before:9.1f} MiB{after:9.1f} MiB{after / before:9.3f}", flush=True)


def over_an_hour() -> None:
    """Collect one slow turn of an hour at 1 kHz."""
    tracemalloc.start()
    session = Session(Limits(), Mounting(), now=0.0)
    middle = 0
    for k in range(HOUR * 1000):
        yaw, stamp = k * math.tau / (HOUR * 1000), 1.0 + 1e-3 * k
        field = (2e-5 * math.cos(yaw), -2e-5 * math.sin(yaw), -4e-5)
        imu = ImuSample(stamp, (0.0, 0.0, 9.81), (0.0, 0.0, math.tau / HOUR))
        session.add(Pair(FieldSample(stamp, field), imu), stamp)
        if k == 60_000:
            middle = tracemalloc.get_traced_memory()[0]
    end = tracemalloc.get_traced_memory()[0]
    tracemalloc.stop()
    arc = math.degrees(session.progress(stamp).coverage.arc)
    print(
        f"{'a collection, 1 min and 1 h at 1 kHz':40s}{middle / 2**20:9.1f} MiB"
        f"{end / 2**20:9.1f} MiB{end / middle:9.3f}   ({arc:.0f}° of the turn kept)",
        flush=True,
    )


def main() -> None:
    print(f"{'memory':40s}{'early':>13s}{'late':>13s}{'ratio':>9s}")
    over_messages(int(float(sys.argv[1])) if len(sys.argv) > 1 else 1_000_000)
    over_an_hour()


if __name__ == "__main__":
    main()
