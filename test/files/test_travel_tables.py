"""Speed and fixes in a CSV folder."""

import math

import pytest
from drives import drive, write_csv

from magcal_ros.core.samples import PositionSample, SpeedSample
from magcal_ros.files import FileError, open_recording


@pytest.fixture
def folder(tmp_path):
    return write_csv(tmp_path / "csv", drive(30.0, start=-0.02, hertz=50.0))


def test_speeds_and_fixes_have_their_stamps_and_give_the_place(folder):
    step = math.degrees(100.0 / 6_371_000.0)
    (folder / "odom.csv").write_text("speed,t\n-2.0,0.5\nnan,0.6\n")
    (folder / "gps.csv").write_text(
        f"t,latitude,longitude\n0.2,nan,11\n0.3,48,11\n0.8,{48.0 + step!r},11\n"
    )
    with open_recording(folder) as source:
        first, speed, _, second = source.travel
        assert source.place.latitude_deg == 48.0
    # Time that begins at zero is moved to one second for all alike.
    shift = first.stamp - 0.3
    assert speed == SpeedSample(pytest.approx(0.5 + shift), -2.0)
    assert (second.stamp, second.north) == pytest.approx((0.8 + shift, 100.0), abs=0.01)
    assert 0.9 < shift < 1.1


def test_positions_in_metres_are_accepted_and_cut_by_a_span(folder):
    (folder / "gps.csv").write_text("t,east,north\n0.3,1,2\n0.9,3,4\n")
    with open_recording(folder, start=0.5) as source:
        (found,) = source.travel
        assert source.place is None
    assert isinstance(found, PositionSample)
    assert (found.east, found.north) == (3.0, 4.0)


def test_a_folder_of_the_sensors_alone_has_no_travel(folder):
    with open_recording(folder) as source:
        assert (source.travel, source.place) == ((), None)


@pytest.mark.parametrize("name", ["odom.csv", "gps.csv"])
def test_missing_columns_are_named(folder, name):
    (folder / name).write_text("t,way\n1,2\n")
    with pytest.raises(FileError, match=f"{name} has no column .*its first line should be t,"):
        open_recording(folder)
