"""`magcal check` uses course where a bag has fixes."""

import json

import numpy as np
import pytest
from drives import DRIVE_VEHICLE, recorded, write_bag
from long_form import first_of
from simulated.drive import simulated_drive
from simulated.legs import city
from simulated.travel import travel

from magcal_ros.cli.main import main
from magcal_ros.core import Calibration
from magcal_ros.core.calibration import Evidence
from magcal_ros.files import Origin, write_calibration


@pytest.mark.parametrize("seconds", first_of([100.0, 180.0]))
def test_the_offset_is_reported_and_a_wrong_calibration_named(seconds, tmp_path, capsys):
    """A hundred seconds show the declination, three minutes also the error of the calibration."""
    rng = np.random.default_rng(4)
    truth = travel(city(rng, seconds), rng, rate=10.0)
    drive = simulated_drive(truth, rng, DRIVE_VEHICLE, streets=None)
    bag = write_bag(tmp_path / "bag", [each for each in map(recorded, drive.samples()) if each])
    robot = DRIVE_VEHICLE.with_iron(np.array([8e-6, 0.0, 0.0])).robot
    calibration = Calibration(
        robot.true_correction,
        np.eye(12) * 1e-14,
        5e-7,
        0.01,
        robot.strength,
        robot.inclination,
        Evidence("maximum_likelihood", "good", "good", ""),
    )
    path = tmp_path / "calibration.yaml"
    write_calibration(path, calibration, Origin.now("mag_link", "imu_link"))
    main(["check", str(bag), "--calibration", str(path), "--json", "--output", str(tmp_path / "o")])
    reported = json.loads(capsys.readouterr().out)
    course = reported["course"]
    assert course["declination_deg"] is not None
    printed = [words for words in reported["about"] if words.startswith("compass minus course")]
    assert f"{course['declination_deg']:+.1f}° of it is declination" in printed[0]
    assert course["metres"] > 300
    if seconds == 100.0:
        return
    assert reported["state"] == "stale"
    main(["drive", str(bag), "--calibration", str(path), "--output", str(tmp_path / "d")])
    printed = [line for line in capsys.readouterr().out.splitlines() if "minus course" in line]
    assert "declination" in printed[0]
    assert 'id="course">After: compass minus course' in (tmp_path / "d" / "report.html").read_text()
