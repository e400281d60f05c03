"""Nothing is wrong with the axes of the good recordings, and the bad stamps are named."""

import numpy as np
import pytest
from long_form import first_of

from magcal_ros.core.assessment.axes import find_axes
from magcal_ros.core.assessment.grading import Grade
from magcal_ros.core.assessment.health import field_findings, imu_findings, stamps_finding
from magcal_ros.core.knowledge import Mounting
from magcal_ros.core.session.recorded import Gathering
from magcal_ros.files.sources import open_recording

GOOD = (
    "broad05",
    "car_circles_neu2025_kiran",
    "car_drive_neu2022_rahul",
    "car_neu2022_rahul",
    "car_neu2023_huang",
    "car_neu2024_gautham",
    "car_neu2024_jackg",
    "car_neu2024_rohx",
    "car_neu2024_yash",
)
BURSTS = "car_neu2023_aswin_asrec"


def findings(folder):
    imu = np.genfromtxt(folder / "imu.csv", delimiter=",", skip_header=1)
    mag = np.genfromtxt(folder / "mag.csv", delimiter=",", skip_header=1)
    found = [stamps_finding("IMU", imu[:, 0]), stamps_finding("field", mag[:, 0])]
    return [*found, *field_findings(mag[:, 1:4]), *imu_findings(imu[:, 1:4], imu[:, 4:7])]


@pytest.mark.parametrize("name", first_of([*GOOD, BURSTS], 3))
def test_the_axes_of_recordings_are_not_called_wrong(recording, name):
    gathering = Gathering(Mounting())
    with open_recording(recording(name)) as source:
        gathering.take(source.readings())
    assert find_axes(gathering.window()).words == ""


@pytest.mark.parametrize("name", GOOD)
def test_nothing_is_wrong_with_good_streams(recording, name):
    assert [f for f in findings(recording(name)) if f.grade is not Grade.EXCELLENT] == []


def test_stamps_in_bursts_are_named(recording):
    wrong = [f for f in findings(recording(BURSTS)) if f.grade is not Grade.EXCELLENT]
    assert [f.name for f in wrong] == ["IMU: stamps", "field: stamps"]
    assert all("bursts" in f.remedy for f in wrong)
