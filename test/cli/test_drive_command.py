"""`magcal drive`: the replay of a recorded drive."""

import json
import math

import numpy as np
import pytest
from drives import drive, write_bag, write_csv
from simulated.drive import Vehicle, simulated_drive
from simulated.legs import Leg, city
from simulated.travel import travel

from magcal_ros.cli.main import main
from magcal_ros.core import Mounting
from magcal_ros.core.calibration import known_sigma, predicted_heading_sigma
from magcal_ros.core.session import SampleCollector
from magcal_ros.core.simulation import Robot
from magcal_ros.files import open_recording, read_calibration

pytestmark = pytest.mark.usefixtures("right_axes")

ROBOT = Robot(strength=48e-6, inclination=math.radians(65.0), noise_force=0.05, noise_rate=2e-3)
REFERENCE = ["--reference-strength-ut", "48", "--reference-inclination-deg", "65"]


def sensors(legs, seed=1):
    rng = np.random.default_rng(seed)
    drive = simulated_drive(travel(legs, rng, rate=10.0), rng, Vehicle(ROBOT))
    return drive, list(drive._sensors())


@pytest.fixture(scope="module")
def driven(tmp_path_factory):
    """A drive of some minutes as a CSV folder."""
    _, samples = sensors(city(np.random.default_rng(1), 150.0))
    return write_csv(tmp_path_factory.mktemp("driven") / "csv", samples)


def test_a_drive_without_a_calibration_ends_with_one_and_a_page(driven, tmp_path, capsys):
    status = main(["drive", str(driven), *REFERENCE, "--output", str(tmp_path), "--json"])
    reported = json.loads(capsys.readouterr().out)
    assert status == 0
    assert reported["decisions"][-1]["decision"] in ("applied", "refined")
    found, _ = read_calibration(tmp_path / "calibration.yaml")
    # A decision names the first, which is graded; `magcal fit` names both.
    on_the_way, own = predicted_heading_sigma(found), known_sigma(found)
    assert own < 0.7 * on_the_way
    shown = (
        f"heading ±{math.degrees(own):.1f}° by the calibration (1σ); along the drive, with local"
        f" magnetic disturbances, ±{math.degrees(on_the_way):.1f}°"
    )
    assert shown in reported["summary"]
    assert f"±{math.degrees(own):.1f}°" in reported["decisions"][-1]["why"]
    apart = 1e6 * (found.correction.hard_iron - ROBOT.hard_iron)
    assert np.abs(apart[:2]).max() < 3.0
    page = (tmp_path / "report.html").read_text()
    assert page.count("<circle") > 200
    assert "put in force" in page
    assert "http://" not in page
    assert "https://" not in page


def test_a_speed_in_the_recording_is_used(tmp_path):
    drive, _ = sensors(city(np.random.default_rng(2), 110.0), seed=2)
    folder = write_csv(tmp_path / "csv", list(drive.samples()))
    assert {each.name for each in folder.iterdir()} >= {"odom.csv", "gps.csv"}
    with open_recording(folder) as source:
        recording = SampleCollector(Mounting())
        recording.take(source.readings(), source.travel)
    driven = 0.1 * np.nansum(np.abs(recording.drive().speed))
    assert driven == pytest.approx(drive.truth.metres[-1], rel=0.1)


def test_a_robot_at_rest_gives_no_decision(tmp_path, capsys):
    _, samples = sensors([Leg(40.0)])
    folder = write_csv(tmp_path / "csv", samples)
    status = main(["drive", str(folder), *REFERENCE, "--output", str(tmp_path / "out")])
    assert status == 3
    assert "waiting for movement" in capsys.readouterr().out
    assert not (tmp_path / "out" / "calibration.yaml").exists()
    assert "No map" in (tmp_path / "out" / "report.html").read_text()


def test_an_older_report_is_kept(tmp_path, capsys):
    _, samples = sensors([Leg(10.0)])
    folder = write_csv(tmp_path / "csv", samples)
    arguments = ["drive", str(folder), *REFERENCE, "--output", str(tmp_path / "out")]
    main(arguments)
    assert main(arguments) == 5
    assert "exists already" in capsys.readouterr().err


