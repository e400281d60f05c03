"""The fixed transforms between a robot's frames, and the poses of its sensors."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np

from magcal_ros.core.errors import MagcalError
from magcal_ros.core.geometry.arrays import FloatArray, freeze
from magcal_ros.core.geometry.attitude import angle_between
from magcal_ros.core.geometry.rotations import rpy_from_rotation

FIXED = "fixed"  # the kind of joint that does not move, by its name in URDF


class FrameTreeError(MagcalError):
    """The pose of one frame in another is unknown; the text says what to do next."""


@dataclass(frozen=True, eq=False)
class FrameJoint:
    """One frame in another."""

    name: str
    kind: str  # `FIXED`, or a kind of joint that moves
    parent: str
    child: str
    """Frames."""
    pose: FloatArray = field(default_factory=lambda: np.eye(3))
    """Rotation from the child's axes to the parent's. Shape (3, 3)."""

    def __post_init__(self) -> None:
        freeze(self, pose=(3, 3))


class FrameTree:
    """Frames and the joints between them; a later joint of a frame replaces an earlier one."""

    def __init__(self, joints: Iterable[FrameJoint] = ()) -> None:
        self._above = {joint.child: joint for joint in joints}

    @property
    def frames(self) -> frozenset[str]:
        """Names of all frames."""
        return frozenset(self._above) | {joint.parent for joint in self._above.values()}

    def with_joints(self, joints: Iterable[FrameJoint]) -> FrameTree:
        """Return the tree with more joints, or with other ones for the same frames."""
        return FrameTree([*self._above.values(), *joints])

    def pose(self, frame: str, parent: str) -> FloatArray:
        """Return the rotation (3, 3) from the axes of `frame` to those of `parent`.

        `parent` need not be above `frame`. Raises `FrameTreeError` if one of them is missing, if
        nothing joins them, or if a joint between them moves.
        """
        for name in (frame, parent):
            if name not in self.frames:
                raise FrameTreeError(
                    f"the robot's description has no frame {name!r}; it has {_some(self.frames)}"
                )
        below, above = self._upwards(frame), self._upwards(parent)
        if not {frame, *(j.parent for j in below)} & {parent, *(j.parent for j in above)}:
            raise FrameTreeError(
                f"nothing joins the frames {frame!r} and {parent!r} in the robot's description"
            )
        while below and above and below[-1] is above[-1]:
            del below[-1], above[-1]
        return np.asarray(_climbed(above).T @ _climbed(below))

    def _upwards(self, frame: str) -> list[FrameJoint]:
        """Return the joints from a frame to its root; a cycle is refused."""
        joints, seen = [], {frame}
        while (joint := self._above.get(frame)) is not None:
            joints.append(joint)
            frame = joint.parent
            if frame in seen:
                raise FrameTreeError(
                    f"the robot's description has a loop of joints through the frame {frame!r}"
                )
            seen.add(frame)
        return joints


def _climbed(joints: list[FrameJoint]) -> FloatArray:
    """Return the pose (3, 3) of the first joint's child in the last joint's parent."""
    pose: FloatArray = np.eye(3)
    for joint in joints:
        if joint.kind != FIXED:
            raise FrameTreeError(
                f"the joint {joint.name!r} between {joint.parent!r} and {joint.child!r} moves "
                f"({joint.kind}), so the sensors' pose is not known; give mount_rpy_deg by hand"
            )
        pose = joint.pose @ pose
    return pose


def _some(frames: frozenset[str]) -> str:
    """Return the first names, and how many more there are."""
    most = 12
    rest = len(frames) - most
    return ", ".join(sorted(frames)[:most] or ["none"]) + (f" and {rest} more" if rest > 0 else "")


STEEPEST_GROUND = math.radians(35.0)
"""Radians of tilt at rest beyond which gravity contradicts the description."""


@dataclass(frozen=True)
class Frames:
    """Names of the three frames; empty if not known yet, or if the base is the IMU."""

    base: str
    imu: str
    magnetometer: str


@dataclass(frozen=True, eq=False)
class SensorPoses:
    """Poses of the sensors."""

    magnetometer: FloatArray
    """Nominal pose of the magnetometer, sensor axes to IMU axes. Shape (3, 3)."""
    is_described: bool
    """Whether the magnetometer's pose is from the robot's description, not given by hand."""
    imu: FloatArray | None
    """Pose of the IMU, IMU axes to base axes; None while it is not known. Shape (3, 3)."""
    complaints: tuple[str, ...] = ()  # what is missing

    def contradiction(self, up: FloatArray, frames: Frames) -> str:
        """Return the warning that gravity contradicts the description; empty if it does not.

        `up` (3,) is the unit vector at rest, IMU axes; `frames` are used in the text.
        """
        if self.imu is None:
            return ""
        lean = angle_between(self.imu[2], up)
        if lean < STEEPEST_GROUND:
            return ""
        return (
            f"by gravity and the robot's description {frames.base!r} would be tilted by "
            f"{math.degrees(lean):.0f}° at rest: correct the joint of {frames.imu!r}, or the axes "
            "in the driver"
        )


def sensor_poses(frames: Frames, tree: FrameTree, given: FloatArray | None) -> SensorPoses:
    """Return the poses of the sensors.

    With an empty base the robot's description is not used, and the base is the IMU. `given` (3, 3)
    is the magnetometer's pose as given by hand; it replaces the described one.
    """
    nothing: FloatArray = np.eye(3)
    if not frames.base:
        return SensorPoses(nothing if given is None else given, False, nothing)
    imu, why = _pose(frames.imu, frames.base, tree)
    if given is not None:
        return SensorPoses(given, False, imu, why)
    sensor, more = _pose(frames.magnetometer, frames.imu, tree)
    return SensorPoses(nothing if sensor is None else sensor, sensor is not None, imu, why + more)


def _pose(frame: str, parent: str, tree: FrameTree) -> tuple[FloatArray | None, tuple[str, ...]]:
    """Return the pose, or why there is none; no reason if a frame is not known yet."""
    if not (frame and parent):
        return None, ()
    if frame == parent:
        return np.eye(3), ()
    words = f"the pose of {frame!r} in {parent!r} is unknown: no robot_description came"
    try:
        return (tree.pose(frame, parent), ()) if tree.frames else (None, (words,))
    except FrameTreeError as problem:
        return None, (str(problem),)


def pose_in_words(pose: FloatArray) -> str:
    """Return roll, pitch and yaw in degrees, as a URDF origin has them."""
    roll, pitch, yaw = (math.degrees(angle) for angle in rpy_from_rotation(pose))
    return f"roll {roll:.0f}°, pitch {pitch:.0f}°, yaw {yaw:.0f}°"
