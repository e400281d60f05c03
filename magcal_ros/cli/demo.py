"""`magcal demo`: the main job end to end, with a simulated robot and the real node."""

from __future__ import annotations

import argparse
import math
import os
import signal
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from magcal_ros.cli.common import Exit
from magcal_ros.cli.graph import joined, keep_traffic_here
from magcal_ros.cli.live_view import Lines, line
from magcal_ros.core.calibration.calibration import Calibration
from magcal_ros.core.calibration.correction import Correction
from magcal_ros.core.geometry.arrays import FloatArray
from magcal_ros.core.geometry.rotations import rpy_from_rotation
from magcal_ros.core.simulation.simulator import (
    DEGREE,
    LEVEL_TILT,
    Robot,
    heading_errors,
    trial_attitudes,
)
from magcal_ros.files.calibration_file import read_calibration, require_ours

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
"""A compass as it is often found: a few degrees off level, and as magnetised as the field."""

LARGEST_ERROR_DEG = 1.0
"""The demo fails if the heading is worse than this afterwards."""


def add_to(commands: Any) -> None:
    """Add the command's arguments."""
    parser = commands.add_parser(
        "demo",
        help="calibrate a simulated robot with the real node",
        description="Start the calibrator node and a simulated robot with a bad compass, turn "
        "the robot once, and compare what was found with the truth.",
    )
    parser.add_argument(
        "--output", type=Path, default=Path("calibration.yaml"), help="the file that is left"
    )
    parser.add_argument("--speed", type=float, default=1.0, help="times real time (default: 1)")
    parser.add_argument("--seed", type=int, default=1, help="seed of the noise (default: 1)")
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Run the demo; the exit status says whether the heading came out right."""
    require_ours(options.output)
    keep_traffic_here()
    print("A simulated robot whose compass is badly mounted and magnetised, and the real node.\n")
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
    command = [sys.executable, "-m", "magcal_ros.ros.main", "--ros-args", "--log-level", "warn"]
    for name, value in parameters.items():
        command += ["-p", f"{name}:={value}"]
    return subprocess.Popen(command, env=os.environ)


def _rehearse(rehearsal: Any, output: Path) -> int:
    rehearsal.wait_for_node()
    rehearsal.reset()
    before = _both(rehearsal.uncalibrated_errors)
    print("$ ros2 service call /calibrator/calibrate std_srvs/srv/Trigger     (the robot turns)")
    answer = rehearsal.calibrate(_Progress().show)
    print(f"\n\n{answer.message}\n")
    if not answer.success:
        return Exit.REFUSED
    print("The robot now stands at 24 headings, on the level and on four slopes.\n", flush=True)
    calibration, _ = read_calibration(output)
    after = _both(rehearsal.published_errors)
    print(_comparison(calibration))
    print("heading error, RMS over 24 headings      level   8° slopes")
    for name, (level, slope) in (
        ("before: raw field, true tilt", before),
        ("after: published yaw, 20 messages", after),
        ("after, without the sensors' noise", _without_noise(calibration.correction)),
    ):
        print(f"  {name:36s}{level:7.2f}°  {slope:7.2f}°")
    print(f"\nThe calibration is in {output}; the node would load it at its next start.")
    return Exit.GOOD if max(after) <= LARGEST_ERROR_DEG else Exit.FAILED


class _Progress(Lines):
    """One line, drawn again on a terminal; a line a second through a pipe."""

    def show(self, progress: dict[str, Any]) -> None:
        if sys.stdout.isatty():
            print(f"\r{line(progress)}\x1b[K", end="", flush=True)
        else:
            super().show(progress)


def _both(errors: Any) -> tuple[float, float]:
    slopes = [(8.0, 0.0), (0.0, 8.0), (-8.0, 0.0), (0.0, -8.0)]
    level = _rms(errors([(0.0, 0.0)]))
    return level, _rms(errors(slopes))


def _without_noise(correction: Correction) -> tuple[float, float]:
    errors = heading_errors(correction, ROBOT, trial_attitudes(8.0 * DEGREE))
    one_way_tilts = errors[:, 1::2]
    return _rms(errors[:, LEVEL_TILT]), _rms(one_way_tilts)


def _rms(errors: Sequence[float] | FloatArray) -> float:
    return math.degrees(math.sqrt(float(np.mean(np.square(errors)))))


def _comparison(calibration: Calibration) -> str:
    found = calibration.correction.hard_iron * 1e6
    true = ROBOT.hard_iron * 1e6
    roll, pitch, _ = rpy_from_rotation(calibration.correction.matrix)
    rows = [
        *((f"hard iron {axis} (µT)", t, f) for axis, t, f in zip("xyz", true, found, strict=True)),
        ("roll of the sensor (°)", math.degrees(ROBOT.roll), math.degrees(roll)),
        ("pitch of the sensor (°)", math.degrees(ROBOT.pitch), math.degrees(pitch)),
    ]
    lines = [f"{'':28s}{'true':>9s}{'found':>9s}{'error':>9s}"]
    lines += [f"  {name:26s}{t:9.2f}{f:9.2f}{f - t:9.2f}" for name, t, f in rows]
    return "\n".join(lines) + "\n"
