"""The poses of the sensors on the robot, from the parameters or the robot's description."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from geometry_msgs.msg import TransformStamped
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from std_msgs.msg import String

from magcal_ros.core.calibrate import Outcome
from magcal_ros.core.calibration.calibration import Calibration
from magcal_ros.core.errors import in_words
from magcal_ros.core.geometry.frame_tree import (
    FIXED,
    FrameJoint,
    Frames,
    FrameTree,
    SensorPoses,
    pose_in_words,
    sensor_poses,
)
from magcal_ros.core.geometry.rotations import (
    rotation_angle,
    rotation_from_quaternion,
    rotation_from_rpy,
)
from magcal_ros.core.heading.base_heading import BaseHeading, VehicleYaw, corrected_pose
from magcal_ros.core.knowledge import Mounting, Z
from magcal_ros.core.up.follower import UpFollower
from magcal_ros.files.default_paths import identifier
from magcal_ros.files.robot_description import LARGEST, joints_of
from magcal_ros.ros.parameters import Settings
from magcal_ros.ros.threads import BackgroundThread
from magcal_ros.ros.wire import by_rclpy, optional_type

LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
STATIC_TRANSFORMS = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)

MOST_FRAMES = 10_000  # frames that are kept; a humanoid with hands has a few hundred


class DescriptionListener:
    """Keeps the joints of `robot_description` and the static transforms after `listen` is called.

    Messages from the network may have any size. They are parsed in a background thread, at most
    `LARGEST` bytes at a time.
    """

    def __init__(self, node: Node, changed: Callable[[], None]) -> None:
        self._node, self._changed = node, changed
        self._thread = BackgroundThread(node, "magcal-description")
        self._tree = FrameTree()
        self._unread = 0
        self._is_listening = False
        self.problem = ""  # why the newest description could not be read; or empty

    @property
    def tree(self) -> FrameTree:
        """The frames and joints that are described."""
        self._thread.deliver()
        return self._tree

    def listen(self) -> None:
        """Subscribe to the description."""
        if self._is_listening:
            return
        self._is_listening = True
        read = partial(self._take, "robot_description", String, lambda found: joints_of(found.data))
        self._node.create_subscription(String, "robot_description", read, LATCHED, raw=True)
        kind, topic = optional_type("tf2_msgs", "TFMessage"), "/tf_static"
        if kind is not None:
            read = partial(self._take, topic, kind, lambda found: joints_from(found.transforms))
            self._node.create_subscription(kind, topic, read, STATIC_TRANSFORMS, raw=True)

    def _take(
        self, topic: str, kind: type, joints_in: Callable[[Any], Iterable[FrameJoint]], data: bytes
    ) -> None:
        if self._unread + len(data) > LARGEST:
            self._complain(f"{topic} has messages above {LARGEST} bytes and is not read")
            return
        self._unread += len(data)

        def keep(joints: Iterable[FrameJoint]) -> None:
            self._unread -= len(data)
            tree = self._tree.with_joints(joints)
            if len(tree.frames) > MOST_FRAMES:
                self._complain(f"{topic} has more than {MOST_FRAMES} frames and is not used")
                return
            self._tree, self.problem = tree, ""
            self._changed()

        def fail(error: Exception) -> None:
            self._unread -= len(data)
            self._complain(in_words(error))

        self._thread.run(lambda: list(joints_in(by_rclpy(data, kind))), keep, fail)

    def _complain(self, problem: str) -> None:
        self.problem = problem
        self._changed()


def joints_from(transforms: Iterable[TransformStamped]) -> list[FrameJoint]:
    """Return static transforms as fixed joints; one without a rotation is left out."""
    joints = []
    for transform in transforms:
        parent, child = identifier(transform.header.frame_id), identifier(transform.child_frame_id)
        turn = transform.transform.rotation
        pose = rotation_from_quaternion(turn.x, turn.y, turn.z, turn.w)
        if pose is not None:
            joints.append(FrameJoint(f"{parent} to {child}", FIXED, parent, child, pose))
    return joints


DOUBTED_ANGLE = 0.26
"""Angle between described and estimated pose from which there is a warning, radians (15°)."""


class SensorFrames:
    """The poses of magnetometers and IMU, and the frame in which attitudes are published."""

    def __init__(self, node: Node, settings: Callable[[], Settings]) -> None:
        self._settings = settings
        self._description = DescriptionListener(node, self._look)
        self._imu_frame = self._magnetometer_frame = ""
        self._vehicle_yaw: VehicleYaw | None = None
        self._look()

    def note_sensors(self, imu_frame: str, magnetometer_frame: str) -> bool:
        """Take the frames in the messages; returns whether there were other frames."""
        before = self._imu_frame, self._magnetometer_frame
        present = identifier(imu_frame), identifier(magnetometer_frame)
        self._imu_frame, self._magnetometer_frame = present
        self._look()
        return before not in (("", ""), present)

    @property
    def view(self) -> BaseHeading | None:
        """Converts the IMU's attitude to the base's; None while the IMU's pose is not known."""
        self._follow_parameters()
        return self._view

    def frame(self, imu_frame: str) -> str:
        """Return the frame in which attitudes are published."""
        return self._settings().base_frame or imu_frame

    def mounting(self, number: int = 1, frame: str = "") -> Mounting:
        """Return the given or described mounting of a magnetometer in the IMU frame."""
        pose, settings = self._poses_of(number, frame).magnetometer, self._settings()
        # The given gains are of the first magnetometer only.
        known = settings.knowledge.mounting if number == 1 else Mounting()
        vehicle = (self._view or BaseHeading(np.eye(3))).pose
        front = vehicle[0]
        if not settings.base_frame and settings.vehicle_yaw is not None:
            front = rotation_from_rpy(0.0, 0.0, settings.vehicle_yaw)[0]
        # Gravity is more reliable than a description.
        upward = Z if self._contradiction else vehicle[2]
        return replace(known, pose=pose, forward=front, upward=upward)

    def doubt(self, number: int, frame: str, calibration: Calibration) -> str:
        """Return in words that a calibration contradicts the pose of its magnetometer.

        Empty if it does not, or if the pose is neither given nor described. A calibration from
        before a pose was corrected keeps the old one.
        """
        poses = self._poses_of(number, frame)
        if not (poses.is_described or number in self._settings().mounts):
            return ""
        left, _, right = np.linalg.svd(calibration.correction.matrix)
        angle = rotation_angle(poses.magnetometer.T @ left @ right)
        if angle <= DOUBTED_ANGLE:
            return ""
        return (
            f"in the calibration in force the magnetometer {identifier(frame)!r} is turned by "
            f"{np.degrees(angle):.0f}° against the given or described pose "
            f"({pose_in_words(poses.magnetometer)}): if this pose is right, calibrate again"
        )

    def _poses_of(self, number: int, frame: str) -> SensorPoses:
        self._follow_parameters()
        if number == 1:
            return self._poses
        frames, given = replace(self._frames, magnetometer=frame), self._settings().mounts
        return sensor_poses(frames, self._description.tree, given.get(number))

    def follow(
        self, follower: UpFollower, outcome: Outcome | None, yaw: VehicleYaw | None
    ) -> list[str]:
        """Compare the description with measurements, once a second.

        These are gravity at rest, the installation by the last turn, and the yaw of the IMU in the
        vehicle that was estimated while driving. Returns the missing poses and the contradictions
        in words.
        """
        if yaw != self._vehicle_yaw:
            self._vehicle_yaw = yaw
            self._look()
        self._follow_parameters()
        poses, up = self._poses, follower.newest
        if follower.is_at_rest and up is not None:
            self._contradiction = poses.contradiction(np.array(up), self._frames)
        words = [*poses.complaints, self._contradiction, self._against_drive]
        if self._frames.base:
            words.append(self._description.problem)
        estimate = None if outcome is None else outcome.estimate
        found = None if estimate is None else estimate.installation
        if poses.is_described and found is not None and found.angle > DOUBTED_ANGLE:
            words.append(
                f"the robot's description has {self._magnetometer_frame!r} in {self._imu_frame!r} "
                f"at {pose_in_words(poses.magnetometer)}, but the pose by the last turn is "
                f"{np.degrees(found.angle):.0f}° away from this: correct the joint, or give "
                "mount_rpy_deg"
            )
        return [each for each in words if each]

    @property
    def _frames(self) -> Frames:
        return Frames(
            identifier(self._settings().base_frame), self._imu_frame, self._magnetometer_frame
        )

    def _follow_parameters(self) -> None:
        if self._settings() is not self._used:
            self._look()

    def _look(self) -> None:
        settings = self._used = self._settings()
        if settings.base_frame:
            self._description.listen()
        given = settings.mounts.get(1)
        self._poses = sensor_poses(self._frames, self._description.tree, given)
        self._contradiction = ""
        imu = self._poses.imu
        described = imu if settings.base_frame else None
        found = corrected_pose(described, settings.vehicle_yaw, self._vehicle_yaw)
        corrected, self._against_drive = found
        pose = imu if corrected is None else corrected
        self._view = None if pose is None else BaseHeading(pose)
