"""Messages are read from bytes exactly as by rclpy."""

import contextlib
import math
import struct

import numpy as np
import pytest
from by_message import field_sample, fix_of, imu_sample, speed_of, velocity_of
from examples import examples
from geometry_msgs.msg import TwistStamped
from hypothesis import given
from hypothesis import strategies as st
from nav_msgs.msg import Odometry
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import Imu, MagneticField, NavSatFix

from magcal_ros.ros.wire import (
    STAMP,
    Unreadable,
    read_field,
    read_fix,
    read_imu,
    read_speed,
    read_velocity,
)

DOUBLES = st.floats(width=64)
NINE = st.lists(DOUBLES, min_size=9, max_size=9)
FRAMES = st.text(st.characters(exclude_categories=["Cs"], exclude_characters="\0"), max_size=40)
SECONDS = st.integers(-(2**31), 2**31 - 1)
NANOSECONDS = st.integers(0, 2**32 - 1)
ORDERS = st.sampled_from("<>")


def stamped(message, frame, sec, nanosec):
    message.header.frame_id = frame
    message.header.stamp.sec, message.header.stamp.nanosec = sec, nanosec
    return message


def fill(vector, numbers):
    vector.x, vector.y, vector.z = numbers


def by_hand(order, frame, sec, nanosec, doubles):
    """CDR written from its definition: doubles aligned to eight, counted from after the start."""
    text = frame.encode() + b"\0"
    body = struct.pack(f"{order}iII", sec, nanosec, len(text)) + text
    body += bytes(-len(body) % 8) + struct.pack(f"{order}{len(doubles)}d", *doubles)
    return bytes([0, order == "<", 0, 0]) + body


def same(a, b):
    """Equal to the last bit: NaN is NaN, and -0.0 is not 0.0."""
    return np.array(a).tobytes() == np.array(b).tobytes()


@examples(60)
@given(FRAMES, SECONDS, NANOSECONDS, st.lists(DOUBLES, min_size=3, max_size=3), NINE, ORDERS)
def test_a_field_is_read_as_by_rclpy(frame, sec, nanosec, field, covariance, order):
    data = by_hand(order, frame, sec, nanosec, [*field, *covariance])
    message = deserialize_message(data, MagneticField)
    found = read_field(data)
    assert found.frame == message.header.frame_id == frame
    assert same(found.sample.stamp, field_sample(message).stamp)
    assert same(found.sample.field, field)
    assert STAMP.unpack(found.stamp) == (sec, nanosec)
    assert found.covariance == message.magnetic_field_covariance.tobytes()


@examples(60)
@given(FRAMES, SECONDS, NANOSECONDS, st.lists(DOUBLES, min_size=37, max_size=37), ORDERS)
def test_an_imu_message_is_read_as_by_rclpy(frame, sec, nanosec, doubles, order):
    data = by_hand(order, frame, sec, nanosec, doubles)
    message = deserialize_message(data, Imu)
    found, wanted = read_imu(data), imu_sample(message)
    assert found.frame == frame
    assert STAMP.unpack(found.stamp) == (message.header.stamp.sec, message.header.stamp.nanosec)
    assert (found.sample is None) == (wanted is None)
    if wanted is not None:
        assert same(found.sample.stamp, wanted.stamp)
        assert same(found.sample.force, wanted.force)
        assert same(found.sample.rate, wanted.rate)


@pytest.mark.parametrize("length", range(17))
def test_frames_of_every_length_leave_the_doubles_aligned(length):
    imu = stamped(Imu(), "f" * length, 7, 5)
    fill(imu.linear_acceleration, (1.0, 2.0, 3.0))
    fill(imu.angular_velocity, (4.0, 5.0, 6.0))
    frame, sample, stamp = read_imu(serialize_message(imu))
    assert (frame, sample) == ("f" * length, imu_sample(imu))
    assert STAMP.unpack(stamp) == (7, 5)


@pytest.mark.parametrize(("force", "rate"), [(-1.0, 0.0), (0.0, -1.0), (-1.0, -1.0)])
def test_marks_of_absence_are_understood_on_both_ways(force, rate):
    for order in "<>":
        doubles = [0.0] * 37
        doubles[13 + 3], doubles[25 + 3] = rate, force
        sample = read_imu(by_hand(order, "imu", 1, 2, doubles)).sample
        assert (sample is None) == (force == -1.0)
        if sample is not None:
            assert all(map(math.isnan, sample.rate)) == (rate == -1.0)


@pytest.mark.parametrize(
    "text", [b"", b"abc", b"a\0b\0", b"\0", b"\xff\xfe\0", b"\xe4\xf6\0", b"x" * 100_000 + b"\0"]
)
def test_unusual_frames_are_read_as_by_rclpy(text):
    body = struct.pack("<iII", 3, 4, len(text)) + text
    body += bytes(-len(body) % 8) + struct.pack("<12d", *range(12))
    data = b"\0\1\0\0" + body
    try:
        frame = deserialize_message(data, MagneticField).header.frame_id
    except Exception:
        with pytest.raises(Unreadable):
            read_field(data)
        return
    found = read_field(data)
    assert found.frame == frame
    assert found.sample.field == (0.0, 1.0, 2.0)


@pytest.mark.parametrize(("kind", "read"), [(Imu, read_imu), (MagneticField, read_field)])
def test_truncated_bytes_are_unreadable(kind, read):
    data = serialize_message(stamped(kind(), "a_frame", 1, 2))
    whole = read(data)
    assert whole.frame == "a_frame"
    for size in range(len(data)):
        with pytest.raises(Unreadable, match=kind.__name__):
            read(data[:size])


@examples(90)
@given(st.binary(max_size=400), st.sampled_from([b"", b"\0\1\0\0", b"\0\0\0\0", b"\0\7\0\0"]))
def test_random_bytes_are_a_message_or_unreadable(data, start):
    for read in (read_imu, read_field):
        try:
            found = read(start + data)
        except Unreadable:
            continue
        assert isinstance(found.frame, str)
    for read in (read_speed, read_velocity, read_fix):
        with contextlib.suppress(Unreadable):
            assert read(start + data) is not None


@pytest.mark.parametrize("length", range(9))
def test_speeds_and_fixes_are_those_of_the_message(length):
    odometry = stamped(Odometry(child_frame_id="base"[: length % 5]), "odom"[:length], 3, 4)
    odometry.twist.twist.linear.x, odometry.twist.twist.linear.y = -2.5, 0.5
    twist = stamped(TwistStamped(), "g" * length, 3, 4)
    twist.twist.linear.x, twist.twist.linear.y = 1.25, -7.0
    fix = stamped(NavSatFix(latitude=48.1, longitude=11.6, altitude=520.0), "g" * length, 3, 4)
    assert read_speed(serialize_message(odometry)) == speed_of(odometry)
    assert read_velocity(serialize_message(twist)) == velocity_of(twist)
    assert read_fix(serialize_message(fix)) == fix_of(fix)


def test_a_frame_of_impossible_length_is_unreadable():
    data = bytearray(serialize_message(stamped(MagneticField(), "mag", 1, 2)))
    for length in (2**31 - 1, 2**32 - 1, 97, 200):
        struct.pack_into("<I", data, 12, length)
        with pytest.raises(Unreadable):
            read_field(bytes(data))
