"""Exports of phones are recognised by their columns."""

import numpy as np
import pytest
from drives import drive
from log_writers import write_phyphox, write_sensor_logger

from magcal_ros.core.errors import UsageError
from magcal_ros.core.geometry import rotation_from_rpy
from magcal_ros.core.samples import FieldSample, ImuSample, VelocitySample
from magcal_ros.files import FileError, open_recording

SAMPLES = drive(60.0)
IMU = np.array([[*s.force, *s.rate] for s in SAMPLES if isinstance(s, ImuSample)])
FIELD = np.array([s.field for s in SAMPLES if isinstance(s, FieldSample)])


def numbers(path, **options):
    with open_recording(path, **options) as source:
        readings = list(source.readings())
    imu = np.array([[*s.force, *s.rate] for s in readings if isinstance(s, ImuSample)])
    return source, imu, np.array([s.field for s in readings if isinstance(s, FieldSample)])


WRITERS = {
    "android": lambda path: write_sensor_logger(path, SAMPLES),
    "ios": lambda path: write_sensor_logger(path, SAMPLES, ios=True),
    "phyphox": lambda path: write_phyphox(path, SAMPLES),
    "phyphox, decimal comma": lambda path: write_phyphox(path, SAMPLES, ";", ","),
    "phyphox, tabs": lambda path: write_phyphox(path, SAMPLES, "\t"),
}


@pytest.mark.parametrize("kind", WRITERS)
def test_the_folder_of_a_phone_gives_its_measurements(tmp_path, kind):
    _, imu, field = numbers(WRITERS[kind](tmp_path / "phone"))
    assert imu == pytest.approx(IMU, abs=1e-6)
    assert field == pytest.approx(FIELD, abs=1e-9)


def test_a_mounting_turns_all_sensors(tmp_path):
    pose = rotation_from_rpy(0.0, -0.5, 0.3)
    path = WRITERS["android"](tmp_path / "phone")
    _, imu, field = numbers(path, imu_pose=pose)
    assert imu[:, :3] == pytest.approx(IMU[:, :3] @ pose.T, abs=1e-6)
    assert imu[:, 3:] == pytest.approx(IMU[:, 3:] @ pose.T, abs=1e-6)
    assert field == pytest.approx(FIELD @ pose.T, abs=1e-9)


def test_location_gives_place_and_course(tmp_path):
    path = WRITERS["android"](tmp_path / "phone")
    (path / "Location.csv").write_text(
        "time,seconds_elapsed,speed,bearing,altitude,longitude,latitude\n"
        "1001000000000,1,2.0,90,500,11.5,48.1\n1002000000000,2,-1,-1,500,11.5,48.1\n"
    )
    source, _, _ = numbers(path)
    assert source.place.longitude_deg == 11.5
    moving = [each for each in source.travel if isinstance(each, VelocitySample)]
    assert [(m.stamp, m.east) for m in moving] == [(1001.0, pytest.approx(2.0))]


def test_acceleration_without_gravity_is_refused_with_the_sensor_to_record(tmp_path):
    path = WRITERS["ios"](tmp_path / "phone")
    still = (path / "Accelerometer.csv").read_text()
    (path / "Gravity.csv").unlink()
    (path / "TotalAcceleration.csv").write_text(still)
    with pytest.raises(FileError, match="without gravity"):
        numbers(path)


def test_other_files_in_the_folder_do_no_harm(tmp_path):
    path = WRITERS["android"](tmp_path / "phone")
    (path / "notes.csv").write_bytes(b"\xff\xfe caf\xe9\n")
    (path / "empty.csv").write_bytes(b"")
    (path / "folder.csv").mkdir()
    assert len(numbers(path)[2]) == len(FIELD)


def test_a_missing_sensor_is_named(tmp_path):
    path = WRITERS["phyphox"](tmp_path / "phone")
    (path / "Magnetometer.csv").unlink()
    with pytest.raises(FileError, match="has no field"):
        numbers(path)


@pytest.mark.parametrize("kind", ["android", "phyphox"])
def test_a_phone_without_a_gyroscope_is_read_without_rates(tmp_path, kind):
    path = WRITERS[kind](tmp_path / "phone")
    (path / "Gyroscope.csv").unlink()
    source, imu, field = numbers(path)
    assert imu[:, :3] == pytest.approx(IMU[:, :3], abs=1e-6)
    assert np.isnan(imu[:, 3:]).all()
    assert len(field) == len(FIELD)
    assert any("no gyroscope" in note for note in source.notes)


def test_topics_are_refused_for_a_phone(tmp_path):
    with pytest.raises(UsageError, match="without topics"):
        numbers(WRITERS["phyphox"](tmp_path / "phone"), imu="/imu")
