import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from magcal_ros.core.geometry import FIXED, FrameJoint, FrameTree, FrameTreeError, rotation_from_rpy

angles = st.floats(-3.0, 3.0)
poses = st.builds(rotation_from_rpy, angles, angles, angles)


def fixed(parent, child, pose=None):
    return FrameJoint(
        f"{parent}_{child}", FIXED, parent, child, np.eye(3) if pose is None else pose
    )


@given(poses, poses, poses)
def test_poses_along_both_branches_are_chained(base_to_top, top_to_imu, base_to_mast):
    tree = FrameTree(
        [
            fixed("top", "imu", top_to_imu),
            fixed("base", "mast", base_to_mast),
            fixed("base", "top", base_to_top),
        ]
    )
    assert tree.pose("imu", "base") == pytest.approx(base_to_top @ top_to_imu)
    assert tree.pose("mast", "imu") == pytest.approx(
        (base_to_top @ top_to_imu).T @ base_to_mast, abs=1e-12
    )
    assert tree.pose("imu", "mast") == pytest.approx(tree.pose("mast", "imu").T, abs=1e-12)
    assert tree.pose("imu", "imu") == pytest.approx(np.eye(3))


def test_a_joint_that_moves_between_the_frames_is_named():
    tree = FrameTree([FrameJoint("pan", "revolute", "base", "head"), fixed("head", "imu")])
    with pytest.raises(FrameTreeError, match=r"'pan' .* moves \(revolute\).*mount_rpy_deg"):
        tree.pose("imu", "base")


def test_a_joint_that_moves_above_both_frames_does_no_harm():
    turned = rotation_from_rpy(0.0, 0.0, 1.0)
    tree = FrameTree(
        [
            FrameJoint("pan", "continuous", "base", "head"),
            fixed("head", "imu"),
            fixed("head", "mag", turned),
        ]
    )
    assert tree.pose("mag", "imu") == pytest.approx(turned)


def test_a_missing_frame_is_named_with_the_existing_ones():
    tree = FrameTree([fixed("base", "imu_link")])
    with pytest.raises(FrameTreeError, match="no frame 'imu'; it has base, imu_link"):
        tree.pose("imu", "base")
    with pytest.raises(FrameTreeError, match="it has none"):
        FrameTree().pose("imu", "base")


def test_unconnected_frames_are_reported():
    tree = FrameTree([fixed("base", "imu"), fixed("mast", "mag")])
    with pytest.raises(FrameTreeError, match="nothing joins the frames 'mag' and 'base'"):
        tree.pose("mag", "base")


def test_a_cycle_of_frames_is_refused():
    tree = FrameTree([fixed("a", "b"), fixed("b", "a")])
    with pytest.raises(FrameTreeError, match="loop of joints"):
        tree.pose("a", "b")


def test_the_newest_transform_of_a_frame_counts():
    turned = rotation_from_rpy(0.0, 0.0, 1.0)
    tree = FrameTree([fixed("base", "imu")]).with_joints([fixed("base", "imu", turned)])
    assert tree.pose("imu", "base") == pytest.approx(turned)
