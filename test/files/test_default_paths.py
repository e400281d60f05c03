from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from magcal_ros.files import (
    LONGEST_FRAME,
    RESERVED,
    FileError,
    chosen_path,
    identifier,
    is_missing,
    own_folder,
    safe_name,
    sensor_file,
)

pytestmark = pytest.mark.faults

HOSTILE = [
    "../../x", "..", ".", "", "/", "a/b", "a_b", "/etc/passwd", "x" * 300, "x" * 301, "x" * 80,
    "µ-meter", "磁力計", "a b", "a\0b", "a\nb", "~", "$HOME", "mag.yaml", "unnamed", "-rf", "C:\\x",
    "\ud800", "?", "con", "NUL", "com1", "LPT9",
]  # fmt: skip


@pytest.fixture(autouse=True)
def home(tmp_path_factory, monkeypatch):
    folder = tmp_path_factory.mktemp("home")
    monkeypatch.setenv("ROS_HOME", str(folder))
    return folder


@pytest.mark.parametrize("namespace", ["/", "/robot", "/../..", "/a/b"])
def test_a_file_is_inside_the_folder_and_can_be_created(home, namespace):
    for frame in HOSTILE:
        path = sensor_file(frame, namespace, "calibrator")
        assert (home / "magcal") in path.resolve().parents, frame
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text("x")
        assert [found for found in home.rglob("*") if found.is_file()] == [path], frame
        path.unlink()


def test_different_names_never_share_a_file():
    names = [*HOSTILE, *(safe_name(name) for name in HOSTILE)]
    assert len({safe_name(name) for name in set(names)}) == len(set(names))


@given(st.text(max_size=100), st.text(max_size=100))
def test_any_two_names_get_different_files(a, b):
    assert (safe_name(a) == safe_name(b)) == (a == b)


@given(st.text(max_size=400))
def test_a_name_like_a_digest_shares_no_file(text):
    taken = safe_name(text)
    assert safe_name(taken) != taken or taken == text


@given(st.text(max_size=400))
def test_a_safe_name_is_short_and_simple(text):
    assert len(safe_name(text)) <= 90
    assert set(safe_name(text)) <= set(
        "abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789_-"
    )


def test_an_ordinary_name_is_unchanged(home):
    assert sensor_file("imu_link", "/", "calibrator") == home / "magcal/calibrator.imu_link.yaml"
    assert sensor_file("mag", "/robot1", "left") == home / "magcal/robot1/left.mag.yaml"
    assert sensor_file("", "/", "calibrator") == home / "magcal/calibrator.magnetometer.yaml"


def test_nodes_sensors_and_namespaces_have_separate_files():
    spaces = ["/", "/a/b", "/a_b", "/a", "/b/a", "/ab", "/left", "/calibrator"]
    nodes = ["left", "right", "calibrator", "a"]
    frames = ["imu_link", "left", "right", "a", ""]
    files = [sensor_file(f, s, n) for f in frames for s in spaces for n in nodes]
    assert len(set(files)) == len(files)


def test_without_ros_home_the_folder_is_in_the_users_home(monkeypatch):
    monkeypatch.setenv("ROS_HOME", "")
    monkeypatch.setenv("HOME", "/somewhere")
    assert own_folder() == Path("/somewhere/.ros/magcal")


@pytest.mark.parametrize("frame", ["con", "NUL", "Com1", "lpt9"])
def test_names_that_are_devices_elsewhere_are_no_files(frame):
    assert not RESERVED.match(safe_name(frame))


def test_a_missing_home_is_an_error_with_a_reason(monkeypatch):
    with pytest.raises(FileError, match="no home folder for '~nobody_of_this_name/x'"):
        chosen_path("~nobody_of_this_name/x")
    monkeypatch.setenv("ROS_HOME", "~nobody_of_this_name")
    with pytest.raises(FileError, match="set ROS_HOME"):
        sensor_file("mag", "/", "calibrator")


def test_only_a_certainly_absent_file_is_missing(tmp_path):
    (tmp_path / "file").write_text("")
    assert is_missing(tmp_path / "nothing")
    assert is_missing(tmp_path / "file" / "below")
    assert not is_missing(tmp_path / "file")
    # A path that cannot be examined is reported by the function that reads it.
    assert not is_missing(tmp_path / ("x" * 300))
    assert not is_missing(Path("a\0b"))


@given(st.text(max_size=3 * LONGEST_FRAME), st.text(max_size=3 * LONGEST_FRAME))
def test_a_frame_has_a_short_unique_identifier(a, b):
    assert (identifier(a) == identifier(b)) == (a == b)
    assert len(identifier(a)) < LONGEST_FRAME + 10
