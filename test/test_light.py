"""Modules that are not loaded before they are needed; each in a separate process."""

import subprocess
import sys

import numpy as np
import pytest
from simulated.turns import measure, turn

from magcal_ros.core import calibrate
from magcal_ros.core.simulation import Robot
from magcal_ros.files import Origin, write_calibration

NODE = """
import sys, time
import rclpy
from magcal_ros.ros.main import Calibrator
rclpy.init(args=["--ros-args", "-p", "calibration_file:=" + sys.argv[1]])
node = Calibrator()
spinner = node.spinner()
soonest, latest = time.monotonic() + 1.2, time.monotonic() + 60.0
while time.monotonic() < soonest or (
    node._store.calibration is None and time.monotonic() < latest
):
    spinner.spin_once(timeout_sec=0.1)
assert node._store.calibration is not None
print(*sys.modules)
spinner.shutdown()
node.close()
rclpy.shutdown()
"""


def modules_after(script, *arguments):
    """Return what is loaded after a script that prints it."""
    done = subprocess.run(
        [sys.executable, "-c", script, *arguments], capture_output=True, text=True, check=True
    )
    return set(done.stdout.split())


def loaded_of(modules, package):
    return {name for name in modules if name == package or name.startswith(package + ".")}


def test_a_node_that_runs_on_a_saved_calibration_loads_nothing_that_fits_or_draws(tmp_path):
    pytest.importorskip("rclpy")
    robot, path = Robot(), tmp_path / "calibration.yaml"
    window = measure(robot, turn(), np.random.default_rng(1))
    outcome = calibrate(window, robot.knowledge(), "design_tip")
    write_calibration(path, outcome.calibration, Origin.now("mag_link", "imu_link"))
    loaded = modules_after(NODE, str(path))
    assert "magcal_ros.ros.node" in loaded
    for later in (
        "scipy",
        "matplotlib",
        "magcal_ros.report",
        "magcal_ros.core.methods",
        "magcal_ros.core.doctor",
        "magcal_ros.core.self_calibration.drive_replay",
        "magcal_ros.core.smoother",
        "multiprocessing",
    ):
        assert not loaded_of(loaded, later), later
