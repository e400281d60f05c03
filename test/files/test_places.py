from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from magcal_ros.files.places import default_calibration_path, ros_home, safe_name

HOSTILE = [
    "../../x", "..", ".", "", "/", "a/b", "a_b", "/etc/passwd", "x" * 300, "x" * 301, "x" * 80,
    "µ-meter", "磁力計", "a b", "a\0b", "a\nb", "~", "$HOME", "mag.yaml", "unnamed", "-rf", "C:\\x",
    "\ud800", "?",
]  # fmt: skip


@pytest.fixture(autouse=True)
def home(tmp_path_factory, monkeypatch):
    folder = tmp_path_factory.mktemp("home")
    monkeypatch.setenv("ROS_HOME", str(folder))
    return folder


@pytest.mark.parametrize("frame", HOSTILE)
@pytest.mark.parametrize("namespace", ["/", "/robot", "/../..", "/a/b"])
def test_a_file_lies_inside_the_folder_and_can_be_made(home, frame, namespace):
    path = default_calibration_path(frame, namespace)
    assert (home / "magcal") in path.resolve().parents
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("x")
    assert [found for found in home.rglob("*") if found.is_file()] == [path]


def test_names_that_differ_never_share_a_file():
    names = [*HOSTILE, *(safe_name(name) for name in HOSTILE)]
    assert len({safe_name(name) for name in set(names)}) == len(set(names))


@given(st.text(max_size=100), st.text(max_size=100))
def test_any_two_names_stay_apart(a, b):
    assert (safe_name(a) == safe_name(b)) == (a == b)


@given(st.text(max_size=400))
def test_a_name_of_a_digest_is_no_way_to_meet(text):
    taken = safe_name(text)
    assert safe_name(taken) != taken or taken == text


@given(st.text(max_size=400))
def test_a_safe_name_is_plain_and_short(text):
    assert len(safe_name(text)) <= 90
    assert set(safe_name(text)) <= set(
        "abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789_-"
    )


def test_an_ordinary_name_stays_readable(home):
    assert default_calibration_path("imu_link") == home / "magcal" / "imu_link.yaml"
    assert default_calibration_path("mag", "/robot1") == home / "magcal" / "robot1" / "mag.yaml"


def test_robots_in_nested_namespaces_have_files_of_their_own():
    spaces = ["/", "/a/b", "/a_b", "/a", "/b/a", "/ab"]
    assert len({default_calibration_path("mag", space) for space in spaces}) == len(spaces)


def test_without_ros_home_it_is_the_users(monkeypatch):
    monkeypatch.setenv("ROS_HOME", "")
    monkeypatch.setenv("HOME", "/somewhere")
    assert ros_home() == Path("/somewhere/.ros")
