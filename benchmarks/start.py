"""Time from exec to the first message, of the calibrator with a saved calibration and of a relay.

The sensors publish all the while, and somebody listens. On a machine that does other things, too,
the processor's seconds say more. Run it as `python benchmarks/start.py [rounds]`.
"""

from __future__ import annotations

import os
import statistics
import sys
import tempfile
import threading
import time
from pathlib import Path

import rclpy
import stage
from sensor_msgs.msg import MagneticField

PATIENCE = 30.0


class Listener:
    """Waits for the first message of a topic."""

    def __init__(self, topic: str) -> None:
        self._node = rclpy.create_node(topic.replace("/", "_") + "_listener")
        self._heard = threading.Event()
        self._node.create_subscription(MagneticField, topic, self._hear, 10, raw=True)
        self._executor = rclpy.executors.SingleThreadedExecutor()
        self._executor.add_node(self._node)

    def close(self) -> None:
        """End it while rclpy is there."""
        self._executor.shutdown()
        self._node.destroy_node()  # type: ignore[no-untyped-call]

    def _hear(self, _: bytes) -> None:
        self._heard.set()

    def _drain(self) -> None:
        """Discard messages of the previous program in the queue."""
        self._heard.set()
        while self._heard.is_set():
            self._heard.clear()
            self._executor.spin_once(timeout_sec=0.2)

    def time_to_hear(self, *program: str) -> tuple[float, float]:
        """Start a program; return the seconds until its first message, and the processor's."""
        self._drain()
        began = time.perf_counter()
        with stage.running(*program) as process:
            while not self._heard.is_set():
                assert time.perf_counter() - began < PATIENCE, f"{program} published nothing"
                self._executor.spin_once(timeout_sec=0.1)
            return time.perf_counter() - began, stage.cpu_seconds(process.pid)


def main() -> None:
    # An installed package is compiled; without compiled files each start would compile it anew.
    os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
    rounds = int(sys.argv[1]) if len(sys.argv) > 1 else 8
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "calibration.yaml"
        stage.store_calibration(path)
        rclpy.init()
        load = stage.Load(rclpy.create_node("load"), 100, 100)
        over = threading.Event()
        thread = threading.Thread(target=load.run, args=(1e9, over.is_set))
        thread.start()
        relay, calibrator = Listener("relayed/imu/mag"), Listener("imu/mag_unbiased")
        options = ("--ros-args", "-p", f"calibration_file:={path}")
        bare, ours = [], []
        for _ in range(rounds):
            bare.append(relay.time_to_hear(*stage.RELAY))
            ours.append(calibrator.time_to_hear(*stage.CALIBRATOR, *options))
        over.set()
        thread.join()
        relay.close()
        calibrator.close()
        rclpy.try_shutdown()
    print("exec to first message        relay     calibrator   ratio")
    # What the slower rounds take more is the discovery of DDS, of the relay as well.
    for which, kind in enumerate(("", ", CPU")):
        for name, of in ((f"median of {rounds}", statistics.median), ("fastest", min)):
            a, b = (of(each[which] for each in taken) for taken in (bare, ours))
            print(f"{name + kind:26s}{a:7.2f} s  {b:9.2f} s  {b / a:9.2f}")


if __name__ == "__main__":
    main()
