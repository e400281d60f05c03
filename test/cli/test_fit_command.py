import json
import math
import os
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from drives import ROBOT, STORE2, drive, message, write_bag, write_csv
from simulated.turns import slope_rpy

from magcal_ros.cli.main import main
from magcal_ros.core.samples import FieldSample, ImuSample
from magcal_ros.core.simulation import Ride
from magcal_ros.files import read_calibration

pytestmark = pytest.mark.usefixtures("right_axes")

REFERENCE = ["--reference-strength-ut", "50", "--reference-inclination-deg", "60"]


@pytest.fixture(scope="module")
def bag(tmp_path_factory):
    return write_bag(tmp_path_factory.mktemp("turn") / "bag", drive(400.0))


@pytest.fixture
def fit(tmp_path, capsys):
    """Run `magcal fit`; returns exit status, stdout and stderr."""

    def run(recording, *arguments):
        output = [] if "--output" in arguments else ["--output", str(tmp_path / "found")]
        try:
            several = recording if isinstance(recording, list) else [recording]
            recordings = [str(each) for each in several]
            status = main(["fit", *recordings, *output, *REFERENCE, *arguments])
        except SystemExit as left:
            status = left.code
        return status, *capsys.readouterr()

    return run


def test_a_good_turn_gives_a_verdict_and_a_calibration_file(fit, bag, tmp_path):
    status, out, err = fit(bag)
    assert status == 0, out + err
    assert out.startswith("Calibrated, quality ")
    for words in ("hard iron x", "µT", "Not shown by this recording:", "Written:\n"):
        assert words in out
    calibration, origin = read_calibration(tmp_path / "found" / "calibration.yaml")
    assert (origin.magnetometer_frame, origin.imu_frame) == ("mag_link", "imu_link")
    np.testing.assert_allclose(calibration.correction.hard_iron[:2], [30e-6, -20e-6], atol=1e-6)
    assert str(tmp_path / "found" / "calibration.yaml") in out
    assert err == ""


def test_both_strengths_of_a_weakened_field_are_named(fit, tmp_path):
    """Two thirds of the level field: raw, without hard iron and corrected strengths differ."""
    samples = [
        each._replace(field=tuple(np.array([0.67, 0.67, 1.0]) * each.field))
        if isinstance(each, FieldSample)
        else each
        for each in drive(400.0)
    ]
    _, out, _ = fit(write_csv(tmp_path / "csv", samples), "--json")
    found = json.loads(out)["numbers"]
    assert found["strength_ut"] == pytest.approx(50.0, rel=0.05)
    assert found["sensor_strength_ut"] == pytest.approx(46.4, rel=0.05)
    assert abs(found["raw_strength_ut"] - found["sensor_strength_ut"]) > 2.0
    assert found["level_share_percent"] == pytest.approx(67.0, rel=0.05)


@pytest.mark.parametrize(
    "kind", ["ros1", *(pytest.param(k, marks=pytest.mark.nightly) for k in ("sqlite3", "csv"))]
)
def test_every_kind_of_recording_gives_the_same(fit, bag, tmp_path, kind):
    samples = drive(400.0)
    path = tmp_path / kind
    path = write_csv(path, samples) if kind == "csv" else write_bag(path, samples, kind)
    assert fit(bag, "--output", str(tmp_path / "one"))[0] == 0
    assert fit(path, "--output", str(tmp_path / "other"))[0] == 0
    one, other = (read_calibration(tmp_path / n / "calibration.yaml")[0] for n in ("one", "other"))
    difference = one.correction.parameters - other.correction.parameters
    assert np.abs(difference).max() < 1e-6


