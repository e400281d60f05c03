"""The robot's description, received by topic."""

import math
import time

import numpy as np
import pytest
import rclpy
from geometry_msgs.msg import TransformStamped
from rclpy.executors import SingleThreadedExecutor
from rclpy.serialization import serialize_message
from std_msgs.msg import String
from support import PATIENCE, wait_until

from magcal_ros.core.geometry import FrameTree, FrameTreeError, rotation_from_rpy
from magcal_ros.files import LARGEST, RobotDescriptionError, identifier, joints_of
from magcal_ros.ros.sensor_frames import LATCHED, DescriptionListener, joints_from

ROBOT = """<robot name="mule"><joint name="imu" type="fixed"><parent link="base_link"/>
<child link="imu_link"/><origin rpy="0 0 1.5707963267948966"/></joint></robot>"""


def test_a_latched_description_is_used_and_a_damaged_one_reported(graph):
    robot, node = rclpy.create_node("state_publisher"), rclpy.create_node("calibrator")
    out = robot.create_publisher(String, "robot_description", LATCHED)
    out.publish(String(data=ROBOT))
    news = []
    description = DescriptionListener(node, lambda: news.append(True))
    executor = SingleThreadedExecutor()
    executor.add_node(node)

    def wait_for(count):
        deadline = time.monotonic() + PATIENCE
        while len(news) < count and time.monotonic() < deadline:
            executor.spin_once(timeout_sec=0.05)
        assert len(news) == count

    assert not node.count_subscribers("robot_description"), "nobody has asked for it"
    description.listen()
    wait_for(1)
    turned = rotation_from_rpy(0.0, 0.0, math.pi / 2)
    assert description.tree.pose("imu_link", "base_link") == pytest.approx(turned)
    out.publish(String(data="<robot>"))
    wait_for(2)
    assert "not XML" in description.problem
    assert description.tree.pose("imu_link", "base_link") == pytest.approx(turned)
    out.publish(String(data="<robot>" + LARGEST * " "))
    wait_for(3)
    assert description.problem.startswith("robot_description has messages above 4000000 bytes")
    out.publish(String(data=ROBOT))
    wait_for(4)
    assert description.problem == ""
    for each in (robot, node):
        each.destroy_node()


JOINT = '<joint name="{0}" type="fixed"><parent link="base"/><child link="{0}"/></joint>'


def test_the_largest_description_delays_no_callback(graph):
    node, longest, news = rclpy.create_node("calibrator"), 0.0, []
    description = DescriptionListener(node, lambda: news.append(True))
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    joints = "".join(JOINT.format(f"{number:05}") for number in range(20_000))
    data = serialize_message(String(data=f"<robot>{joints}</robot>"))
    assert 1_000_000 < len(data) < LARGEST
    description._take("robot_description", String, lambda m: joints_of(m.data), data)
    deadline = time.monotonic() + PATIENCE
    while not news and time.monotonic() < deadline:
        began = time.monotonic()
        executor.spin_once(timeout_sec=0.01)
        longest = max(longest, time.monotonic() - began)
    assert longest < 0.3
    assert "more than 10000 frames" in description.problem
    assert not description.tree.frames
    node.destroy_node()


def test_unreadable_and_too_frequent_descriptions_are_reported(graph):
    node = rclpy.create_node("calibrator")
    description = DescriptionListener(node, lambda: None)

    def take(data):
        description._take("robot_description", String, lambda m: joints_of(m.data), data)

    take(b"no message")
    wait_until(lambda: description.tree is not None and description.problem)
    assert "not a String" in description.problem
    for _ in range(5):
        take(serialize_message(String(data=LARGEST // 4 * " ")))
    assert "messages above 4000000 bytes" in description.problem
    wait_until(lambda: description.tree is not None and "not XML" in description.problem)
    node.destroy_node()


def test_long_names_are_cut_and_still_found(graph):
    name = 1000 * "imu" + "1"
    joints = joints_of(f"<robot>{JOINT.format(name)}{JOINT.format(name[:-1] + '2')}</robot>")
    tree = FrameTree(joints)
    assert tree.pose(identifier(name), "base") == pytest.approx(np.eye(3))
    with pytest.raises(FrameTreeError) as caught:
        tree.pose("gyro", "base")
    assert len(str(caught.value)) < 1000
    with pytest.raises(RobotDescriptionError) as caught:
        joints_of(f"<robot>{JOINT.format(name).replace('fixed', 5000 * 'x')}</robot>")
    assert len(str(caught.value)) < 1000


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
