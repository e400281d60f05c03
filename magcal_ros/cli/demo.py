"""`magcal demo` and `replay`: simulated sensors, or sensors of a recorded drive."""

from __future__ import annotations

import argparse
import math
import os
import signal
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from magcal_ros.cli.common import Exit, command, number, tell
from magcal_ros.cli.live_view import best_view, joined, use_local_traffic
from magcal_ros.core.calibration.calibration import Calibration
from magcal_ros.core.calibration.correction import Correction
from magcal_ros.core.geometry.arrays import FloatArray
from magcal_ros.core.simulation.simulator import (
    DEGREE,
    LEVEL_TILT,
    Robot,
    heading_errors,
    trial_attitudes,
)
from magcal_ros.files.calibration_file import read_calibration, require_ours
from magcal_ros.files.disk import FileError, printable, printable_lines
from magcal_ros.files.recording import Recording, read_csv_folder
from magcal_ros.processes import start

if TYPE_CHECKING:
    import subprocess


ROBOT = Robot(
    strength=48e-6,
    inclination=65.0 * DEGREE,
    declination=3.0 * DEGREE,
    roll=3.0 * DEGREE,
    pitch=-4.0 * DEGREE,
    hard_iron=np.array([15e-6, -8e-6, 10e-6]),
    noise_field=0.3e-6,
    noise_force=0.02,
)
"""A common case: a compass tilted by a few degrees, with hard iron as strong as the level field."""

DEMO_SECONDS = 200.0
"""Duration of the demo in real time, seconds, most of it at 24 headings on five slopes."""

NEXT_STEPS = """\
The simulated robot's calibration is in
  {file}
A node loads it when it is started with
  -p calibration_file:={file}
Without this parameter it loads
  ~/.ros/magcal/<node>.<frame>.yaml
where it also saves a calibration. On your robot, start the node on your topics
and let the command show the turn, as README.md says:
  ros2 run magcal_ros calibrator --ros-args -r imu/data_raw:=/your/imu \\
    -r imu/mag:=/your/magnetometer -p reference.latitude_deg:=48.1 \\
    -p reference.longitude_deg:=11.6
  ros2 run magcal_ros magcal calibrate"""

LARGEST_ERROR_DEG = 1.0  # largest heading error with which the demo succeeds


def add_demo(commands: Any) -> None:
    """Add the command's arguments."""
    words = "calibrate a simulated robot with the real node"
    parser = command(commands, "demo", run_demo, words)
    parser.add_argument(
        "--output",
        type=Path,
        default=Path("calibration.yaml"),
        help="calibration file to write (default: calibration.yaml here)",
    )
    speed, words = number(1e-3, 1e3), "times real time (default: 1)"
    parser.add_argument("--speed", type=speed, default=1.0, help=words)
    parser.add_argument("--seed", type=int, default=1, help="seed of the noise (default: 1)")


def run_demo(options: argparse.Namespace) -> int:
    """Start the calibrator node and a simulated robot with a badly mounted compass.

    The robot turns once, and the calibration is compared with the true values.
    """
    require_ours(options.output)
    use_local_traffic()
    print("The real node, and a simulated robot with a badly mounted, magnetised compass.")
    seconds = DEMO_SECONDS / options.speed
    print(f"The robot turns once, and then its heading is checked: about {seconds:.0f} s.")
    if options.speed != 1.0:
        print(f"Everything runs {options.speed:g} times as fast as in real time.")
    print()
    process = _start_node(options.output)
    try:
        with joined("magcal_demo") as node:
            from magcal_ros.ros.rehearsal import Rehearsal

            rehearsal = Rehearsal(node, ROBOT, options.seed, options.speed)
            return _rehearse(rehearsal, options.output)
    finally:
        process.send_signal(signal.SIGINT)
        process.wait(timeout=10)


def _start_node(output: Path) -> subprocess.Popen[bytes]:
    parameters = {
        "calibration_file": output.resolve(),
        "report_folder": output.resolve().parent / "magcal_reports",
        "reference.strength_ut": ROBOT.strength * 1e6,
        "reference.inclination_deg": ROBOT.inclination / DEGREE,
        "reference.declination_deg": ROBOT.declination / DEGREE,
    }
    given = [word for name, value in parameters.items() for word in ("-p", f"{name}:={value}")]
    # Only errors are logged, because the calibration file does not exist yet and causes a warning.
    return start("magcal_ros.ros.main", "--ros-args", "--log-level", "error", *given)


