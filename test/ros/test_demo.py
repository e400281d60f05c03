"""The demo as `make demo` runs it, eight times as fast."""

import math
import re
import subprocess
import sys

import pytest
from sensor_msgs.msg import Imu
from std_msgs.msg import Float64

from magcal_ros.cli.main import main
from magcal_ros.files import read_calibration
from magcal_ros.ros import rehearsal
from magcal_ros.ros.rehearsal import set_time

DEMO = ["demo", "--speed", "8"]


class ShortRehearsal(rehearsal.Rehearsal):
    """Stands at three headings instead of twenty-four, and has fewer samples: most of the demo."""

    def __init__(self, *arguments, **options):
        super().__init__(*arguments, imu_rate=25.0, **options)

    def published_errors(self, tilts, headings=3):
        return super().published_errors(tilts, headings)


def errors(printed, row):
    """Degrees on the level and on slopes, from one row of the table."""
    line = next(line for line in printed.splitlines() if line.startswith(f"  {row}"))
    level, slope = line.replace("°", "").split()[-2:]
    return float(level), float(slope)


def check(printed, folder):
    assert "Calibrated, quality" in printed
    assert "true    found    error" in printed
    # Paths are left whole, and a pipe gets the progress uncut.
    lines = [line for line in printed.splitlines() if "/" not in line and line[:1] != "["]
    assert max(map(len, lines)) <= 80
    assert errors(printed, "before")[0] > 10.0
    published, slopes = errors(printed, "after: published")
    # Three headings with the sensors' noise; what is left without it stands below.
    assert published < 1.0
    assert slopes < 1.0
    assert max(errors(printed, "after, without the sensors' noise")) < 0.3
    output = re.search(r"roll (\S+)°, pitch (\S+)°", " ".join(printed.split())).groups()
    rows = [
        re.search(rf"installation {name} \(°\).*?(\S+) +\S+\n", printed)
        for name in ("roll", "pitch")
    ]
    assert tuple(row[1] for row in rows) == output
    assert "8 times as fast as in real time" in printed
    assert f"-p calibration_file:={folder / 'calibration.yaml'}" in printed
    calibration, _ = read_calibration(folder / "calibration.yaml")
    assert abs(calibration.correction.hard_iron[0] - 15e-6) < 0.3e-6


def test_the_demo_ends_with_a_correct_heading_and_a_calibration_file(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "80")
    monkeypatch.setattr(rehearsal, "Rehearsal", ShortRehearsal)
    assert main(DEMO) == 0
    check(capsys.readouterr().out, tmp_path)


def test_late_yaws_of_an_old_pose_do_not_count(loaded):
    """They lie in the queues of a busy machine."""
    actor = loaded(imu_rate=50.0)
    late_attitudes = actor.node.create_publisher(Imu, "compass/mag/enu/imu", 10)
    late_yaws = actor.node.create_publisher(Float64, "compass/yaw", 10)

    def come_late():
        old = Imu()
        set_time(old.header.stamp, actor.ride.stamp - 2.0)
        old.orientation.z = 1.0
        late_attitudes.publish(old)
        late_yaws.publish(Float64(data=math.pi))

    actor.node.create_timer(0.01, come_late)
    errors = actor.published_errors([(0.0, 0.0)], 3)
    assert max(map(abs, errors)) < math.radians(2.0)


@pytest.mark.nightly
def test_the_demo_runs_as_documented(tmp_path):
    done = subprocess.run(
        [sys.executable, "-m", "magcal_ros.cli.main", *DEMO],
        capture_output=True,
        text=True,
        check=False,
        timeout=280,
        cwd=tmp_path,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    check(done.stdout, tmp_path)
