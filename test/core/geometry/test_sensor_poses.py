import math

import numpy as np
import pytest

from magcal_ros.core.geometry import (
    FIXED,
    FrameJoint,
    Frames,
    FrameTree,
    pose_in_words,
    rotation_from_rpy,
    sensor_poses,
)

FRAMES = Frames("base_link", "imu_link", "mag_link")
SIDEWAYS = rotation_from_rpy(0.0, 0.0, math.pi / 2)
NED = rotation_from_rpy(math.pi, 0.0, 0.0)
TREE = FrameTree(
    [
        FrameJoint("imu", FIXED, "base_link", "imu_link", SIDEWAYS),
        FrameJoint("mag", FIXED, "imu_link", "mag_link", NED),
    ]
)


def test_a_description_gives_both_poses():
    poses = sensor_poses(FRAMES, TREE, None)
    assert poses.is_described
    assert poses.magnetometer == pytest.approx(NED)
    assert poses.imu == pytest.approx(SIDEWAYS)
    assert poses.complaints == ()


def test_a_given_pose_has_priority():
    by_hand = rotation_from_rpy(0.1, 0.2, 0.3)
    poses = sensor_poses(FRAMES, TREE, by_hand)
    assert not poses.is_described
    assert poses.magnetometer == pytest.approx(by_hand)
    assert poses.imu == pytest.approx(SIDEWAYS)


def test_without_a_base_nothing_is_asked_of_the_description():
    poses = sensor_poses(Frames("", "imu_link", "mag_link"), TREE, None)
    assert poses.magnetometer == pytest.approx(np.eye(3))
    assert poses.imu == pytest.approx(np.eye(3))
    assert poses.complaints == ()


def test_a_base_missing_in_the_description_is_reported():
    poses = sensor_poses(FRAMES, FrameTree(), None)
    assert poses.imu is None
    assert "pose of 'imu_link' in 'base_link' is unknown" in poses.complaints[0]
    assert sensor_poses(Frames("chassis", "imu_link", ""), TREE, None).imu is None


def test_a_base_that_is_the_imu_needs_no_description():
    poses = sensor_poses(Frames("imu_link", "imu_link", "imu_link"), FrameTree(), None)
    assert poses.imu == pytest.approx(np.eye(3))
    assert poses.complaints == ()


def test_a_sensor_without_messages_is_no_error():
    assert sensor_poses(Frames("base_link", "", ""), TREE, None).complaints == ()


def test_gravity_contradicts_a_base_that_lies_on_its_side_and_not_one_on_a_ramp():
    poses = sensor_poses(FRAMES, TREE, None)
    for roll in (0.0, math.radians(20.0)):
        assert poses.contradiction(rotation_from_rpy(roll, 0.0).T[:, 2], FRAMES) == ""
    words = poses.contradiction(np.array([1.0, 0.0, 0.0]), FRAMES)
    assert "'base_link' would be tilted by 90°" in words
    assert "imu_link" in words


def test_a_pose_is_written_like_a_urdf_origin():
    assert pose_in_words(rotation_from_rpy(0.0, math.radians(-10.0), math.pi / 2)) == (
        "roll 0°, pitch -10°, yaw 90°"
    )
