"""What odometry and receiver say becomes numbers, or words on why it does not."""

import math
from types import SimpleNamespace as Message

import pytest

from magcal_ros.core.earth_field.reference import Fix, LocalPlane
from magcal_ros.core.messages import speed_of, velocity_of


def header(frame):
    return Message(stamp=Message(sec=7, nanosec=500_000_000), frame_id=frame)


def odometry(x, y=0.0, child="base_link", mark=0.0):
    linear = Message(x=x, y=y, z=0.0)
    twist = Message(twist=Message(linear=linear), covariance=[mark] + [0.0] * 35)
    return Message(header=header("odom"), child_frame_id=child, twist=twist)


@pytest.mark.parametrize(("x", "y", "speed"), [(2.0, 0.0, 2.0), (-3.0, 4.0, -5.0), (0.0, 0.0, 0.0)])
def test_speed_is_signed_and_in_the_vehicle(x, y, speed):
    sample = speed_of(odometry(x, y))
    assert (sample.stamp, sample.speed, sample.is_signed) == (7.5, speed, True)


@pytest.mark.parametrize(
    ("message", "words"),
    [
        (odometry(math.nan), "not finite"),
        (odometry(math.inf), "not finite"),
        (odometry(1.0, mark=-1.0), "covariance -1"),
        (odometry(1.0, child="odom"), "name the vehicle's frame"),
    ],
)
def test_what_is_no_speed_says_why(message, words):
    assert words in speed_of(message)


def test_a_receivers_velocity_is_east_and_north():
    twist = Message(linear=Message(x=1.0, y=-2.0, z=0.0))
    sample = velocity_of(Message(header=header("gps"), twist=twist))
    assert sample[:3] == (7.5, 1.0, -2.0)
    twist = Message(linear=Message(x=math.nan, y=0.0, z=0.0))
    assert "not finite" in velocity_of(Message(header=header("gps"), twist=twist))


def test_fixes_are_metres_from_the_first_good_one():
    plane = LocalPlane()
    assert plane.position(Fix(False, 48.0, 11.0, 0.0, 1.0)) is None
    assert plane.position(Fix(True, 48.0, 179.9999, 0.0, 1.0))[1:] == (0.0, 0.0)
    _, east, north = plane.position(Fix(True, 48.0001, -179.9999, math.nan, 2.0))
    assert north == pytest.approx(11.12, abs=0.02)
    assert east == pytest.approx(2.0 * 11.12 * math.cos(math.radians(48.0)), abs=0.05)
    assert plane.position(Fix(True, math.nan, 11.0, 0.0, 3.0)) is None
