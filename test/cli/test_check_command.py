import dataclasses
import json
import math

import numpy as np
import pytest
from drives import ROBOT, drive, write_bag, write_csv

from magcal_ros.cli.main import main
from magcal_ros.core.session import SampleCollector, fit_collected
from magcal_ros.files import Origin, write_calibration


@pytest.fixture(scope="module")
def calibration_file(tmp_path_factory):
    collector = SampleCollector(ROBOT.mounting)
    collector.take(drive(400.0))
    outcome = fit_collected(collector, ROBOT.knowledge(1.5e-6, math.radians(1.0)))
    path = tmp_path_factory.mktemp("calibration") / "calibration.yaml"
    write_calibration(path, outcome.calibration, Origin.now("mag_link", "imu_link"))
    return path


@pytest.fixture
def check(calibration_file, capsys, tmp_path, monkeypatch):
    """Run `magcal check`; returns exit status, stdout and stderr."""
    monkeypatch.chdir(tmp_path)

    def run(recording, *arguments, file=calibration_file):
        try:
            status = main(["check", str(recording), "--calibration", str(file), *arguments])
        except SystemExit as left:
            status = left.code
        return status, *capsys.readouterr()

    return run


def moved():
    return dataclasses.replace(ROBOT, hard_iron=ROBOT.hard_iron + np.array([5e-6, 0.0, 0.0]))


def test_a_good_calibration_holds(check, tmp_path):
    status, out, err = check(write_bag(tmp_path / "bag", drive(400.0, seed=2)))
    assert (status, err) == (0, "")
    assert out.startswith("The calibration holds.\n")
    lines = out.splitlines()
    assert lines[2].split() == ["raw", "corrected", "want", "stale"]
    assert sum(line.endswith("holds") for line in lines) == 4
    assert "Not shown by this recording:" in out


def test_the_result_is_printed_although_the_report_cannot_be_written(check, tmp_path):
    output = tmp_path / "found"
    (output / "report.html").mkdir(parents=True)
    bag = write_bag(tmp_path / "bag", drive(400.0, seed=2))
    status, out, err = check(bag, "--output", str(output))
    assert status == 5
    assert out.startswith("The calibration holds.\n")
    assert out.endswith("No report.\n")
    assert "report.html exists already" in err


def test_a_stale_calibration_is_4_with_the_reason(check, tmp_path):
    status, out, _ = check(write_csv(tmp_path / "csv", drive(400.0, moved(), seed=3)))
    assert status == 4
    assert out.startswith("The calibration is stale, calibrate again.\n")
    (row,) = (line for line in out.splitlines() if "heading swing  " in line)
    assert row.split()[-5:] == ["≤", "4°", ">", "7°", "stale"]
    contradicts = out.partition("What contradicts the calibration:")[2].partition("\n\n")[0]
    assert "the calibration makes the heading swing by 8" in contradicts
    assert "° (doubtful beyond 4°, stale beyond 7°): the hard iron" in contradicts
    assert "check that the calibration was made for this robot" in contradicts


@pytest.mark.nightly
@pytest.mark.parametrize(("iron", "word"), [(0.0, "holds"), (5e-6, "stale")])
def test_the_report_has_the_same_content(check, tmp_path, iron, word):
    robot = dataclasses.replace(ROBOT, hard_iron=ROBOT.hard_iron + np.array([iron, 0.0, 0.0]))
    recording = write_csv(tmp_path / "csv", drive(400.0, robot, seed=3))
    _, out, _ = check(recording, "--output", str(tmp_path / "found"))
    report = tmp_path / "found" / "report.html"
    assert f"Report: {report}" in out
    page = report.read_text()
    assert "Compass check" in page
    assert f"The calibration {'is stale' if word == 'stale' else 'holds'}" in page
    assert "the turn covers " in page


@pytest.mark.nightly
def test_json_has_both_sides_of_every_figure(check, tmp_path):
    status, out, _ = check(write_csv(tmp_path / "csv", drive(400.0, moved(), seed=3)), "--json")
    document = json.loads(out)
    assert (status, document["state"]) == (4, "stale")
    swing = next(f for f in document["findings"] if f["figure"] == "heading_swing")
    assert swing["after"] == pytest.approx(8.1, abs=1.0)
    assert swing["before"] > 20.0
    assert "gyro_compass_rms" in {finding["figure"] for finding in document["findings"]}


@pytest.mark.parametrize("arguments", [[], ["--json"]])
def test_too_little_of_a_turn_is_3(check, tmp_path, arguments):
    status, out, _ = check(write_csv(tmp_path / "csv", drive(20.0)), *arguments)
    assert status == 3
    assert "the turn is too short" in out


def test_another_sensor_is_reported(check, tmp_path):
    evil = "rear\x1b[31m"
    path = write_bag(tmp_path / "bag", drive(400.0, seed=2), frames=("imu_link", evil))
    _, out, _ = check(path)
    assert "made for the magnetometer mag_link, but this is rear?[31m" in out
    assert "\x1b" not in out


def test_a_file_error_is_5_and_a_usage_error_2(check, tmp_path):
    path = write_csv(tmp_path / "csv", drive(20.0))
    assert check(tmp_path / "nothing")[0] == 5
    assert check(path, file=tmp_path / "nothing.yaml")[0] == 5
    assert check(path, file=path / "imu.csv")[0] == 5
    assert check(path, "--from", "x")[0] == 2
    with pytest.raises(SystemExit) as left:
        main(["check", str(path)])
    assert left.value.code == 2


def test_a_drive_with_the_calibration_of_another_sensor_is_reported(
    calibration_file, tmp_path, capsys
):
    """`check` said so, and `drive` replayed without a word."""
    path = write_bag(tmp_path / "bag", drive(400.0, seed=2), frames=("imu_link", "rear"))
    options = ["--calibration", str(calibration_file), "--output", str(tmp_path / "out")]
    assert main(["drive", str(path), *options]) == 0
    out = capsys.readouterr().out
    assert "made for the magnetometer mag_link, but this is rear" in out
