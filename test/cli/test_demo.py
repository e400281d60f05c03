"""The demo as `make demo` runs it, eight times as fast."""

import subprocess
import sys

import pytest

from magcal_ros.files.calibration_file import read_calibration


def magcal(*arguments, **options):
    return subprocess.run(
        [sys.executable, "-m", "magcal_ros.cli.main", *arguments],
        capture_output=True,
        text=True,
        check=False,
        timeout=280,
        **options,
    )


def errors(printed, row):
    """Degrees on the level and on slopes, from one row of the table."""
    line = next(line for line in printed.splitlines() if line.startswith(f"  {row}"))
    level, slope = line.replace("°", "").split()[-2:]
    return float(level), float(slope)


def test_the_demo_ends_with_a_right_heading_and_leaves_the_calibration(tmp_path):
    pytest.importorskip("rclpy")
    done = magcal("demo", "--speed", "8", cwd=tmp_path)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "Calibrated, quality" in done.stdout
    assert "true    found    error" in done.stdout
    assert errors(done.stdout, "before")[0] > 10.0
    published, slopes = errors(done.stdout, "after: published")
    assert published < 0.7
    assert slopes < 1.0
    assert max(errors(done.stdout, "after, without the sensors' noise")) < 0.3
    calibration, _ = read_calibration(tmp_path / "calibration.yaml")
    assert abs(calibration.correction.hard_iron[0] - 15e-6) < 0.3e-6


def test_a_missing_recording_is_said_in_one_line(tmp_path):
    done = magcal("replay", str(tmp_path / "nowhere"))
    assert done.returncode == 5
    assert done.stderr.startswith("magcal: cannot read")
    assert "Traceback" not in done.stderr


def test_a_wrong_command_is_a_usage_error():
    assert magcal("dance").returncode == 2
    assert magcal("replay", "somewhere", "--rate", "-1").returncode == 2
