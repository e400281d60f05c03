"""Speeds and fixes of a bag are read equally by the library and from the bytes."""

import math

import numpy as np
import pytest
from by_message import speed_of, velocity_of
from drives import STORE2, drive, write_bag

from magcal_ros.core.samples import PositionSample, SpeedSample, VelocitySample
from magcal_ros.files import CDR, open_recording

TYPES = STORE2.types


def header(stamp, frame):
    time = TYPES["builtin_interfaces/msg/Time"](*divmod(round(stamp * 1e9), 1_000_000_000))
    return TYPES["std_msgs/msg/Header"](stamp=time, frame_id=frame)


def odometry(stamp, speed, frame="odom", child="base_link"):
    vector = TYPES["geometry_msgs/msg/Vector3"]
    pose = TYPES["geometry_msgs/msg/Pose"](
        TYPES["geometry_msgs/msg/Point"](1.0, 2.0, 3.0),
        TYPES["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 1.0),
    )
    twist = TYPES["geometry_msgs/msg/Twist"](vector(speed, 0.1, 0.2), vector(0.0, 0.0, 0.3))
    return TYPES["nav_msgs/msg/Odometry"](
        header(stamp, frame),
        child,
        TYPES["geometry_msgs/msg/PoseWithCovariance"](pose, np.arange(36.0)),
        TYPES["geometry_msgs/msg/TwistWithCovariance"](twist, np.arange(36.0) + 0.5),
    )


def fix(stamp, latitude):
    status = TYPES["sensor_msgs/msg/NavSatStatus"](status=0, service=1)
    return TYPES["sensor_msgs/msg/NavSatFix"](
        header(stamp, "gps"), status, latitude, 11.0, 500.0, np.zeros(9), 0
    )


def test_fixes_and_speeds_come_by_their_stamps(tmp_path):
    extra = [("/fix", fix(1001.0, 48.0)), ("/odom", odometry(1000.5, -2.0))]
    extra += [("/fix", fix(1002.0, 48.0 + math.degrees(100.0 / 6_371_000.0)))]
    bag = write_bag(tmp_path / "bag", [*drive(90.0), *extra])
    with open_recording(bag) as source:
        found = source.travel
    assert [type(sample) for sample in found] == [SpeedSample, PositionSample, PositionSample]
    assert found[0].speed == pytest.approx(-2.0, abs=0.01)
    assert found[2].north == pytest.approx(100.0, abs=0.01)


@pytest.mark.parametrize(
    ("one", "other"), [("/wheels/odom", "/odometry/gps"), ("/kf/filtered", "/odometry/gps")]
)
def test_of_several_odometries_one_is_used(tmp_path, one, other):
    """The speeds of two sources do not alternate: that of a navsat_transform is always zero."""
    extra = [(one, odometry(1000.5, -2.0)), (other, odometry(1000.6, 0.0))]
    with open_recording(write_bag(tmp_path / "bag", [*drive(90.0), *extra])) as source:
        assert [round(sample.speed, 1) for sample in source.travel] == [-2.0]
        (note,) = source.notes
    assert note.endswith(f" are all nav_msgs/Odometry: only {one} is used")


def velocity(stamp, east, north, sure, frame="gps"):
    vector = TYPES["geometry_msgs/msg/Vector3"]
    twist = TYPES["geometry_msgs/msg/Twist"](vector(east, north, 0.0), vector(0.0, 0.0, 0.0))
    if not sure:
        return TYPES["geometry_msgs/msg/TwistStamped"](header(stamp, frame), twist)
    known = np.zeros(36)
    known[[0, 7]] = 0.04
    twist = TYPES["geometry_msgs/msg/TwistWithCovariance"](twist, known)
    return TYPES["geometry_msgs/msg/TwistWithCovarianceStamped"](header(stamp, frame), twist)


@pytest.mark.parametrize(
    ("topic", "sure", "sigma"), [("/gps/vel", False, 0.1), ("/fix_velocity", True, 0.2)]
)
def test_the_velocity_of_a_receiver_is_used_and_a_command_is_not(tmp_path, topic, sure, sigma):
    extra = [("/fix", fix(1001.0, 48.0)), (topic, velocity(1001.0, 3.0, -4.0, sure))]
    extra += [("/cmd_vel", velocity(1001.5, 9.0, 0.0, False))]
    with open_recording(write_bag(tmp_path / "bag", [*drive(90.0), *extra])) as source:
        _, found = source.travel
    assert found == VelocitySample(1001.0, 3.0, -4.0, pytest.approx(sigma))


@pytest.mark.parametrize("frame", ["", "g", "gp", "gps", "gps_link"])
@pytest.mark.parametrize("sure", [False, True])
def test_a_velocity_is_read_from_its_bytes(frame, sure):
    message = velocity(12.25, 3.5, -0.1, sure, frame)
    data = bytes(STORE2.serialize_cdr(message, message.__msgtype__))
    read = CDR.velocity_with_covariance if sure else CDR.velocity
    assert read(data) == velocity_of(message)


def test_a_bag_of_the_sensors_alone_has_no_travel(tmp_path):
    with open_recording(write_bag(tmp_path / "bag", drive(90.0))) as source:
        assert source.travel == ()


@pytest.mark.parametrize("frame", ["", "o", "od", "odo", "odom", "odom_frame"])
@pytest.mark.parametrize("child", ["", "b", "base", "base_link"])
def test_an_odometry_is_read_from_its_bytes(frame, child):
    message = odometry(12.25, 3.5, frame, child)
    found = CDR.speed(bytes(STORE2.serialize_cdr(message, "nav_msgs/msg/Odometry")))
    assert found == speed_of(message)


def speed(x, y=0.0, child="base_link", mark=0.0):
    message = odometry(7.5, x, child=child)
    message.twist.twist.linear.y, message.twist.covariance[0] = y, mark
    return CDR.speed(bytes(STORE2.serialize_cdr(message, "nav_msgs/msg/Odometry")))


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


def test_a_velocity_that_is_not_finite_or_marked_absent_gives_a_reason():
    message = velocity(7.5, math.nan, 0.0, False)
    data = bytes(STORE2.serialize_cdr(message, message.__msgtype__))
    assert "not finite" in CDR.velocity(data)
    message = velocity(7.5, 1.0, -2.0, True)
    message.twist.covariance[0] = -1.0
    data = bytes(STORE2.serialize_cdr(message, message.__msgtype__))
    assert "marked absent" in CDR.velocity_with_covariance(data)
