"""Listens to the two sensors for `magcal doctor`: messages, publishers, frames."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import Imu, MagneticField

from magcal_ros.core.errors import MagcalError, Misuse
from magcal_ros.core.geometry.arrays import FloatArray
from magcal_ros.core.geometry.frame_tree import FrameTrouble
from magcal_ros.core.messages import field_sample, imu_sample
from magcal_ros.core.samples.streams import FieldSample, ImuSample
from magcal_ros.files.default_paths import known_as
from magcal_ros.files.plain import plain
from magcal_ros.ros.description import Description
from magcal_ros.ros.preflight import FIELD_TYPE, IMU_TYPE

OURS = ("/mag_unbiased", "/mag_bias", "/compass/mag/enu/imu", "/compass/true/enu/imu")
"""How topics end that a calibrator makes of the sensors'."""

USUAL = {IMU_TYPE: "imu/data_raw", FIELD_TYPE: "imu/mag"}
"""Which of several topics of a type is meant."""


def sensor_topic(node: Node, kind: str, wanted: str, option: str) -> str:
    """Return the topic of a sensor: as wanted, else the only one of this type, or the usual one.

    Raises
    ------
    Misuse
        If several would do.
    MagcalError
        If there is none.
    """
    if wanted:
        return node.resolve_topic_name(wanted)
    usual = node.resolve_topic_name(USUAL[kind])
    found = [
        topic
        for topic, kinds in node.get_topic_names_and_types()
        if kind in kinds and not topic.endswith(OURS)
    ]
    if usual in found:
        return usual
    if len(found) == 1:
        return found[0]
    if found:
        listed = ", ".join(plain(topic) for topic in sorted(found))
        raise Misuse(f"{len(found)} topics carry {kind}: {listed}; choose one with {option}")
    raise MagcalError(
        f"no topic carries {kind}: is the driver running? Look at ROS_DOMAIN_ID and at the "
        "discovery range on both sides"
    )


class Listener:
    """Subscribes to both sensors and hands on what they say.

    Attributes
    ----------
    heard : list of int
        Messages of the IMU and of the field.
    """

    def __init__(
        self,
        node: Node,
        imu_topic: str,
        field_topic: str,
        take: Callable[[ImuSample | FieldSample], None],
    ) -> None:
        self._node, self._take = node, take
        self.topics = (imu_topic, field_topic)
        self.heard = [0, 0]
        self._frames = ["", ""]
        quality = QoSProfile(depth=200, reliability=ReliabilityPolicy.BEST_EFFORT)
        node.create_subscription(Imu, imu_topic, self._on_imu, quality)
        node.create_subscription(MagneticField, field_topic, self._on_field, quality)
        self._description = Description(node, lambda: None)
        self._description.listen()

    @property
    def crowded(self) -> list[str]:
        """The topics on which more than one node publishes, in words."""
        said = []
        for topic in self.topics:
            infos = self._node.get_publishers_info_by_topic(topic)
            if len(infos) > 1:
                names = ", ".join(plain(name) for name in sorted({i.node_name for i in infos}))
                said.append(f"{len(infos)} publishers on {plain(topic)}: {names}")
        return said

    @property
    def frames(self) -> tuple[str, str]:
        """`frame_id` of IMU and magnetometer, fit to be shown; empty while unknown."""
        imu, field = self._frames
        return plain(imu), plain(field)

    @property
    def described_pose(self) -> FloatArray | None:
        """The magnetometer's pose in the IMU by the robot's description; None if untold."""
        imu, field = map(known_as, self._frames)
        tree = self._description.tree
        if not imu or not field or imu == field or field not in tree.frames:
            return None
        try:
            return tree.pose(field, imu)
        except FrameTrouble:
            return None

    def _on_imu(self, message: Any) -> None:
        self.heard[0] += 1
        self._frames[0] = message.header.frame_id
        sample = imu_sample(message)
        if sample is not None:
            self._take(sample)

    def _on_field(self, message: Any) -> None:
        self.heard[1] += 1
        self._frames[1] = message.header.frame_id
        self._take(field_sample(message))