def test_fit_takes_a_whole_drive_without_a_turn(driven, tmp_path, capsys):
    status = main(
        ["fit", str(driven), *REFERENCE, "--output", str(tmp_path), "--method", "smoother"]
    )
    assert status == 0
    words = capsys.readouterr().out
    assert "of movement" in words
    found, _ = read_calibration(tmp_path / "calibration.yaml")
    assert np.abs(1e6 * (found.correction.hard_iron - ROBOT.hard_iron)[:2]).max() < 3.0
    assert found.evidence.method == "smoother"


def test_without_fixes_and_wheels_the_map_is_by_the_compass(driven, tmp_path, capsys):
    _, samples = sensors(city(np.random.default_rng(2), 30.0))
    bag = write_bag(tmp_path / "bag", samples)
    assert main(["drive", str(bag), *REFERENCE, "--output", str(tmp_path / "out")]) == 3
    assert "Written" in capsys.readouterr().out


def test_a_recording_without_a_gyro_is_refused_with_the_reason(tmp_path, capsys):
    _, samples = sensors([Leg(10.0)])
    folder = write_csv(tmp_path / "csv", samples)
    rows = (folder / "imu.csv").read_text().splitlines()
    (folder / "imu.csv").write_text("\n".join(row.rpartition(",")[0] for row in rows) + "\n")
    out = tmp_path / "out"
    assert main(["drive", str(folder), "--output", str(out)]) == 5
    assert "imu.csv has no column gz" in capsys.readouterr().err
    (folder / "imu.csv").write_text("\n".join(",".join(row.split(",")[:4]) for row in rows) + "\n")
    assert main(["drive", str(folder), "--output", str(out)]) == 3
    assert "the recording has no gyro" in capsys.readouterr().err
    assert not out.exists()


@pytest.mark.parametrize("span", [["--to", "0.005"], ["--from", "100"]])
def test_a_span_with_one_sample_or_none_is_not_said_to_have_no_gyro(tmp_path, capsys, span):
    _, samples = sensors([Leg(10.0)])
    folder = write_csv(tmp_path / "csv", samples)
    assert main(["drive", str(folder), *span, "--output", str(tmp_path / "out")]) == 3
    assert "is too short for a drive" in capsys.readouterr().err


def rewritten(folder, name, columns, scale, into):
    """Write a folder of tables again, some columns of one of them times a number."""
    into.mkdir()
    for file in folder.iterdir():
        (into / file.name).write_text(file.read_text())
    head, *rows = (into / name).read_text().splitlines()
    values = np.array([[float(value) for value in row.split(",")] for row in rows])
    values[:, columns] *= scale
    np.savetxt(into / name, values, delimiter=",", header=head, comments="", fmt="%.12g")
    return into


def test_a_drive_with_a_gyro_in_degrees_is_reported(tmp_path, capsys):
    """The message is not that there was too little data."""
    good = write_csv(tmp_path / "good", drive(400.0))
    folder = rewritten(good, "imu.csv", slice(4, 7), math.degrees(1.0), tmp_path / "csv")
    assert main(["drive", str(folder), *REFERENCE, "--output", str(tmp_path / "out")]) == 3
    printed = capsys.readouterr().out
    assert "the sensors may be the cause" in printed
    assert "degrees/s published as rad/s" in printed
    assert "was not sufficient" not in printed
    assert "degrees/s published as rad/s" in (tmp_path / "out" / "report.html").read_text()


def test_a_drive_with_a_field_in_microtesla_is_reported(driven, tmp_path, capsys):
    """The message is not that there is no gyro."""
    folder = rewritten(driven, "mag.csv", slice(1, 4), 1e6, tmp_path / "csv")
    assert main(["drive", str(folder), *REFERENCE, "--output", str(tmp_path / "out")]) == 3
    printed = capsys.readouterr().err
    assert "microtesla published as tesla" in printed
    assert "no gyro" not in printed
