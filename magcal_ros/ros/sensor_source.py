"""Publishes sensor samples on the two topics as a driver would."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from typing import Any

from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import Imu, MagneticField

from magcal_ros.core.messages import ABSENT
from magcal_ros.core.samples.streams import FieldSample, ImuSample
from magcal_ros.files.recording import Recording
from magcal_ros.files.sources import FIRST_STAMP


class SensorSource:
    """A driver for an IMU and a magnetometer."""

    def __init__(
        self, node: Node, imu_frame: str = "imu_link", field_frame: str = "mag_link"
    ) -> None:
        self._imu_out = node.create_publisher(Imu, "imu/data_raw", qos_profile_sensor_data)
        self._field_out = node.create_publisher(MagneticField, "imu/mag", qos_profile_sensor_data)
        self._imu, self._field = Imu(), MagneticField()
        self._imu.header.frame_id = imu_frame
        self._imu.orientation_covariance[0] = ABSENT
        self._field.header.frame_id = field_frame

    @property
    def listeners(self) -> int:
        """How many subscriptions both topics have, the less-heard one counting."""
        return min(self._imu_out.get_subscription_count(), self._field_out.get_subscription_count())

    def publish(self, sample: ImuSample | FieldSample) -> None:
        """Publish one sample under its own stamp."""
        if isinstance(sample, ImuSample):
            self._publish_imu(sample)
        else:
            self._publish_field(sample)

    def _publish_imu(self, sample: ImuSample) -> None:
        message = self._imu
        set_time(message.header.stamp, sample.stamp)
        force, rate = message.linear_acceleration, message.angular_velocity
        force.x, force.y, force.z = sample.force
        has_rate = all(math.isfinite(value) for value in sample.rate)
        rate.x, rate.y, rate.z = sample.rate if has_rate else (0.0, 0.0, 0.0)
        message.angular_velocity_covariance[0] = 0.0 if has_rate else ABSENT
        self._imu_out.publish(message)

    def _publish_field(self, sample: FieldSample) -> None:
        message = self._field
        set_time(message.header.stamp, sample.stamp)
        field = message.magnetic_field
        field.x, field.y, field.z = sample.field
        self._field_out.publish(message)


def set_time(time: Any, stamp: float) -> None:
    """Put a stamp in seconds into a builtin_interfaces/Time."""
    time.sec, time.nanosec = divmod(round(stamp * 1e9), 1_000_000_000)


def replay(
    node: Node,
    source: SensorSource,
    recording: Recording,
    rate: float,
    between: Callable[[float], None],
    clock: bool = False,
) -> int:
    """Publish a recording under its own stamps, in its own time or `rate` times faster.

    `between` is called with the seconds to wait before the next sample; it may spin or sleep.

    Returns
    -------
    int
        Number of samples published.
    """
    clock_out = node.create_publisher(Clock, "/clock", 10) if clock else None
    shift = max(0.0, FIRST_STAMP - float(min(recording.imu[0, 0], recording.field[0, 0])))
    started: float | None = None
    count = 0
    for sample in recording.samples():
        moved = _moved(sample, shift)
        if started is None:
            started = time.monotonic() - moved.stamp / rate
        between(max(0.0, started + moved.stamp / rate - time.monotonic()))
        if clock_out is not None:
            clock_out.publish(_clock(moved.stamp))
        source.publish(moved)
        count += 1
    return count


def _moved(sample: ImuSample | FieldSample, shift: float) -> ImuSample | FieldSample:
    return sample._replace(stamp=sample.stamp + shift) if shift else sample


def _clock(stamp: float) -> Clock:
    message = Clock()
    set_time(message.clock, stamp)
    return message
