"""`magcal replay`: a recorded drive on the two sensor topics."""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path
from typing import Any

from magcal_ros.cli.exits import Exit
from magcal_ros.cli.graph import joined
from magcal_ros.files.recording import read_csv_folder


def add_to(commands: Any) -> None:
    """Add the command's arguments."""
    parser = commands.add_parser(
        "replay",
        help="publish a recorded drive on imu/data_raw and imu/mag",
        description="Publish a recorded drive (a folder with imu.csv: t,ax,ay,az,gx,gy,gz and "
        "mag.csv: t,mx,my,mz; SI units) on imu/data_raw and imu/mag under its own stamps.",
    )
    parser.add_argument("folder", type=Path, help="holds imu.csv and mag.csv")
    parser.add_argument("--rate", type=_positive, default=1.0, help="times real time (default: 1)")
    parser.add_argument(
        "--wait", type=float, default=10.0, help="seconds to wait for a subscriber (default: 10)"
    )
    parser.add_argument("--clock", action="store_true", help="publish /clock for use_sim_time")
    parser.add_argument("--imu-frame", default="imu_link", help="frame_id of the Imu messages")
    parser.add_argument("--mag-frame", default="mag_link", help="frame_id of the field messages")
    parser.add_argument(
        "--ros-args", nargs=argparse.REMAINDER, default=[], help="remaps and namespaces"
    )
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Play the recording to its end."""
    recording = read_csv_folder(options.folder)
    with joined("magcal_replay", ["--ros-args", *options.ros_args]) as node:
        from magcal_ros.ros.replay import replay
        from magcal_ros.ros.sensor_source import SensorSource

        source = SensorSource(node, options.imu_frame, options.mag_frame)
        if not _wait_for_listener(source, options.wait):
            print("magcal: nobody listens; publishing all the same", file=sys.stderr)
        count = replay(node, source, recording, options.rate, time.sleep, options.clock)
    print(f"replayed {count} samples of {options.folder}")
    return Exit.GOOD


def _wait_for_listener(source: Any, patience: float) -> bool:
    deadline = time.monotonic() + patience
    while not source.listeners and time.monotonic() < deadline:
        time.sleep(0.05)
    time.sleep(0.2)
    return bool(source.listeners)


def _positive(text: str) -> float:
    value = float(text)
    if not value > 0.0:
        raise argparse.ArgumentTypeError("must be greater than zero")
    return value
