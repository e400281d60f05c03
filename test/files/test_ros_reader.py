"""Bags read with ROS's own reader give what the library gives."""

import math
import sys

import numpy as np
import pytest
from drives import STORE2, drive, header, message, write_bag
from ros_bags import rosbag2_py

from magcal_ros.core.earth_field.reference import Place
from magcal_ros.core.errors import Misuse
from magcal_ros.core.messages import current_of, fix_of, heading_of
from magcal_ros.files.disk import FileTrouble
from magcal_ros.files.sources import open_recording
from magcal_ros.files.wire import current_in, fix_in, heading_in

FIX = "sensor_msgs/msg/NavSatFix"
IMU = "sensor_msgs/msg/Imu"
BATTERY = "sensor_msgs/msg/BatteryState"


@pytest.fixture(scope="module")
def samples():
    return drive(60.0)


@pytest.fixture(params=[False, True], ids=["since Jazzy", "before Jazzy"])
def with_ros(request, monkeypatch):
    """Have ROS and not the library."""

    def switch():
        monkeypatch.setitem(sys.modules, "rosbag2_py", rosbag2_py(request.param))
        monkeypatch.setitem(sys.modules, "rosbags.highlevel", None)

    return switch


def read(path, **options):
    with open_recording(path, **options) as source:
        return list(source.readings()), source


@pytest.mark.parametrize("kind", ["mcap", "sqlite3"])
@pytest.mark.parametrize("span", [{}, {"start": 0.5, "stop": 1.25}])
def test_it_reads_what_the_library_reads(tmp_path, samples, kind, span, with_ros):
    path = write_bag(tmp_path / "bag", samples, kind)
    expected, by_library = read(path, **span)
    with_ros()
    found, source = read(path, **span)
    assert found == expected
    assert (source.imu_topic, source.field_topic) == (by_library.imu_topic, by_library.field_topic)
    assert (source.imu_frame, source.field_frame) == ("imu_link", "mag_link")
    assert source.share == pytest.approx(1.0, abs=0.02)


def test_a_single_file_is_read(tmp_path, samples, with_ros):
    folder = write_bag(tmp_path / "bag", samples)
    with_ros()
    assert len(read(next(folder.glob("*.mcap")))[0]) == len(samples)


def test_a_place_is_found(tmp_path, samples, with_ros):
    path = write_bag(tmp_path / "bag", [*samples, ("/fix", fix("gps"))])
    with_ros()
    with open_recording(path) as source:
        assert source.place() == Place(48.1, 11.6, 520.0)


def fix(frame):
    kinds = STORE2.types
    header = message(STORE2, drive(5.0)[0], frame).header
    status = kinds["sensor_msgs/msg/NavSatStatus"](2, 1)
    covariance = message(STORE2, drive(5.0)[0]).orientation_covariance
    return kinds[FIX](header, status, 48.1, 11.6, 520.0, covariance, 0)


@pytest.mark.parametrize("length", range(12))
def test_a_fix_is_read_whatever_the_length_of_its_frame(length):
    whole = fix("x" * length)
    found = fix_in(bytes(STORE2.serialize_cdr(whole, FIX)))
    assert found == fix_of(whole)
    assert (found.has_fix, found.latitude_deg, found.altitude) == (True, 48.1, 520.0)


def antenna(stamp, yaw, variance, frame="gps"):
    kinds = STORE2.types
    covariance, none = np.arange(9.0), np.zeros(9)
    covariance[8] = variance
    still = kinds["geometry_msgs/msg/Vector3"](0.0, 0.0, 0.0)
    q = kinds["geometry_msgs/msg/Quaternion"](0.0, 0.0, math.sin(0.5 * yaw), math.cos(0.5 * yaw))
    return kinds[IMU](header(stamp, frame), q, covariance, still, none, still, none)


def battery(stamp, current, frame=""):
    numbers = [12.5, 30.0, current, 3.0, 4.0, 5.0, 0.5]
    empty = np.zeros(0, dtype=np.float32)
    rest = 1, 1, 2, True, empty, empty, "left", "1"
    return STORE2.types[BATTERY](header(stamp, frame), *numbers, *rest)


def test_headings_and_the_current_of_a_battery_are_read(tmp_path, samples, with_ros):
    extra = [("/heading", antenna(1003.0 - k, 0.5 * k, 1e-4)) for k in range(3)]
    extra += [("/battery", battery(stamp, 2.5)) for stamp in (1001.0, 0.0)]
    path = write_bag(tmp_path / "bag", [*samples, *extra])
    with open_recording(path, imu="/imu/data_raw") as source:
        by_library = source.headings("/heading"), source.currents()
    with_ros()
    with open_recording(path, imu="/imu/data_raw") as source:
        headings, currents = source.headings("/heading"), source.currents()
    assert (headings, currents) == by_library
    assert [each.yaw for each in headings] == pytest.approx([1.0, 0.5, 0.0])
    assert currents[0] == (1001.0, 2.5)
    # A battery without stamps has those of the recorder.
    assert currents[1][0] > 1001.0


@pytest.mark.parametrize("length", range(12))
@pytest.mark.parametrize("variance", [0.0, 1e-4, 2.0])
def test_a_heading_and_a_current_are_read_whatever_the_length_of_their_frame(length, variance):
    whole = antenna(12.25, 0.3, variance, "x" * length)
    assert heading_in(bytes(STORE2.serialize_cdr(whole, IMU))) == heading_of(whole)
    whole = battery(12.25, -0.5, "x" * length)
    found = current_in(bytes(STORE2.serialize_cdr(whole, BATTERY)))
    assert found == current_of(whole) == (12.25, -0.5)


def test_topics_are_not_guessed_and_missing_ones_listed(tmp_path, samples, with_ros):
    other = ("/camera/imu", message(STORE2, samples[0]))
    path = write_bag(tmp_path / "bag", [*samples, other])
    with_ros()
    with pytest.raises(Misuse, match=r"2 topics .*/camera/imu, /imu/data_raw.*--imu"):
        read(path)
    with pytest.raises(FileTrouble, match=r"has no topic /nothing; it has: .*/imu/mag"):
        read(path, imu="/nothing")


def test_damage_is_said_with_its_remedy(tmp_path, samples, with_ros):
    folder = write_bag(tmp_path / "bag", samples)
    (file,) = folder.glob("*.mcap")
    file.write_bytes(file.read_bytes()[:100])
    with_ros()
    with pytest.raises(FileTrouble, match=r"is damaged or cut short .*mcap recover"):
        read(folder)


def test_bags_of_ros_1_are_left_to_the_library(tmp_path, samples, with_ros):
    path = write_bag(tmp_path / "bag", samples, "ros1")
    with_ros()
    with pytest.raises(FileTrouble, match="rosbags"):
        read(path)
