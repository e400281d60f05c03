"""Place and date of a recording: by option, by its stamps, by the fixes in a bag."""

import dataclasses
import json
import math

import numpy as np
import pytest
from drives import ROBOT, STORE2, drive, write_bag, write_csv
from long_form import first_of

from magcal_ros.cli.main import main
from magcal_ros.core.earth_field import model_field
from magcal_ros.core.earth_field.wmm import Place

pytestmark = pytest.mark.usefixtures("right_axes")

PLACE = ["--latitude", "48.14", "--longitude", "11.58", "--altitude", "520"]
HOME = Place(48.14, 11.58, 520.0)
IN_2021 = 1_625_000_000.0
QUICKLY = ["--method", "design_tip"]
"""How the samples are fitted is no matter here, and this is the shortest fit."""


def robot_at(place, year):
    field = model_field(place, year)
    return dataclasses.replace(
        ROBOT, strength=field.strength.value, inclination=field.inclination.value
    )


def fix(latitude, longitude, status=0):
    kinds = STORE2.types
    header = kinds["std_msgs/msg/Header"](kinds["builtin_interfaces/msg/Time"](5, 0), "gps")
    state = kinds["sensor_msgs/msg/NavSatStatus"](status, 1)
    fix_type = kinds["sensor_msgs/msg/NavSatFix"]
    return "/gps/fix", fix_type(header, state, latitude, longitude, 520.0, np.zeros(9), 0)


@pytest.fixture(scope="module")
def drive_of_2021():
    return drive(400.0, robot_at(HOME, 2021.5), start=IN_2021)


@pytest.fixture
def fit(tmp_path, capsys):
    """Run `magcal fit --json`; returns exit status, document and stderr."""

    def run(recording, *arguments):
        options = ["--output", str(tmp_path / "found"), "--json", *QUICKLY]
        try:
            status = main(["fit", str(recording), *options, *arguments])
        except SystemExit as left:
            status = left.code
        out, err = capsys.readouterr()
        return status, json.loads(out) if out else None, err

    return run


def test_the_date_of_a_recording_is_its_stamps(fit, drive_of_2021, tmp_path):
    status, document, err = fit(write_csv(tmp_path / "csv", drive_of_2021), *PLACE)
    assert status == 0, err
    reference = document["reference"]
    assert reference["source"] == "World Magnetic Model 2020 at 48.14°N 11.58°E, 2021.5"
    assert not reference["complaints"]
    assert not [w for w in document["not_shown"] if "reference field is not known" in w]
    assert document["numbers"]["strength_ut"] == pytest.approx(reference["strength_ut"], abs=0.5)


@pytest.mark.parametrize("date", first_of(["2026-11-21", "2026.89"]))
def test_the_date_may_be_given(fit, drive_of_2021, tmp_path, date):
    recording = write_csv(tmp_path / "csv", drive_of_2021)
    _, document, _ = fit(recording, *PLACE, "--date", date)
    assert document["reference"]["source"].startswith("World Magnetic Model 2025 at")
    assert document["reference"]["source"].endswith("2026.9")


def test_given_numbers_have_priority(fit, drive_of_2021, tmp_path):
    recording = write_csv(tmp_path / "csv", drive_of_2021)
    _, document, _ = fit(recording, *PLACE, "--reference-declination-deg", "3.5")
    reference = document["reference"]
    assert reference["declination_deg"] == 3.5
    assert reference["source"].startswith("declination given, the rest from")


@pytest.mark.nightly
def test_the_first_good_fix_of_a_bag_is_its_place_unless_one_is_given(fit, drive_of_2021, tmp_path):
    fixes = [fix(10.0, 10.0, status=-1), fix(math.nan, 0.0), fix(48.14, 11.58), fix(0.5, 0.5)]
    bag = write_bag(tmp_path / "bag", [drive_of_2021[0], *fixes, *drive_of_2021[1:]])
    status, document, err = fit(bag)
    assert status == 0, err
    assert "48.14°N 11.58°E" in document["reference"]["source"]
    place = ["--latitude", "47", "--longitude", "12"]
    _, document, _ = fit(bag, *place, "--output", str(tmp_path / "other"))
    assert "47.00°N 12.00°E" in document["reference"]["source"]


def test_the_reference_is_printed_and_check_reports_another_one(drive_of_2021, tmp_path, capsys):
    recording = write_csv(tmp_path / "csv", drive_of_2021)
    found = str(tmp_path / "found")
    assert main(["fit", str(recording), "--output", found, *PLACE, *QUICKLY]) == 0
    words = "(World Magnetic Model 2020 at 48.14°N 11.58°E, 2021.5)."
    (line,) = [line for line in capsys.readouterr().out.splitlines() if words in line]
    assert line.startswith("Reference field: strength 48.")
    calibration = ["--calibration", str(tmp_path / "found" / "calibration.yaml")]
    for place, is_said in ((PLACE, False), (["--latitude=-34", "--longitude=151"], True)):
        output = ["--output", str(tmp_path / f"check_{is_said}"), "--json"]
        assert main(["check", str(recording), *calibration, *output, *place]) == 0
        document = json.loads(capsys.readouterr().out)
        assert document["reference"]["source"].startswith("World Magnetic Model 2020")
        assert ("if it was made elsewhere" in " ".join(document["about"])) is is_said


@pytest.mark.parametrize(
    "arguments",
    [
        ["--latitude", "48"],
        ["--longitude", "11"],
        ["--latitude", "91", "--longitude", "0"],
        ["--date", "yesterday"],
        ["--date", "12"],
    ],
)
def test_half_a_place_or_no_date_is_a_usage_error(fit, drive_of_2021, tmp_path, arguments):
    status, document, err = fit(write_csv(tmp_path / "csv", drive_of_2021), *arguments)
    assert (status, document) == (2, None)
    assert err
