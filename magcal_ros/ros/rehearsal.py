"""Simulated sensors on topics: a replayed recording, or a simulated robot that is turned."""

from __future__ import annotations

import json
import math
import time
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import rclpy
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import Imu, MagneticField
from std_msgs.msg import String
from std_srvs.srv import Trigger

from magcal_ros.core.errors import MagcalError
from magcal_ros.core.geometry.attitude import mean_angle, wrap_angle
from magcal_ros.core.geometry.rotations import rotation_from_quaternion, rpy_from_rotation
from magcal_ros.core.samples.streams import FieldSample, ImuSample
from magcal_ros.core.simulation import Ride, Robot
from magcal_ros.files.recording import Recording
from magcal_ros.files.wire import ABSENT, seconds
from magcal_ros.ros.sensor_frames import LATCHED


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
        """Number of subscriptions, of the topic with fewer."""
        return min(self._imu_out.get_subscription_count(), self._field_out.get_subscription_count())

    def publish(self, sample: ImuSample | FieldSample) -> None:
        """Publish one sample with its own stamp."""
        message = self._imu if isinstance(sample, ImuSample) else self._field
        set_time(message.header.stamp, sample.stamp)
        if isinstance(sample, FieldSample):
            field = message.magnetic_field
            field.x, field.y, field.z = sample.field
            self._field_out.publish(message)
            return
        force, rate = message.linear_acceleration, message.angular_velocity
        force.x, force.y, force.z = sample.force
        has_rate = all(math.isfinite(value) for value in sample.rate)
        rate.x, rate.y, rate.z = sample.rate if has_rate else (0.0, 0.0, 0.0)
        message.angular_velocity_covariance[0] = 0.0 if has_rate else ABSENT
        self._imu_out.publish(message)


def set_time(time: Any, stamp: float) -> None:
    """Set a builtin_interfaces/Time to a stamp in seconds."""
    time.sec, time.nanosec = divmod(round(stamp * 1e9), 1_000_000_000)


def replay(
    node: Node, source: SensorSource, recording: Recording, rate: float, clock: bool = False
) -> int:
    """Publish a recording with its own stamps, `rate` times faster than recorded.

    With `clock`, the stamps are published as simulated time. Returns the number of samples.
    """
    clock_out, message = node.create_publisher(Clock, "/clock", 10) if clock else None, Clock()
    started, count = math.nan, 0
    for count, sample in enumerate(recording.cut(0.0, math.inf).samples(), start=1):
        if count == 1:
            started = time.monotonic() - sample.stamp / rate
        time.sleep(max(0.0, started + sample.stamp / rate - time.monotonic()))
        if clock_out is not None:
            set_time(message.clock, sample.stamp)
            clock_out.publish(message)
        source.publish(sample)
    return count


TURN_RATE, LONGEST_TURN = 0.5, 120.0  # rad/s, and seconds until a calibration is given up
SAMPLES_PER_HEADING = 20

PATIENCE = 30.0  # longest wait for an answer of the node, seconds, on a slow machine

SETTLE = 0.8
"""Simulated seconds until the node's up vector has settled in a new pose."""


