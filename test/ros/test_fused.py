"""The fused yaw of the running node: smooth, at the IMU's rate, not disturbed by passing iron."""

import math
from collections import deque

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from sensor_msgs.msg import Imu
from support import PATIENCE, REFERENCE, store_calibration

from magcal_ros.core.geometry import wrap_angle
from magcal_ros.core.samples import FieldSample

IRON = (0.0, 14e-6, -14e-6)
"""Tesla in the sensor's axes: stronger and steeper at any heading, and off by tens of degrees."""


@pytest.fixture
def fused(loaded):
    """Return an actor whose node is calibrated, and the received fused yaw."""
    actor = loaded(parameters={**REFERENCE, "fused.patience_s": 100.0})
    received, reports = [], []
    actor.node.create_subscription(Imu, "compass/fused/enu/imu", received.append, 100)
    actor.node.create_subscription(DiagnosticArray, "/diagnostics", reports.append, 10)
    actor.run(PATIENCE, stop=lambda: len(received) > 50 and reports)
    return actor, received, reports


def yaw_of(message):
    q = message.orientation
    return math.atan2(2 * (q.w * q.z + q.x * q.y), 1 - 2 * (q.y * q.y + q.z * q.z))


def diagnostic(reports):
    parts = {status.name: status for status in reports[-1].status}
    return parts["calibrator: Fused"]


def test_the_fused_yaw_follows_the_robot_and_ignores_passing_iron(fused):
    actor, received, reports = fused
    assert len(received) > 50
    assert received[-1].header.frame_id == "imu_link"
    assert received[-1].angular_velocity_covariance[0] == -1.0
    actor.run(1.0, yaw_rate=0.5)
    actor.run(1.0)
    error = float(wrap_angle(yaw_of(received[-1]) - actor.ride.magnetic_yaw))
    assert abs(math.degrees(error)) < 1.5
    assert diagnostic(reports).level == DiagnosticStatus.OK
    variance = received[-1].orientation_covariance[8]
    assert 0.0 < variance < math.radians(3.0) ** 2

    def bend(sample):
        if isinstance(sample, FieldSample):
            sample = sample._replace(field=tuple(np.add(sample.field, IRON)))
        return [sample]

    actor.mangle = bend
    # A busy machine that stands still for half a second of the robot's time loses north.
    actor.speed = 1.0
    actor.run(2.5)
    error = float(wrap_angle(yaw_of(received[-1]) - actor.ride.magnetic_yaw))
    assert abs(math.degrees(error)) < 3.0
    assert received[-1].orientation_covariance[8] > variance
    assert diagnostic(reports).level == DiagnosticStatus.WARN
    assert "ignored" in diagnostic(reports).message
    assert "strength" in diagnostic(reports).message


def test_a_late_field_is_turned_to_its_stamp(graph, tmp_path):
    path = store_calibration(tmp_path / "late.yaml", latency=0.3)
    actor = graph.loaded(path, tmp_path)
    received, waiting = [], deque()
    actor.node.create_subscription(Imu, "compass/mag/enu/imu", received.append, 100)

    def delay(sample):
        if not isinstance(sample, FieldSample):
            return [sample]
        waiting.append(sample)
        while waiting[0].stamp < sample.stamp - 0.3:
            waiting.popleft()
        return [sample._replace(field=waiting[0].field)]

    actor.mangle = delay
    actor.run(PATIENCE, stop=lambda: received)
    actor.run(2.0, yaw_rate=0.8)
    error = float(wrap_angle(yaw_of(received[-1]) - actor.ride.magnetic_yaw))
    assert abs(math.degrees(error)) < 4.0, "without the correction it is 14"


def test_without_a_gyro_nothing_is_published_and_this_is_reported(loaded):
    actor = loaded(gyro=False)
    received, reports = [], []
    actor.node.create_subscription(Imu, "compass/fused/enu/imu", received.append, 100)
    actor.node.create_subscription(DiagnosticArray, "/diagnostics", reports.append, 10)
    actor.run(PATIENCE, stop=lambda: len(reports) > 1)
    assert not received
    assert "no gyro" in diagnostic(reports).message


def test_a_field_that_is_too_old_for_the_gyro_is_named(loaded):
    actor = loaded()
    reports = []
    actor.node.create_subscription(DiagnosticArray, "/diagnostics", reports.append, 10)
    actor.node.create_subscription(Imu, "compass/fused/enu/imu", lambda _: None, 100)

    def late(sample):
        is_field = isinstance(sample, FieldSample)
        return [sample._replace(stamp=sample.stamp - 0.8) if is_field else sample]

    actor.mangle = late
    actor.run(
        PATIENCE, stop=lambda: any("with a stamp" in diagnostic([r]).message for r in reports)
    )
    assert "no field has come with a stamp within 0.5 s of the IMU's" in diagnostic(reports).message
