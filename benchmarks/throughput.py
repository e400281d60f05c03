"""CPU per message of the calibrated node, as a ratio to a bare rclpy relay of the same topics.

Both processes receive from the same publisher at the same time; each has one listener on every
output. Run it as `python benchmarks/throughput.py [seconds per row]`: first without a listener on
the fused yaw, which comes at the IMU's rate, then with one.
"""

from __future__ import annotations

import sys
import tempfile
import time
from pathlib import Path

import rclpy
import stage
from sensor_msgs.msg import Imu, MagneticField
from std_msgs.msg import Float64

RATES = ((100, 50), (400, 200), (1000, 1000))
OUTPUTS = (
    (MagneticField, "imu/mag_unbiased"),
    (Imu, "compass/mag/enu/imu"),
    (Imu, "compass/true/enu/imu"),
    (Float64, "compass/yaw"),
    (Imu, "relayed/imu/data_raw"),
    (MagneticField, "relayed/imu/mag"),
)


def measure(pids: list[int], imu_rate: int, field_rate: int, seconds: float) -> list[float]:
    """Microseconds of CPU per incoming message for each process."""
    node = rclpy.create_node("load")
    load = stage.Load(node, imu_rate, field_rate)
    load.wait()
    load.run(2.0)
    before = [stage.cpu_seconds(pid) for pid in pids]
    messages = load.run(seconds)
    used = [stage.cpu_seconds(pid) - start for pid, start in zip(pids, before, strict=True)]
    node.destroy_node()
    return [1e6 * seconds / messages for seconds in used]


def main() -> None:
    seconds = float(sys.argv[1]) if len(sys.argv) > 1 else 10.0
    rclpy.init()
    for listener, title in (("--listen", "per incoming message"), ("--fused", "with fused yaw")):
        print(f"CPU {title:22s}   relay     calibrator   ratio")
        measure_rates(listener, seconds)
    rclpy.try_shutdown()


def measure_rates(listener: str, seconds: float) -> None:
    """Print a row for each pair of rates."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "calibration.yaml"
        stage.store_calibration(path)
        options = ("--ros-args", "-p", f"calibration_file:={path}")
        with (
            stage.running(__file__, listener),
            stage.running(*stage.RELAY) as relay,
            stage.running(*stage.CALIBRATOR, *options) as calibrator,
        ):
            time.sleep(3.0)
            for imu_rate, field_rate in RATES:
                pids = [relay.pid, calibrator.pid]
                bare, ours = measure(pids, imu_rate, field_rate, seconds)
                name = f"IMU {imu_rate} Hz, field {field_rate} Hz"
                print(f"{name:26s}{bare:7.0f} µs {ours:9.0f} µs {ours / bare:9.2f}", flush=True)


def listen(outputs: tuple[tuple[type, str], ...]) -> None:
    """Subscribe to the outputs of both, and ignore them."""
    rclpy.init()
    node = rclpy.create_node("listener")
    for kind, topic in outputs:
        node.create_subscription(kind, topic, lambda _: None, 10, raw=True)
    try:
        rclpy.spin(node)
    except (KeyboardInterrupt, rclpy.executors.ExternalShutdownException):
        pass
    finally:
        rclpy.try_shutdown()


if __name__ == "__main__":
    if "--listen" in sys.argv:
        listen(OUTPUTS)
    elif "--fused" in sys.argv:
        listen((*OUTPUTS, (Imu, "compass/fused/enu/imu")))
    else:
        main()