def test_without_output_a_dated_folder_is_made_and_none_is_reused(bag, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(["fit", str(bag), *REFERENCE]) == 0
    assert main(["fit", str(bag), *REFERENCE]) == 0
    assert len(list(tmp_path.glob("magcal_fit_2*/calibration.yaml"))) == 2


def test_nothing_is_overwritten(fit, bag, tmp_path):
    (tmp_path / "found").mkdir()
    (tmp_path / "found" / "calibration.yaml").write_text("mine")
    status, out, err = fit(bag)
    assert (status, out) == (5, "")
    assert "exists already" in err
    assert (tmp_path / "found" / "calibration.yaml").read_text() == "mine"


def test_the_result_is_printed_although_the_report_cannot_be_written(fit, bag, tmp_path):
    """The calibration was on disk, and its verdict was never seen."""
    (tmp_path / "found" / "report.html").mkdir(parents=True)
    status, out, err = fit(bag)
    assert status == 5
    assert "Calibrated" in out
    assert "calibration.yaml" in out
    assert "report.html exists already" in err


def test_json_is_one_document_with_every_number(fit, bag, tmp_path):
    status, out, _ = fit(bag, "--json")
    document = json.loads(out)
    assert status == document["exit"] == 0
    assert document["accepted"] is True
    assert document["numbers"]["hard_iron_x_ut"] == pytest.approx(30.0, abs=1.0)
    assert 0.0 < document["numbers"]["hard_iron_x_sigma_ut"] < 1.0
    assert document["numbers"]["installation_roll_deg"] == pytest.approx(3.0, abs=0.5)
    folder = tmp_path / "found"
    assert document["files"] == [str(folder / "calibration.yaml"), str(folder / "report.html")]
    assert {check["aspect"] for check in document["checks"]} == {"quality", "confidence"}


def test_compare_shows_every_method_and_writes_nothing(fit, bag, tmp_path):
    status, out, _ = fit(bag, "--compare")
    assert status == 0
    rows = {line.split()[0]: line.split()[1] for line in out.splitlines()[1:6]}
    assert rows["maximum_likelihood"] == rows["design_tip"] == "accepted"
    assert rows["ellipsoid"] == rows["min_max"] == "refused"
    assert not (tmp_path / "found").exists()


@pytest.mark.nightly
def test_a_path_that_is_not_unicode_is_read_and_reported(fit, tmp_path):
    folder = Path(os.fsdecode(os.fsencode(tmp_path) + b"/drive\xff\x1b[2J"))
    status, out, err = fit(write_csv(folder, drive(400.0)))
    assert status == 0, out + err
    page = (tmp_path / "found" / "report.html").read_text()
    assert "drive??[2J (mag.csv and imu.csv)" in page


class TestExits:
    @pytest.mark.parametrize(("turned", "status"), [(0.0, 3), (25.0, 3)])
    def test_too_little_data_is_3(self, fit, tmp_path, turned, status):
        found, out, _ = fit(write_csv(tmp_path / "csv", drive(turned)))
        assert found == status
        assert out.startswith("Refused: the turn is too short")
        assert "No calibration was written." in out
        assert not (tmp_path / "found").exists()

    def test_a_span_outside_the_recording_is_3(self, fit, bag):
        status, out, _ = fit(bag, "--from", "5000")
        assert status == 3
        assert "no message of /imu/data_raw and /imu/mag could be used" in out

    def test_a_refusal_is_4_and_leaves_a_report_but_no_calibration(self, fit, bag, tmp_path):
        """The reference contradicts the turn."""
        weak = ["--reference-strength-ut", "30", "--reference-inclination-deg", "65"]
        status, out, _ = fit(bag, *weak)
        assert status == 4
        assert out.startswith("Refused")
        left = sorted(path.name for path in (tmp_path / "found").iterdir())
        assert left == ["report.html", "samples.csv"]

    @pytest.mark.parametrize(
        "arguments",
        [
            ["--method", "dance"],
            ["--reference-strength-ut", "48000"],
            ["--reference-strength-ut", "nan"],
            ["--soft-iron-gains", "1", "1"],
            ["--from", "-1"],
            ["--from", "9", "--to", "3"],
            ["--compare", "--json"],
        ],
    )
    def test_wrong_options_are_2(self, fit, bag, arguments):
        status, out, err = fit(bag, *arguments)
        assert (status, out) == (2, "")
        assert "Traceback" not in err

    def test_several_topics_are_listed_with_2(self, fit, tmp_path):
        samples = drive(400.0)
        second = [("/b\x1b[2J", message(STORE2, s)) for s in samples if isinstance(s, ImuSample)]
        path = write_bag(tmp_path / "two", [*samples, *second[:3]])
        status, out, err = fit(path)
        assert (status, out) == (2, "")
        assert "/b?[2J, /imu/data_raw; choose one with --imu" in err
        assert "\x1b" not in err
        assert fit(path, "--imu", "/imu/data_raw")[0] == 0

    def test_a_file_error_is_5(self, fit, tmp_path):
        status, out, err = fit(tmp_path / "nothing")
        assert (status, out) == (5, "")
        assert err.count("\n") == 1

    def test_a_folder_that_cannot_be_made_is_5(self, fit, bag, tmp_path):
        (tmp_path / "file").write_text("")
        assert fit(bag, "--output", str(tmp_path / "file" / "sub"))[0] == 5
        assert fit(bag, "--output", str(tmp_path / "file"))[0] == 5


def test_options_give_the_prior_knowledge(fit, tmp_path):
    gains = ["--soft-iron-gains", "1", "1", "1", "--mount-rpy-deg", "3", "-4", "0"]
    status, out, _ = fit(write_csv(tmp_path / "csv", drive(400.0)), *gains, "--json")
    assert status == 0
    numbers = json.loads(out)["numbers"]
    # The nominal pose is the true one: nothing of it is left for the installation error.
    assert abs(numbers["installation_roll_deg"]) < 0.5
    assert abs(numbers["installation_pitch_deg"]) < 0.5
    assert ROBOT.roll == pytest.approx(np.radians(3.0))


class TestRecordings:
    @pytest.mark.nightly
    def test_the_car_from_its_bag(self, fit, recording):
        folder = recording("car_circles_neu2025_kiran")
        place = ["--reference-strength-ut", "51.3", "--reference-inclination-deg", "66.3"]
        status, out, _ = fit(folder / "bag_mcap", *place, "--json")
        assert status == 0
        assert json.loads(out)["numbers"]["hard_iron_x_ut"] == pytest.approx(21.0, abs=3.0)

    @pytest.mark.nightly
    def test_stamps_in_bursts_are_repaired_and_named(self, fit, recording):
        folder = recording("car_neu2023_aswin_asrec")
        place = ["--reference-strength-ut", "51.3", "--reference-inclination-deg", "66.3"]
        status, out, _ = fit(folder, *place, "--json")
        document = json.loads(out)
        assert status == 0
        assert document["numbers"]["hard_iron_y_ut"] == pytest.approx(-50.0, abs=5.0)
        assert "imu.csv and mag.csv: the stamps come in bursts, 0.90 s" in str(document)
        assert "spread evenly" in str(document)

    @pytest.mark.nightly
    def test_a_span_of_a_hand_held_recording_is_fitted(self, fit, recording):
        status, out, _ = fit(recording("broad05"), "--from", "48", "--to", "62", "--json")
        document = json.loads(out)
        assert status == document["exit"]
        assert status in (0, 4)
        assert document["numbers"]["arc_deg"] > 340.0
        assert document["numbers"]["imu_messages"] == pytest.approx(1333, abs=2)


@pytest.fixture(scope="module")
def turns(tmp_path_factory):
    """Recordings of turns on the level, on a slope to the east, and a short one."""
    folder, robot = tmp_path_factory.mktemp("turns"), replace(ROBOT, yaw=math.radians(5.0))
    for seed, (name, tilt, azimuth) in enumerate((("a", 0, 0), ("b", 10, 0))):
        ride = Ride(robot, np.random.default_rng(seed), start=1e3, imu_rate=25.0)
        ride.stand(*slope_rpy(math.radians(tilt), math.radians(azimuth), 0.3))
        samples = [sample for _ in range(340) for sample in ride.step(0.5)]
        write_csv(folder / name, samples)
    write_csv(folder / "short", drive(25.0))
    return folder


class TestSeveralTurns:
    """Each drive is a turn on a tilt of its own."""

    def test_several_turns_are_joined_and_each_is_reported(self, fit, turns):
        status, out, _ = fit([turns / name for name in ("a", "b", "short", "a")])
        assert status == 0
        assert re.search(r", yaw 4\.\d+° ±0\.\d+°|, yaw 5\.\d+° ±0\.\d+°", out)
        assert "installation yaw from ±5° to ±0." in out
        assert "short: left out: the turn is too short" in out
        assert "a (2): left out: it holds the same samples as " in out
        assert "Not shown by these recordings:" not in out or "yaw of the installation" not in out

    def test_json_has_the_numbers_and_the_advice(self, fit, turns):
        status, out, _ = fit([turns / name for name in ("a", "b", "short", "a")], "--json")
        document = json.loads(out)
        assert status == document["exit"] == 0
        assert document["numbers"]["installation_yaw_deg"] == pytest.approx(5.0, abs=1.5)
        assert document["numbers"]["installation_yaw_sigma_deg"] < 1.0
        joined = [turn["joined"] for turn in document["several"]["turns"]]
        assert joined == [True, True, False, False]
        assert document["several"]["advice"].startswith("Next turn ")

    @pytest.mark.nightly
    def test_one_recording_gives_no_report_on_several(self, fit, turns):
        assert json.loads(fit(turns / "a", "--json")[1])["several"] is None

    @pytest.mark.parametrize(
        ("arguments", "words"),
        [
            (["--from", "2"], "--from and --to take one recording"),
            (["--compare"], "--compare takes one recording"),
            (["--method", "design_tip"], "takes one turn; maximum_likelihood joins several"),
        ],
    )
    def test_options_for_one_recording_are_refused_for_several(self, fit, turns, arguments, words):
        status, out, err = fit([turns / "a", turns / "b"], *arguments)
        assert (status, out) == (2, "")
        assert words in err

    def test_two_sensors_are_not_joined(self, fit, tmp_path):
        one = write_bag(tmp_path / "one", drive(400.0))
        other = write_bag(tmp_path / "other", drive(400.0, seed=2), frames=("imu_link", "mag_2"))
        status, _, err = fit([one, other])
        assert status == 2
        assert "different magnetometers (mag_2, mag_link)" in err

    def test_nothing_but_short_recordings_is_too_little_data(self, fit, turns):
        status, out, _ = fit([turns / "short", turns / "short"])
        assert status == 3
        assert "the turn is too short" in out


def test_omitted_repetitions_are_reported(fit, tmp_path):
    samples = drive(400.0)
    fields = [k for k, sample in enumerate(samples) if not isinstance(sample, ImuSample)]
    repeated = list(zip(fields[::3], fields[1::3], strict=False))
    for k, after in repeated:
        samples[after] = samples[after]._replace(field=samples[k].field)
    _, out, _ = fit(write_csv(tmp_path / "csv", samples), "--method", "design_tip")
    printed = f"{len(repeated)} of {len(fields)} samples repeat the previous one and are left out"
    assert f"mag.csv: {printed}" in out


@pytest.mark.nightly
def test_a_turn_without_a_gyro_is_reported_with_the_missing_knowledge(tmp_path, capsys):
    folder = write_csv(tmp_path / "csv", drive(400.0))
    rows = (folder / "imu.csv").read_text().splitlines()
    (folder / "imu.csv").write_text("\n".join(",".join(row.split(",")[:4]) for row in rows) + "\n")
    assert main(["fit", str(folder), "--output", str(tmp_path / "found"), "--json"]) == 0
    reported = json.loads(capsys.readouterr().out)
    figures = {check["figure"] for check in reported["checks"]}
    assert not figures & {"latency", "motor_field"}, "nothing measured them"
    assert main(["fit", str(folder), "--output", str(tmp_path / "more")]) == 0
    out = capsys.readouterr().out
    assert "Reference field: unknown: give --latitude and --longitude" in out
    assert "there is no gyro" in out
