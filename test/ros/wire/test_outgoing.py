"""A filled template has exactly the bytes that rclpy writes."""

import math
import struct

import numpy as np
import pytest
from examples import examples
from hypothesis import given
from hypothesis import strategies as st
from rclpy.serialization import serialize_message
from sensor_msgs.msg import Imu, MagneticField

from magcal_ros.core.heading import Heading
from magcal_ros.ros import wire as outgoing
from magcal_ros.ros.wire import STAMP, attitude_template, field_template

DOUBLES = st.floats(width=64)
FRAMES = st.text(st.characters(exclude_categories=["Cs"], exclude_characters="\0"), max_size=20)
STAMPS = st.tuples(st.integers(-(2**31), 2**31 - 1), st.integers(0, 2**32 - 1))
ANGLES = st.floats(-math.pi, math.pi)
FIELD, ATTITUDE = field_template(), attitude_template()
"""One of each for all cases: a template keeps the frame of the message before."""


@pytest.fixture(params=["as bytes", "by rclpy"])
def templates(request, monkeypatch):
    """Return both templates, once where rclpy's layout is the usual one, once where not."""
    if request.param == "by rclpy":
        monkeypatch.setattr(outgoing, "is_plain_cdr", lambda _: False)
    return field_template(), attitude_template()


def essence(message):
    """Serialized bytes without the padding after the frame, which holds whatever was in memory."""
    data = message if isinstance(message, bytes) else serialize_message(message)
    end = 16 + struct.unpack_from("<I", data, 12)[0]
    return data[:end] + data[end + (4 - end) % 8 :]


def header(message, stamp, frame):
    message.header.frame_id = frame
    message.header.stamp.sec, message.header.stamp.nanosec = stamp
    return message


def field_message(stamp, frame, field, covariance):
    message = header(MagneticField(), stamp, frame)
    message.magnetic_field.x, message.magnetic_field.y, message.magnetic_field.z = field
    message.magnetic_field_covariance = np.array(covariance)
    return message


def attitude_message(stamp, frame, heading, declination, sigma=0.0):
    message = header(Imu(), stamp, frame)
    q = message.orientation
    q.x, q.y, q.z, q.w = heading.quaternion(declination)
    message.orientation_covariance = np.array(heading.covariance(sigma**2))
    message.angular_velocity_covariance[0] = message.linear_acceleration_covariance[0] = -1.0
    return message


@examples(60)
@given(
    STAMPS,
    FRAMES,
    st.tuples(*[DOUBLES] * 3),
    st.lists(DOUBLES, min_size=9, max_size=9).map(tuple),
)
def test_a_field_is_written_as_by_rclpy(stamp, frame, field, covariance):
    filled = FIELD.fill(STAMP.pack(*stamp), frame, field + covariance)
    assert isinstance(filled, bytes)
    assert essence(filled) == essence(field_message(stamp, frame, field, covariance))


@examples(60)
@given(STAMPS, FRAMES, st.tuples(*[ANGLES] * 3), st.tuples(*[DOUBLES] * 4), ANGLES, ANGLES)
def test_an_attitude_is_written_as_by_rclpy(stamp, frame, angles, variances, declination, sigma):
    heading = Heading(*angles, *variances)
    numbers = heading.quaternion(declination) + heading.covariance(sigma**2)
    filled = ATTITUDE.fill(STAMP.pack(*stamp), frame, numbers)
    assert isinstance(filled, bytes)
    assert essence(filled) == essence(attitude_message(stamp, frame, heading, declination, sigma))


def test_both_ways_give_the_same_message(templates):
    field, attitude = templates
    heading = Heading(0.1, -0.2, 0.3, 1e-4, 2e-4, 1e-5, -1e-5)
    for frame in ("imu_link", "", "ä" * 9):
        for stamp in ((1, 2), (-5, 999_999_999)):
            packed = STAMP.pack(*stamp)
            numbers = (1e-5, -2e-5, math.nan), tuple(float(k) for k in range(9))
            filled = field.fill(packed, frame, numbers[0] + numbers[1])
            assert essence(filled) == essence(field_message(stamp, frame, *numbers))
            turned = heading.quaternion(0.05) + heading.covariance(0.0)
            filled = attitude.fill(packed, frame, turned)
            wanted = attitude_message(stamp, frame, heading, 0.05)
            assert essence(filled) == essence(wanted)
