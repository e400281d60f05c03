"""How IMU and magnetometer sit on the robot: what was given by hand, else what is described."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from magcal_ros.core.geometry.arrays import FloatArray
from magcal_ros.core.geometry.frame_tree import FrameTree, FrameTrouble
from magcal_ros.core.geometry.rotations import rpy_from_rotation

STEEPEST_GROUND = math.radians(35.0)
"""A base that leans by more at rest does not sit as its description says."""


@dataclass(frozen=True)
class Frames:
    """Names of the three frames; empty where not known yet, or where the base is the IMU."""

    base: str
    imu: str
    magnetometer: str


@dataclass(frozen=True, eq=False)
class SensorPoses:
    """How the sensors sit.

    Parameters
    ----------
    magnetometer : ndarray, shape (3, 3)
        Nominal pose of the magnetometer in the IMU's frame, sensor axes to IMU axes.
    is_described : bool
        Whether the robot's description tells it; otherwise it was given by hand, or is nothing.
    imu : ndarray, shape (3, 3), or None
        Pose of the IMU in the base, IMU axes to base axes; None while it is not known.
    complaints : tuple of str
        What is missing, in words.
    """

    magnetometer: FloatArray
    is_described: bool
    imu: FloatArray | None
    complaints: tuple[str, ...] = ()

    def contradiction(self, up: FloatArray, frames: Frames) -> str:
        """Say that gravity contradicts the description; empty if it does not.

        Parameters
        ----------
        up : ndarray, shape (3,)
            Unit, IMU axes, of a robot that stands.
        frames : Frames
            For the words.
        """
        if self.imu is None:
            return ""
        lean = math.acos(min(1.0, max(-1.0, float(self.imu[2] @ up))))
        if lean < STEEPEST_GROUND:
            return ""
        return (
            f"by the robot's description {frames.base!r} leans by {math.degrees(lean):.0f}° from "
            f"the upright: gravity shows {frames.imu!r} sitting otherwise; mend its joint, or the "
            "axes in the driver"
        )


def sensor_poses(frames: Frames, tree: FrameTree, given: FloatArray | None) -> SensorPoses:
    """Return how the sensors sit.

    Parameters
    ----------
    frames : Frames
        With an empty base the robot's description is not asked, and the base is the IMU.
    tree : FrameTree
        What is described.
    given : ndarray, shape (3, 3), or None
        The magnetometer's pose as given by hand, which wins.
    """
    nothing: FloatArray = np.eye(3)
    if not frames.base:
        return SensorPoses(nothing if given is None else given, False, nothing)
    imu, why_imu = _pose(frames.imu, frames.base, tree)
    if given is not None:
        return SensorPoses(given, False, imu, why_imu)
    sensor, why_sensor = _pose(frames.magnetometer, frames.imu, tree)
    if sensor is None:
        return SensorPoses(nothing, False, imu, why_imu + why_sensor)
    return SensorPoses(sensor, True, imu, why_imu)


def _pose(frame: str, parent: str, tree: FrameTree) -> tuple[FloatArray | None, tuple[str, ...]]:
    """Return the pose, or why there is none; a sensor that has not been heard needs no words."""
    if not (frame and parent):
        return None, ()
    if not tree.frames and frame != parent:
        words = f"nothing has told yet how {frame!r} sits in {parent!r}: no robot_description came"
        return None, (words,)
    if frame == parent:
        return np.eye(3), ()
    try:
        return tree.pose(frame, parent), ()
    except FrameTrouble as trouble:
        return None, (str(trouble),)


def pose_in_words(pose: FloatArray) -> str:
    """Return roll, pitch and yaw in degrees, as a URDF origin has them."""
    roll, pitch, yaw = (math.degrees(angle) for angle in rpy_from_rotation(pose))
    return f"roll {roll:.0f}°, pitch {pitch:.0f}°, yaw {yaw:.0f}°"
