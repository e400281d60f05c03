"""`magcal replay`: a recorded drive on the two sensor topics."""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

from magcal_ros.cli.common import Exit, number
from magcal_ros.cli.live_view import joined
from magcal_ros.files.atomic import FileTrouble
from magcal_ros.files.reading import plain, plain_lines
from magcal_ros.files.recording import Recording, read_csv_folder

LAST_STAMP = 2.0**31 - 2.0
"""Seconds that a message's stamp can hold, less the shift that a start at zero gets."""


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
        "--wait",
        type=number(0.0, 1e6),
        default=10.0,
        help="seconds to wait for a subscriber (default: 10)",
    )
    parser.add_argument("--clock", action="store_true", help="publish /clock for use_sim_time")
    frames = (("--imu-frame", "imu_link", "Imu"), ("--mag-frame", "mag_link", "field"))
    for option, default, kind in frames:
        words = f"frame_id of the {kind} messages"
        parser.add_argument(option, type=_frame, default=default, help=words)
    parser.add_argument(
        "--ros-args", nargs=argparse.REMAINDER, default=[], help="remaps and namespaces"
    )
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Play the recording to its end."""
    recording = read_csv_folder(options.folder)
    _require_stamps(options.folder, recording)
    with joined("magcal_replay", ["--ros-args", *options.ros_args]) as node:
        from magcal_ros.ros.sensor_source import SensorSource, replay

        source = SensorSource(node, options.imu_frame, options.mag_frame)
        if not _wait_for_listener(source, options.wait):
            print("magcal: there is no subscriber; publishing all the same", file=sys.stderr)
        count = replay(node, source, recording, options.rate, time.sleep, options.clock)
    print(plain_lines(f"replayed {count} samples of {options.folder}"))
    return Exit.GOOD


def _wait_for_listener(source: Any, patience: float) -> bool:
    deadline = time.monotonic() + patience
    while not source.listeners and time.monotonic() < deadline:
        time.sleep(0.05)
    time.sleep(0.2)
    return bool(source.listeners)


def _require_stamps(folder: Path, recording: Recording) -> None:
    """Refuse what no message can carry: a stamp that is no number, or beyond the stamps of ROS."""
    for name, table in (("imu.csv", recording.imu), ("mag.csv", recording.field)):
        stamps = table[:, 0]
        bad = ~(np.isfinite(stamps) & (np.abs(stamps) < LAST_STAMP))
        if bad.any():
            row = int(np.argmax(bad))
            raise FileTrouble(
                f"{plain(str(folder / name))} cannot be replayed: sample {row + 1} has the stamp "
                f"{stamps[row]:g}"
            )


def _frame(text: str) -> str:
    try:
        text.encode("utf-8")
    except UnicodeEncodeError:
        raise argparse.ArgumentTypeError(f"{plain(text)!r} is no UTF-8 text") from None
    return text


def _positive(text: str) -> float:
    value = number(0.0, 1e6)(text)
    if not value > 0.0:
        raise argparse.ArgumentTypeError("must be greater than zero")
    return value
