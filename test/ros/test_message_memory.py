"""The processing of tens of thousands of messages leaks no memory."""

import struct
import tracemalloc

import numpy as np
import pytest
from rclpy.serialization import serialize_message
from sensor_msgs.msg import Imu, MagneticField
from simulated.turns import measure, turn

from magcal_ros.core import Compass, calibrate
from magcal_ros.core.samples import STREAMS, Pairer, Streams
from magcal_ros.core.simulation import Robot
from magcal_ros.core.up import UpFollower
from magcal_ros.ros.wire import (
    attitude_template,
    field_template,
    read_field,
    read_imu,
)

WARM = STREAMS.remembered + 100
MESSAGES = 10_000
LARGEST_GROWTH = 10_000
"""Bytes: one a message."""


class Walk:
    def __init__(self):
        robot = Robot()
        outcome = calibrate(measure(robot, turn(), np.random.default_rng(1)), robot.knowledge())
        self.compass, self.up = Compass(outcome.calibration), UpFollower()
        self.streams = Streams(STREAMS.max_gap)
        self.pairer = Pairer(self.streams)
        self.templates = field_template(), attitude_template()
        imu, field = Imu(), MagneticField()
        imu.header.frame_id, field.header.frame_id = "imu_link", "mag_link"
        imu.linear_acceleration.z, field.magnetic_field.x = 9.81, 2e-5
        self.imu, self.field = (
            bytearray(serialize_message(imu)),
            bytearray(serialize_message(field)),
        )
        self.steps = 0

    def go(self, messages):
        for _ in range(messages):
            self.steps += 1
            stamp = divmod(10**9 + self.steps * 10**6, 10**9)
            struct.pack_into("<iI", self.imu, 4, *stamp)
            struct.pack_into("<iI", self.field, 4, *stamp)
            struct.pack_into("<d", self.field, len(self.field) - 80, -4e-5 - 1e-9 * self.steps)
            sample = read_imu(bytes(self.imu)).sample
            assert self.streams.add_imu(sample)
            self.up.add(sample)
            self.answer(read_field(bytes(self.field)))

    def answer(self, arrived):
        assert self.streams.add_field(arrived.sample)
        self.pairer.offer(arrived.sample)
        self.pairer.take()
        corrected = self.compass.correct(arrived.sample.field)
        up = self.up.at(arrived.sample.stamp, STREAMS.max_gap)
        heading = self.compass.heading(corrected, up.direction, up.variance)
        field, attitude = self.templates
        field.fill(arrived.stamp, "imu_link", corrected + (0.0,) * 9)
        numbers = heading.quaternion(0.0) + heading.covariance(0.0)
        attitude.fill(arrived.stamp, "imu_link", numbers)


@pytest.mark.nightly
def test_the_processing_of_messages_leaks_no_memory():
    walk = Walk()
    walk.go(WARM)
    tracemalloc.start()
    try:
        walk.go(WARM)
        before = tracemalloc.get_traced_memory()[0]
        walk.go(MESSAGES)
        after = tracemalloc.get_traced_memory()[0]
    finally:
        tracemalloc.stop()
    assert after - before < LARGEST_GROWTH
