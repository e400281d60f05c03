"""Receives the transforms between the robot's frames from the graph."""

from __future__ import annotations

import importlib
from collections.abc import Callable, Iterable
from functools import partial
from typing import Any

from geometry_msgs.msg import TransformStamped
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from std_msgs.msg import String

from magcal_ros.core.errors import in_words
from magcal_ros.core.geometry.frame_tree import FIXED, FrameJoint, FrameTree
from magcal_ros.core.geometry.rotations import rotation_from_quaternion
from magcal_ros.files.default_paths import known_as
from magcal_ros.files.robot_description import LARGEST, joints_of
from magcal_ros.ros.background_thread import BackgroundThread
from magcal_ros.ros.wire.incoming import by_rclpy

LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
STATIC_TRANSFORMS = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)

MOST_FRAMES = 10_000
"""Frames that are kept; a humanoid with hands has a few hundred."""


class Description:
    """Keeps what `robot_description` and the static transforms tell, once somebody asks for it.

    Both are whatever the network sends. They are read in a thread of their own, and no more than
    `LARGEST` bytes at a time.
    """

    def __init__(self, node: Node, changed: Callable[[], None]) -> None:
        self._node, self._changed = node, changed
        self._thread = BackgroundThread(node, "magcal-description")
        self._tree = FrameTree()
        self._unread = 0
        self._is_listening = False
        self.trouble = ""
        """Why the newest description could not be read; empty if it could."""

    @property
    def tree(self) -> FrameTree:
        """What is described."""
        self._thread.deliver()
        return self._tree

    def listen(self) -> None:
        """Hear what is described from now on."""
        if self._is_listening:
            return
        self._is_listening = True
        kinds: list[tuple[type, str, QoSProfile, Callable[[Any], Iterable[FrameJoint]]]] = [
            (String, "robot_description", LATCHED, lambda message: joints_of(message.data))
        ]
        transforms = _transform_message()
        if transforms is not None:
            static = transforms, "/tf_static", STATIC_TRANSFORMS
            kinds.append((*static, lambda message: joints_from(message.transforms)))
        for kind, topic, quality, joints_in in kinds:
            take = partial(self._take, topic, kind, joints_in)
            self._node.create_subscription(kind, topic, take, quality, raw=True)

    def _take(
        self,
        topic: str,
        kind: type,
        joints_in: Callable[[Any], Iterable[FrameJoint]],
        data: bytes,
    ) -> None:
        if self._unread + len(data) > LARGEST:
            self._complain(f"{topic} brings more than {LARGEST} bytes at a time, and is not read")
            return
        self._unread += len(data)

        def keep(joints: Iterable[FrameJoint]) -> None:
            self._unread -= len(data)
            tree = self._tree.with_joints(joints)
            if len(tree.frames) > MOST_FRAMES:
                self._complain(f"{topic} names more than {MOST_FRAMES} frames, and is not used")
                return
            self._tree, self.trouble = tree, ""
            self._changed()

        def fail(error: Exception) -> None:
            self._unread -= len(data)
            self._complain(in_words(error))

        self._thread.run(lambda: list(joints_in(by_rclpy(data, kind))), keep, fail)

    def _complain(self, trouble: str) -> None:
        self.trouble = trouble
        self._changed()


def joints_from(transforms: Iterable[TransformStamped]) -> list[FrameJoint]:
    """Return static transforms as fixed joints; one without a rotation is left out."""
    joints = []
    for transform in transforms:
        parent, child = known_as(transform.header.frame_id), known_as(transform.child_frame_id)
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