class Rehearsal:
    """Simulates a robot in real time and calls the node's services."""

    def __init__(
        self,
        node: Node,
        robot: Robot,
        seed: int = 1,
        speed: float = 1.0,
        calibrator: str = "/calibrator",
        **ride: Any,
    ) -> None:
        self.node, self.robot, self.speed = node, robot, speed
        self.ride = Ride(robot, np.random.default_rng(seed), start=time.time(), **ride)
        self.source = SensorSource(node)
        self.status: dict[str, Any] = {}
        self._calibrator = calibrator
        self._attitudes: Any = None
        self._settled = -math.inf
        self._settled_yaws: list[float] = []
        node.create_subscription(String, f"{calibrator}/status", self._on_status, LATCHED)
        self._executor = rclpy.executors.SingleThreadedExecutor()
        self._executor.add_node(node)

    def _on_status(self, message: String) -> None:
        self.status = json.loads(message.data)

    def _on_attitude(self, message: Imu) -> None:
        if seconds(message.header.stamp) >= self._settled:
            q = message.orientation
            body_to_world = rotation_from_quaternion(q.x, q.y, q.z, q.w)
            assert body_to_world is not None
            self._settled_yaws.append(float(rpy_from_rotation(body_to_world)[2]))

    def wait_for_node(self, patience: float = PATIENCE) -> None:
        """Wait until the node has subscribed to the sensors and published its status."""
        deadline = time.monotonic() + patience
        while not (self.source.listeners and self.status):
            if time.monotonic() > deadline:
                raise MagcalError(f"the node {self._calibrator} did not start in {patience:g} s")
            self._executor.spin_once(timeout_sec=0.05)

    def call(self, service: str) -> Any:
        """Call a service and return the future of its answer."""
        client: Any = self.node.create_client(Trigger, f"{self._calibrator}/{service}")
        if not client.wait_for_service(PATIENCE):
            raise MagcalError(f"the service {self._calibrator}/{service} does not answer")
        return client.call_async(Trigger.Request())

    def answer(self, future: Any) -> Any:
        """Keep the robot at rest until a service has answered; returns the answer."""
        self.run(PATIENCE, stop=future.done)
        if not future.done():
            raise MagcalError("the service did not answer in time")
        return future.result()

    def reset(self) -> None:
        """Reset the node, because it may have loaded a calibration."""
        self.answer(self.call("reset"))

    def run(
        self,
        seconds: float,
        yaw_rate: float | Callable[[], float] = 0.0,
        stop: Callable[[], bool] = lambda: False,
    ) -> None:
        """Run the robot for `seconds` of wall-clock time, or until `stop` returns true.

        `yaw_rate` is a value in rad/s, or a function that is called at each step.
        """
        rate = yaw_rate if callable(yaw_rate) else lambda: yaw_rate
        started = time.monotonic()
        step = self.ride.period / self.speed
        ticks = 0
        while not stop() and time.monotonic() - started < seconds:
            for sample in self.ride.step(rate()):
                self.source.publish(sample)
            ticks += 1
            self._spin_until(started + ticks * step)

    def _spin_until(self, reading: float) -> None:
        while True:
            left = reading - time.monotonic()
            self._executor.spin_once(timeout_sec=max(0.0, left))
            if left <= 0.0:
                return

    def calibrate(
        self,
        show: Callable[[dict[str, Any]], None] = lambda _: None,
        yaw_rate: float = TURN_RATE,
    ) -> Any:
        """Call ~/calibrate and turn the robot until the service answers; returns the answer."""
        future = self.call("calibrate")
        shown = None

        def stop() -> bool:
            nonlocal shown
            progress = self.status.get("progress")
            if progress and progress != shown:
                shown = progress
                show(progress)
            return bool(future.done())

        self.run(LONGEST_TURN, yaw_rate, stop)
        return self.answer(future)

    def published_errors(
        self, tilts: Sequence[tuple[float, float]], headings: int = 24
    ) -> list[float]:
        """Return the errors of the published yaw (radians) at rest, at all headings and tilts.

        Tilts are in degrees. The yaw is from `compass/mag/enu/imu`, whose stamp identifies the pose
        even if the message is late.
        """
        if self._attitudes is None:
            self._attitudes = self.node.create_subscription(
                Imu, "compass/mag/enu/imu", self._on_attitude, 10
            )

        # The robot rests before the pose jumps, because an up vector that has lost messages in a
        # turn does not follow such a jump.
        self._settled_yaw()
        errors = []
        for roll, pitch in tilts:
            for k in range(headings):
                self.ride.stand(math.radians(roll), math.radians(pitch), k * math.tau / headings)
                errors.append(float(wrap_angle(self._settled_yaw() - self.ride.magnetic_yaw)))
        return errors

    def _settled_yaw(self) -> float:
        """Keep the robot at rest until the yaw has settled, and return the mean of the yaws."""
        self._settled, self._settled_yaws = self.ride.stamp + SETTLE, []
        self.run(PATIENCE, stop=lambda: len(self._settled_yaws) >= SAMPLES_PER_HEADING)
        if not self._settled_yaws:
            raise MagcalError("no yaw is published")
        return mean_angle(np.array(self._settled_yaws))