def _rehearse(rehearsal: Any, output: Path) -> int:
    rehearsal.wait_for_node()
    rehearsal.reset()
    print("$ ros2 service call /calibrator/calibrate std_srvs/srv/Trigger", flush=True)
    with best_view() as view:
        answer = rehearsal.calibrate(view.show)
    tell(f"\n{answer.message}\n")
    if not answer.success:
        return Exit.REFUSED
    print("The robot now stands at 24 headings, on level ground and on four slopes.\n", flush=True)
    calibration, _ = read_calibration(output)
    slopes = [(8.0, 0.0), (0.0, 8.0), (-8.0, 0.0), (0.0, -8.0)]
    after = tuple(_rms(rehearsal.published_errors(each)) for each in ([(0.0, 0.0)], slopes))
    print(_comparison(calibration, rehearsal.status["verdict"]["installation_rpy_deg"]))
    print("heading error, RMS over 24 headings      level   8° slopes")
    for name, (level, slope) in (
        ("before: raw field, true tilt", _without_noise(Correction.identity())),
        ("after: published yaw, 20 messages", after),
        ("after, without the sensors' noise", _without_noise(calibration.correction)),
    ):
        print(f"  {name:36s}{level:7.2f}°  {slope:7.2f}°")
    print(printable_lines(f"\n{NEXT_STEPS.format(file=output.resolve())}"))
    return Exit.GOOD if max(after) <= LARGEST_ERROR_DEG else Exit.FAILED


def _without_noise(correction: Correction) -> tuple[float, float]:
    errors = heading_errors(correction, ROBOT, trial_attitudes(8.0 * DEGREE))
    one_way_tilts = errors[:, 1::2]
    return _rms(errors[:, LEVEL_TILT]), _rms(one_way_tilts)


def _rms(errors: Sequence[float] | FloatArray) -> float:
    return math.degrees(math.sqrt(float(np.mean(np.square(errors)))))


def _comparison(calibration: Calibration, installation_rpy_deg: Sequence[float]) -> str:
    found = calibration.correction.hard_iron * 1e6
    true = ROBOT.hard_iron * 1e6
    roll, pitch, _ = installation_rpy_deg
    rows = [
        *((f"hard iron {axis} (µT)", t, f) for axis, t, f in zip("xyz", true, found, strict=True)),
        ("installation roll (°)", math.degrees(ROBOT.roll), roll),
        ("installation pitch (°)", math.degrees(ROBOT.pitch), pitch),
    ]
    lines = [f"{'':28s}{'true':>9s}{'found':>9s}{'error':>9s}"]
    lines += [f"  {name:26s}{t:9.2f}{f:9.2f}{round(f - t, 2) + 0.0:9.2f}" for name, t, f in rows]
    return "\n".join(lines) + "\n"


LAST_STAMP = 2.0**31 - 2.0
"""Largest stamp of a message in seconds, minus the shift of a recording that starts at zero."""


def add_replay(commands: Any) -> None:
    """Add the command's arguments."""
    words = "publish a recorded drive on imu/data_raw and imu/mag"
    parser = command(commands, "replay", run_replay, words)
    parser.add_argument(
        "folder", type=Path, help="folder with imu.csv and mag.csv (for a bag use `ros2 bag play`)"
    )
    parser.add_argument(
        "--rate", type=number(1e-6, 1e6), default=1.0, help="times real time (default: 1)"
    )
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


def run_replay(options: argparse.Namespace) -> int:
    """Publish a recorded drive on imu/data_raw and imu/mag with its own stamps.

    The recording is a folder with imu.csv: t,ax,ay,az,gx,gy,gz and mag.csv: t,mx,my,mz; SI units.
    """
    folder = options.folder
    if os.path.exists(folder) and not os.path.exists(folder / "imu.csv"):
        raise FileError(
            f"{folder} has no imu.csv: only a folder with imu.csv and mag.csv can be replayed (for "
            "a bag use `ros2 bag play`)"
        )
    recording = read_csv_folder(folder)
    _require_stamps(options.folder, recording)
    with joined("magcal_replay", ["--ros-args", *options.ros_args]) as node:
        from magcal_ros.ros.rehearsal import SensorSource, replay

        source = SensorSource(node, options.imu_frame, options.mag_frame)
        deadline = time.monotonic() + options.wait
        while not source.listeners and time.monotonic() < deadline:
            time.sleep(0.05)
        time.sleep(0.2)
        if not source.listeners:
            print("magcal: there is no subscriber; publishing anyway", file=sys.stderr)
        count = replay(node, source, recording, options.rate, options.clock)
    print(printable_lines(f"replayed {count} samples of {options.folder}"))
    return Exit.GOOD


def _require_stamps(folder: Path, recording: Recording) -> None:
    """Raise FileError for a stamp that a ROS message cannot hold."""
    for name, table in (("imu.csv", recording.imu), ("mag.csv", recording.field)):
        stamps = table[:, 0]
        bad = ~(np.isfinite(stamps) & (np.abs(stamps) < LAST_STAMP))
        if bad.any():
            row = int(np.argmax(bad))
            words = f"cannot be replayed: sample {row + 1} has the stamp {stamps[row]:g}"
            raise FileError.of(folder / name, words)


def _frame(text: str) -> str:
    try:
        text.encode("utf-8")
    except UnicodeEncodeError:
        raise argparse.ArgumentTypeError(f"{printable(text)!r} is not UTF-8 text") from None
    return text
