"""The reader of ROS gives the same as the library."""

import math
import sys

import numpy as np
import pytest
from by_message import fix_of
from drives import STORE2, drive, header, message, write_bag
from ros_bags import rosbag2_py

from magcal_ros.core.earth_field.reference import Place
from magcal_ros.core.errors import UsageError
from magcal_ros.core.samples import ImuSample
from magcal_ros.files import CDR, FileError, open_recording

FIX = "sensor_msgs/msg/NavSatFix"
IMU = "sensor_msgs/msg/Imu"
BATTERY = "sensor_msgs/msg/BatteryState"


@pytest.fixture(scope="module")
def samples():
    return drive(60.0)


@pytest.fixture(params=[False, True], ids=["since Jazzy", "before Jazzy"])
def with_ros(request, monkeypatch):
    """Make ROS available and not the library."""

    def switch():
        monkeypatch.setitem(sys.modules, "rosbag2_py", rosbag2_py(request.param))
        monkeypatch.setitem(sys.modules, "rosbags.highlevel", None)

    return switch


def read(path, **options):
    with open_recording(path, **options) as source:
        return list(source.readings()), source


@pytest.mark.parametrize("kind", ["mcap", "sqlite3"])
@pytest.mark.parametrize("span", [{}, {"start": 0.5, "stop": 1.25}])
def test_the_reader_gives_the_same_as_the_library(tmp_path, samples, kind, span, with_ros):
    path = write_bag(tmp_path / "bag", samples, kind)
    expected, by_library = read(path, **span)
    with_ros()
    found, source = read(path, **span)
    assert found == expected
    assert (source.imu_topic, source.field_topic) == (by_library.imu_topic, by_library.field_topic)
    assert (source.imu_frame, source.field_frame) == ("imu_link", "mag_link")
    assert source.count == pytest.approx(len(found), rel=0.05)


def test_a_single_file_is_read(tmp_path, samples, with_ros):
    folder = write_bag(tmp_path / "bag", samples)
    with_ros()
    assert len(read(next(folder.glob("*.mcap")))[0]) == len(samples)


def test_a_place_is_found(tmp_path, samples, with_ros):
    path = write_bag(tmp_path / "bag", [*samples, ("/fix", fix("gps"))])
    with_ros()
    with open_recording(path) as source:
        assert source.place == Place(48.1, 11.6, 520.0)


def fix(frame):
    kinds = STORE2.types
    head = message(STORE2, drive(5.0)[0], frame).header
    status = kinds["sensor_msgs/msg/NavSatStatus"](2, 1)
    covariance = message(STORE2, drive(5.0)[0]).orientation_covariance
    return kinds[FIX](head, status, 48.1, 11.6, 520.0, covariance, 0)


@pytest.mark.parametrize("length", range(12))
def test_a_fix_is_read_whatever_the_length_of_its_frame(length):
    whole = fix("x" * length)
    found = CDR.fix(bytes(STORE2.serialize_cdr(whole, FIX)))
    assert found == fix_of(whole)
    assert (found.has_fix, found.latitude_deg, found.altitude) == (True, 48.1, 520.0)


def test_headings_and_currents_are_read_from_their_bytes(tmp_path, samples, with_ros):
    newest = next(each for each in reversed(samples) if isinstance(each, ImuSample))
    turned = newest._replace(orientation=(0.0, 0.0, math.sin(0.3), math.cos(0.3)))
    battery = STORE2.types["sensor_msgs/msg/BatteryState"](
        fix("b").header, 12.0, 20.0, -3.5, *[0.0] * 4, 0, 0, 0, True,
        np.zeros(0, np.float32), np.zeros(0, np.float32), "", "",
    )  # fmt: skip
    extra = [("/antennas", message(STORE2, turned)), ("/battery", battery)]
    path = write_bag(tmp_path / "bag", [*samples, *extra])
    with_ros()
    with open_recording(path, imu="/imu/data_raw") as source:
        (heading,) = source.headings("/antennas")
        assert heading.yaw == pytest.approx(0.6)
        assert source.currents == [(pytest.approx(drive(5.0)[0].stamp), -3.5)]


@pytest.mark.parametrize("length", range(12))
def test_a_heading_and_a_current_are_read_whatever_the_length_of_their_frame(length):
    kinds, none = STORE2.types, np.zeros(9)
    head = header(12.25, "x" * length)
    still = kinds["geometry_msgs/msg/Vector3"](0.0, 0.0, 0.0)
    q = kinds["geometry_msgs/msg/Quaternion"](0.0, 0.0, math.sin(0.15), math.cos(0.15))
    covariance = np.array([*np.arange(8.0), 1e-4])
    imu = kinds[IMU](head, q, covariance, still, none, still, none)
    found = CDR.heading(bytes(STORE2.serialize_cdr(imu, IMU)))
    assert (found.stamp, found.yaw, found.sigma) == pytest.approx((12.25, 0.3, 0.01))
    empty = np.zeros(0, dtype=np.float32)
    rest = 1, 1, 2, True, empty, empty, "left", "1"
    battery = kinds[BATTERY](head, 12.5, 30.0, -0.5, 3.0, 4.0, 5.0, 0.5, *rest)
    assert CDR.current(bytes(STORE2.serialize_cdr(battery, BATTERY))) == (12.25, -0.5)


def test_topics_are_not_guessed_and_missing_ones_listed(tmp_path, samples, with_ros):
    other = ("/camera/imu", message(STORE2, samples[0]))
    path = write_bag(tmp_path / "bag", [*samples, other])
    with_ros()
    with pytest.raises(UsageError, match=r"2 topics .*/camera/imu, /imu/data_raw.*--imu"):
        read(path)
    with pytest.raises(FileError, match=r"has no topic /nothing; it has: .*/imu/mag"):
        read(path, imu="/nothing")


def test_damage_is_reported_with_its_remedy(tmp_path, samples, with_ros):
    folder = write_bag(tmp_path / "bag", samples)
    (file,) = folder.glob("*.mcap")
    file.write_bytes(file.read_bytes()[:100])
    with_ros()
    with pytest.raises(FileError, match=r"is damaged or cut short .*mcap recover"):
        read(folder)


def test_bags_of_ros_1_are_read_by_the_library(tmp_path, samples, with_ros):
    path = write_bag(tmp_path / "bag", samples, "ros1")
    with_ros()
    with pytest.raises(FileError, match="rosbags"):
        read(path)
