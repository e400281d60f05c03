"""The robot's description as it comes over the graph."""

import math
import time

import numpy as np
import pytest
import rclpy
from geometry_msgs.msg import TransformStamped
from std_msgs.msg import String
from support import PATIENCE

from magcal_ros.core.geometry.frame_tree import FrameTree
from magcal_ros.core.geometry.rotations import rotation_from_rpy
from magcal_ros.ros.description import LATCHED, Description, joints_from

ROBOT = """<robot name="mule"><joint name="imu" type="fixed"><parent link="base_link"/>
<child link="imu_link"/><origin rpy="0 0 1.5707963267948966"/></joint></robot>"""


def test_a_description_latched_before_the_node_came_is_heard_and_a_damaged_one_said(graph):
    robot, node = rclpy.create_node("state_publisher"), rclpy.create_node("calibrator")
    out = robot.create_publisher(String, "robot_description", LATCHED)
    out.publish(String(data=ROBOT))
    news = []
    description = Description(node, lambda: news.append(True))

    def wait_for(count):
        deadline = time.monotonic() + PATIENCE
        while len(news) < count and time.monotonic() < deadline:
            rclpy.spin_once(node, timeout_sec=0.05)
        assert len(news) == count

    wait_for(1)
    turned = rotation_from_rpy(0.0, 0.0, math.pi / 2)
    assert description.tree.pose("imu_link", "base_link") == pytest.approx(turned)
    out.publish(String(data="<robot>"))
    wait_for(2)
    assert "no XML" in description.trouble
    assert description.tree.pose("imu_link", "base_link") == pytest.approx(turned)
    for each in (robot, node):
        each.destroy_node()


def test_static_transforms_are_fixed_joints():
    transform = TransformStamped(child_frame_id="mag_link")
    transform.header.frame_id = "imu_link"
    transform.transform.rotation.x, transform.transform.rotation.w = 1.0, 0.0
    empty = TransformStamped(child_frame_id="other_link")
    empty.transform.rotation.w = 0.0
    joints = joints_from([transform, empty])
    pose = FrameTree(joints).pose("mag_link", "imu_link")
    assert pose == pytest.approx(np.diag([1.0, -1.0, -1.0]))
    assert len(joints) == 1
