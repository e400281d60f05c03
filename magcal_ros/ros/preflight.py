"""Checks of topics, publishers and samples before a calibration, also used by `doctor`."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.subscription import Subscription
from sensor_msgs.msg import Imu, MagneticField

from magcal_ros.core.errors import MagcalError, UsageError
from magcal_ros.core.geometry.arrays import FloatArray
from magcal_ros.core.geometry.attitude import STANDARD_GRAVITY, usual_size
from magcal_ros.core.geometry.frame_tree import Frames, sensor_poses
from magcal_ros.core.samples.bursts import bursts_in_words
from magcal_ros.core.samples.streams import FieldSample, ImuSample
from magcal_ros.core.samples.units import likely_acceleration_unit, likely_field_unit
from magcal_ros.files.default_paths import identifier
from magcal_ros.files.disk import printable
from magcal_ros.files.wire import FIELD_TYPE, IMU_TYPE
from magcal_ros.ros.sensor_frames import DescriptionListener
from magcal_ros.ros.wire import read_field, read_imu

MOST_FRAMES = 5
"""Number of different frames that are shown."""

FEWEST_STAMPS = 10  # number of stamps needed to detect bursts
SLOWEST_FIELD = 5.0  # hertz, below which a turn of 12 s gives too few samples


@dataclass(eq=False)
class SensorTopic:
    """The messages on the topic of a sensor; without `take` the samples are stored."""

    topic: str
    kind: str
    take: Callable[[ImuSample | FieldSample], None] | None = None
    messages: int = 0
    frame: str = ""  # of the newest message
    frames: set[str] = field(default_factory=set)  # some frames, printable
    samples: list[ImuSample | FieldSample] = field(default_factory=list)

    def listen(self, node: Node) -> Subscription:
        """Subscribe to the topic."""
        message = Imu if self.kind == IMU_TYPE else MagneticField
        quality = QoSProfile(depth=200, reliability=ReliabilityPolicy.BEST_EFFORT)
        return node.create_subscription(message, self.topic, self.note, quality, raw=True)

    def note(self, data: bytes) -> None:
        """Take a message."""
        arrived = read_imu(data) if self.kind == IMU_TYPE else read_field(data)
        self.messages += 1
        self.frame = arrived.frame
        if len(self.frames) < MOST_FRAMES:
            self.frames.add(printable(arrived.frame))
        if arrived.sample is not None:
            (self.take or self.samples.append)(arrived.sample)

    @property
    def size(self) -> float:
        """Median length of the vector, in the unit of the topic; NaN without samples."""
        vectors = [s.force if isinstance(s, ImuSample) else s.field for s in self.samples]
        return usual_size(np.array(vectors)) if vectors else math.nan


class Preflight(NamedTuple):
    """The result of the checks."""

    lines: tuple[str, ...]  # findings for the user
    ready: bool  # whether IMU and field arrive


def inspect(node: Node, calibrator: str, duration: float = 2.0) -> Preflight:
    """Check the sensors of a running calibrator, for `duration` seconds."""
    inputs = _inputs_of(node, calibrator)
    if inputs is None:
        remedy = "start it with `ros2 run magcal_ros calibrator`, or name it with --node"
        return Preflight((f"the node {calibrator} is not running: {remedy}",), False)
    sensors, taken = inputs
    _listen(node, sensors, duration)
    ready = {sensor.kind for sensor in sensors if sensor.messages} == {IMU_TYPE, FIELD_TYPE}
    lines = []
    for sensor in sensors:
        publishers = node.count_publishers(sensor.topic)
        if sensor.messages:
            lines += [_describe(sensor, duration), *_judge(sensor, duration, publishers)]
            continue
        found = set(_of_sensors(node, sensor.kind)) - taken
        lines += _explain_silence(sensor, publishers, [printable(topic) for topic in found])
        if ready:
            lines.append(f"  {printable(sensor.topic)} is silent and is not calibrated")
    return Preflight(tuple(lines), ready)


def _inputs_of(node: Node, calibrator: str) -> tuple[list[SensorTopic], set[str]] | None:
    """Return the sensors of a calibrator, and the topics of all its inputs."""
    namespace, _, name = calibrator.rpartition("/")
    deadline = time.monotonic() + 5.0
    while time.monotonic() < deadline:
        try:
            found = node.get_subscriber_names_and_types_by_node(name, namespace or "/")
        except Exception:  # rclpy raises its own kinds while the node is not discovered yet
            found = []
        imus = [topic for topic, kinds in found if kinds[0] == IMU_TYPE]
        # The topic of known headings has the same type and is optional.
        imus.sort(key=lambda topic: ("heading" in topic, not node.count_publishers(topic)))
        fields = sorted((topic for topic, kinds in found if kinds[0] == FIELD_TYPE), key=len)
        if imus and fields:
            # The topic of a further magnetometer without a publisher is ignored.
            active = [topic for topic in fields if node.count_publishers(topic)] or fields[:1]
            sensors = [
                SensorTopic(imus[0], IMU_TYPE),
                *(SensorTopic(topic, FIELD_TYPE) for topic in active),
            ]
            return sensors, {topic for topic, _ in found}
        time.sleep(0.1)
    return None


def _listen(node: Node, sensors: Sequence[SensorTopic], duration: float) -> None:
    subscriptions = [sensor.listen(node) for sensor in sensors]
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    deadline = time.monotonic() + duration
    while time.monotonic() < deadline:
        executor.spin_once(timeout_sec=0.05)
    executor.remove_node(node)
    for subscription in subscriptions:
        node.destroy_subscription(subscription)


def _describe(sensor: SensorTopic, duration: float) -> str:
    frames = ", ".join(sorted(frame or "(empty)" for frame in sensor.frames))
    size = sensor.size
    measured = f"{size:.2f} m/s²" if sensor.kind == IMU_TYPE else f"{size * 1e6:.1f} µT"
    return f"{sensor.topic}: {sensor.messages / duration:.0f} Hz, frame {frames}, {measured}"


def _judge(sensor: SensorTopic, duration: float, publishers: int) -> list[str]:
    found, stamps = [], [sample.stamp for sample in sensor.samples]
    if stamps and not any(stamps):
        found.append("  stamps are zero: the driver must stamp its messages")
    elif len(stamps) > FEWEST_STAMPS:
        words = bursts_in_words(np.array(stamps))
        found += [f"  {words}"] if words else []
    if publishers > 1:
        found.append(f"  {publishers} publishers on one topic: only one can be the sensor")
    if sensor.kind == IMU_TYPE:
        if not 0.8 < sensor.size / STANDARD_GRAVITY < 1.2:
            unit = likely_acceleration_unit(sensor.size)
            found.append(f"  gravity should read 9.81 m/s² at rest{unit and ': '}{unit}")
        return found
    unit = likely_field_unit(sensor.size)
    found += [f"  {unit}"] if unit else []
    if sensor.messages / duration < SLOWEST_FIELD:
        found.append("  slower than 5 Hz: turn slowly, a full circle in 30 s or more")
    return found


def _explain_silence(sensor: SensorTopic, publishers: int, elsewhere: Sequence[str]) -> list[str]:
    lines = [f"{sensor.topic}: nothing arrives ({publishers} publishers)"]
    if publishers:
        lines.append("  it is advertised: check that the driver runs and the clock is not paused")
    if elsewhere:
        names = ", ".join(sorted(elsewhere))
        lines.append(f"  the same type is published on {names}: remap to it with -r")
    elif not publishers:
        lines.append(
            "  nothing publishes this type: check that the driver runs, with the same ROS_DOMAIN_ID"
        )
    return lines


OURS = ("_unbiased", "_bias", "/enu/imu")  # endings of the topics that a calibrator publishes
DISCOVERY = 3.0  # longest wait for topics, seconds

USUAL = {IMU_TYPE: "imu/data_raw", FIELD_TYPE: "imu/mag"}
"""The default topic, if there are several topics of a type."""


def sensor_topic(node: Node, kind: str, wanted: str, option: str) -> str:
    """Return `wanted`, or the usual topic of a sensor, or the only topic of this type.

    Raises UsageError if several are possible, MagcalError if there is none.
    """
    if wanted:
        return node.resolve_topic_name(wanted)
    usual, deadline = node.resolve_topic_name(USUAL[kind]), time.monotonic() + DISCOVERY
    while True:
        found = _of_sensors(node, kind)
        if usual in found:
            return usual
        if len(found) == 1:
            return found[0]
        if time.monotonic() > deadline:
            break
        time.sleep(0.1)
    if found:
        listed = ", ".join(printable(topic) for topic in sorted(found))
        raise UsageError(f"{len(found)} topics carry {kind}: {listed}; choose one with {option}")
    raise MagcalError(
        f"no topic carries {kind}: check that the driver runs, and that ROS_DOMAIN_ID and the "
        "discovery range are the same on both sides"
    )


def _of_sensors(node: Node, kind: str) -> list[str]:
    """Return the published topics of a type, without those of a calibrator."""
    return [
        topic
        for topic, kinds in node.get_topic_names_and_types()
        if kind in kinds and not topic.endswith(OURS) and node.count_publishers(topic)
    ]


class Listener:
    """Subscribes to both sensors and passes their samples to `take`."""

    def __init__(
        self,
        node: Node,
        imu_topic: str,
        field_topic: str,
        take: Callable[[ImuSample | FieldSample], None],
    ) -> None:
        self._node = node
        self.sensors = (
            SensorTopic(imu_topic, IMU_TYPE, take),
            SensorTopic(field_topic, FIELD_TYPE, take),
        )
        for sensor in self.sensors:
            sensor.listen(node)
        self._description = DescriptionListener(node, lambda: None)
        self._description.listen()

    @property
    def several_publishers(self) -> list[str]:
        """The topics with more than one publisher, in words."""
        several = []
        for sensor in self.sensors:
            infos = self._node.get_publishers_info_by_topic(sensor.topic)
            if len(infos) > 1:
                names = ", ".join(printable(name) for name in sorted({i.node_name for i in infos}))
                several.append(f"{len(infos)} publishers on {printable(sensor.topic)}: {names}")
        return several

    @property
    def described_pose(self) -> FloatArray | None:
        """The magnetometer's pose in the IMU frame by the robot's description, if known."""
        imu, field = (identifier(sensor.frame) for sensor in self.sensors)
        poses = sensor_poses(Frames(imu, imu, field), self._description.tree, None)
        return poses.magnetometer if poses.is_described and imu != field else None
