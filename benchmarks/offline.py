"""Time of `magcal fit` on a long bag, as a ratio to the time that reading the bag takes.

Reading means what the `rosbags` library needs to hand over every message of the two topics,
deserialised. Run it as `python benchmarks/offline.py [minutes] [hertz]`.
"""

from __future__ import annotations

import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import shared_cases  # noqa: F401
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore
from simulated.turns import measure, turn

from magcal_ros.cli.main import main as magcal
from magcal_ros.core.samples.window import Window
from magcal_ros.core.session.recorded import SampleCollector
from magcal_ros.core.simulation import Robot
from magcal_ros.files.sources import open_recording

ROBOT = Robot()
TURN_RATE = 0.3
"""rad/s of the robot, which goes round and round."""

TOPICS = {"/imu/data_raw": "sensor_msgs/msg/Imu", "/imu/mag": "sensor_msgs/msg/MagneticField"}


def drive(minutes: float, hertz: float) -> Window:
    """The samples of the drive."""
    seconds = 60.0 * minutes
    motion = turn(arc=TURN_RATE * seconds, samples=int(seconds * hertz), duration=seconds)
    return measure(ROBOT, motion, np.random.default_rng(1), gyro=True)


def write_bag(path: Path, window: Window) -> None:
    """Write the two topics as a driver and `ros2 bag record -s mcap` would."""
    store = get_typestore(Stores.ROS2_HUMBLE)
    with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        out = {
            msgtype: writer.add_connection(topic, msgtype, typestore=store)
            for topic, msgtype in TOPICS.items()
        }
        for stamp, message in messages(window, store.types):
            kind = message.__msgtype__
            writer.write(out[kind], stamp, store.serialize_cdr(message, kind))


def messages(window: Window, types: dict[str, Any]) -> Iterator[tuple[int, Any]]:
    """Stamp and message, one IMU and one field message per row."""
    header, time_type = types["std_msgs/msg/Header"], types["builtin_interfaces/msg/Time"]
    vector, quaternion = types["geometry_msgs/msg/Vector3"], types["geometry_msgs/msg/Quaternion"]
    imu, field = (types[msgtype] for msgtype in TOPICS.values())
    still, none = quaternion(0.0, 0.0, 0.0, 1.0), np.zeros(9)
    assert window.angular_rate is not None
    rows = zip(
        (window.time + 1000.0).tolist(),
        window.field.tolist(),
        window.specific_force.tolist(),
        window.angular_rate.tolist(),
        strict=True,
    )
    for stamp, b, f, w in rows:
        nanoseconds = round(stamp * 1e9)
        head = header(time_type(*divmod(nanoseconds, 1_000_000_000)), "imu_link")
        yield nanoseconds, imu(head, still, none, vector(*w), none, vector(*f), none)
        yield nanoseconds, field(head, vector(*b), none)


def time_reading(path: Path) -> float:
    """Seconds until the library has handed over every message."""
    start = time.perf_counter()
    with AnyReader([path]) as reader:
        for connection, _, data in reader.messages():
            reader.deserialize(data, connection.msgtype)
    return time.perf_counter() - start


def time_gathering(path: Path) -> float:
    """Seconds until everything lies in the session, before the fit."""
    start = time.perf_counter()
    with open_recording(path) as source:
        collector = SampleCollector(ROBOT.mounting)
        collector.take(source.readings())
    return time.perf_counter() - start


def time_fit(path: Path, output: Path) -> float:
    """Seconds of the whole command."""
    start = time.perf_counter()
    reference = ["--reference-strength-ut", "50", "--reference-inclination-deg", "60"]
    status = magcal(["fit", str(path), "--output", str(output), *reference])
    assert status == 0
    return time.perf_counter() - start


def main() -> None:
    minutes = float(sys.argv[1]) if len(sys.argv) > 1 else 30.0
    hertz = float(sys.argv[2]) if len(sys.argv) > 2 else 200.0
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "bag"
        write_bag(path, drive(minutes, hertz))
        reading = time_reading(path)
        collector = time_gathering(path)
        fit = time_fit(path, Path(folder) / "fit")
        print(f"bag: {minutes:g} min, IMU and field at {hertz:g} Hz")
        print(f"reading    {reading:7.2f} s")
        print(f"gathering  {collector:7.2f} s  ratio {collector / reading:.2f}")
        print(f"magcal fit {fit:7.2f} s  ratio {fit / reading:.2f} (want 1.5 or less)")


if __name__ == "__main__":
    main()
