"""Hears from the graph how the robot's frames sit in one another."""

from __future__ import annotations

import importlib
from collections.abc import Callable, Iterable
from typing import Any

from geometry_msgs.msg import TransformStamped
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from std_msgs.msg import String

from magcal_ros.core.geometry.frame_tree import FIXED, FrameJoint, FrameTree
from magcal_ros.core.geometry.rotations import rotation_from_quaternion
from magcal_ros.files.robot_description import DescriptionTrouble, joints_of

LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
STATIC_TRANSFORMS = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)


class Description:
    """Keeps what `robot_description` and the static transforms tell.

    Parameters
    ----------
    node : rclpy.node.Node
        Where the subscriptions live.
    changed : callable
        Called when there is something new.
    """

    def __init__(self, node: Node, changed: Callable[[], None]) -> None:
        self._changed = changed
        self.tree = FrameTree()
        self.trouble = ""
        """Why the newest description could not be read; empty if it could."""
        node.create_subscription(String, "robot_description", self._on_description, LATCHED)
        kind = _transform_message()
        if kind is not None:
            node.create_subscription(kind, "/tf_static", self._on_transforms, STATIC_TRANSFORMS)

    def _on_description(self, message: String) -> None:
        try:
            self.tree, self.trouble = self.tree.with_joints(joints_of(message.data)), ""
        except DescriptionTrouble as trouble:
            self.trouble = str(trouble)
        self._changed()

    def _on_transforms(self, message: Any) -> None:
        self.tree = self.tree.with_joints(joints_from(message.transforms))
        self._changed()


def joints_from(transforms: Iterable[TransformStamped]) -> list[FrameJoint]:
    """Return static transforms as fixed joints; one without a rotation is left out."""
    joints = []
    for transform in transforms:
        parent, child = transform.header.frame_id, transform.child_frame_id
        turn = transform.transform.rotation
        pose = rotation_from_quaternion(turn.x, turn.y, turn.z, turn.w)
        if pose is not None:
            joints.append(FrameJoint(f"{parent} to {child}", FIXED, parent, child, pose))
    return joints


def _transform_message() -> type | None:
    """Return the message of /tf_static where tf2 is installed."""
    try:
        importlib.import_module("tf2_ros")
        kind: type = importlib.import_module("tf2_msgs.msg").TFMessage
    except ImportError:
        return None
    return kind
