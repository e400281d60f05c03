"""Messages of odometry and receiver become samples, or a reason why not."""

import math

import pytest

from magcal_ros.core.earth_field import Fix, LocalPlane
from magcal_ros.core.messages import speed_from, velocity_from


def speed(x, y=0.0, child="base_link", mark=0.0):
    return speed_from(7.5, "odom", child, mark, x, y)


@pytest.mark.parametrize(("x", "y", "found"), [(2.0, 0.0, 2.0), (-3.0, 4.0, -5.0), (0.0, 0.0, 0.0)])
def test_speed_is_signed_and_in_the_vehicle(x, y, found):
    sample = speed(x, y)
    assert (sample.stamp, sample.speed, sample.is_signed) == (7.5, found, True)


@pytest.mark.parametrize(
    ("found", "words"),
    [
        (speed(math.nan), "not finite"),
        (speed(math.inf), "not finite"),
        (speed(1.0, mark=-1.0), "covariance -1"),
        (speed(1.0, child="odom"), "give the vehicle's frame as child_frame_id"),
    ],
)
def test_an_unusable_speed_gives_a_reason(found, words):
    assert words in found


def test_a_receivers_velocity_is_east_and_north():
    sample = velocity_from(7.5, 1.0, -2.0)
    assert sample[:3] == (7.5, 1.0, -2.0)
    assert "not finite" in velocity_from(7.5, math.nan, 0.0)


def test_fixes_are_metres_from_the_first_good_one():
    plane = LocalPlane()
    assert plane.position(Fix(False, 48.0, 11.0, 0.0, 1.0)) is None
    assert plane.position(Fix(True, 48.0, 179.9999, 0.0, 1.0))[1:] == (0.0, 0.0)
    _, east, north = plane.position(Fix(True, 48.0001, -179.9999, math.nan, 2.0))
    assert north == pytest.approx(11.12, abs=0.02)
    assert east == pytest.approx(2.0 * 11.12 * math.cos(math.radians(48.0)), abs=0.05)
    assert plane.position(Fix(True, math.nan, 11.0, 0.0, 3.0)) is None
