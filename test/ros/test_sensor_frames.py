"""A robot with a sideways IMU and an upside-down magnetometer, described by its URDF."""

import math
import re
from dataclasses import replace

import pytest
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.parameter import Parameter
from sensor_msgs.msg import Imu
from std_msgs.msg import String
from support import PATIENCE, REFERENCE, ROBOT, rms_deg

from magcal_ros.core import Mounting
from magcal_ros.core.geometry import rotation_from_rpy, wrap_angle
from magcal_ros.ros.sensor_frames import LATCHED

DESCRIBED = {**REFERENCE, "base_frame": "base_link"}
UPSIDE_DOWN = replace(ROBOT, mounting=Mounting(pose=rotation_from_rpy(math.pi, 0.0, 0.0)))
QUARTER = math.pi / 2.0
ORIGIN = "3.141592653589793 0 0"


def describe(actor, magnetometer=ORIGIN, imu="0 0 1.5707963267948966"):
    """Publish a description as robot_state_publisher does."""
    text = f"""<robot name="mule">
    <joint name="imu" type="fixed"><parent link="base_link"/><child link="imu_link"/>
    <origin rpy="{imu}"/></joint>
    <joint name="mag" type="fixed"><parent link="imu_link"/><child link="mag_link"/>
    <origin rpy="{magnetometer}"/></joint></robot>"""
    out = actor.node.create_publisher(String, "robot_description", LATCHED)
    out.publish(String(data=text))
    actor.run(PATIENCE, stop=out.get_subscription_count)
    actor.run(0.5)
    return out


def complaints(actor, words, part="Inputs"):
    """Wait until the node's diagnostics say something; returns what `part` says last."""
    stated = [""]

    def hear(message):
        stated.extend(status.message for status in message.status if part in status.name)

    actor.node.create_subscription(DiagnosticArray, "/diagnostics", hear, 10)
    actor.run(PATIENCE, stop=lambda: words in stated[-1])
    return stated[-1]


@pytest.mark.nightly
def test_the_description_gives_the_mounting_and_the_base_frame(stage):
    actor = stage(UPSIDE_DOWN, DESCRIBED, speed=8.0)
    describe(actor)
    attitudes = []
    actor.node.create_subscription(Imu, "compass/mag/enu/imu", attitudes.append, 10)
    answer = actor.calibrate()
    assert answer.success, answer.message
    assert "warn" not in answer.message
    errors = actor.published_errors([(0.0, 0.0)], 3)
    assert rms_deg([float(wrap_angle(error + QUARTER)) for error in errors]) < 1.0
    assert {message.header.frame_id for message in attitudes} == {"base_link"}


def test_a_base_without_a_description_has_no_attitude_and_is_reported(loaded):
    actor = loaded(ROBOT, DESCRIBED)
    assert "pose of 'imu_link' in 'base_link' is unknown" in complaints(actor, "is unknown")
    assert not actor.yaws
    actor.node.create_subscription(Imu, "compass/fused/enu/imu", lambda _: None, 10)
    assert "nothing on compass/fused/enu/imu" in complaints(actor, "in base_frame", "Fused")
    out = describe(actor, "0 0 0", "0 0 0")
    actor.run(PATIENCE, stop=lambda: actor.yaws)
    assert actor.yaws
    assert out.get_subscription_count()


def test_the_yaw_by_driving_corrects_the_described_yaw(graph, calibration_of_the_robot, tmp_path):
    """The kept yaw says that the IMU looks 6° to the left of where its joint has it."""
    stored = tmp_path / "stored.yaml"
    kept = "vehicle_yaw_offset: {yaw: 0.1, sigma: 0.01, source: accelerations}\n"
    stored.write_text(calibration_of_the_robot.read_text() + kept)
    actor = graph.loaded(stored, tmp_path, ROBOT, DESCRIBED)
    describe(actor, "0 0 0", "0 0 0")
    errors = actor.published_errors([(0.0, 0.0)], 3)
    assert rms_deg([float(wrap_angle(error + 0.1)) for error in errors]) < 1.0


@pytest.mark.nightly
def test_a_given_yaw_has_priority_and_a_wrong_description_is_reported(start_node, actor):
    node = start_node(DESCRIBED)
    robot = actor()
    describe(robot, "0.5 0 0", "3.141592653589793 0 0")
    assert re.search(r"'base_link' would be tilted by 1(79|80)°", complaints(robot, "tilted by"))
    assert node._frames.mounting().upward.tolist() == [0.0, 0.0, 1.0]
    robot.calibrate()
    assert "away from this" in complaints(robot, "away from this")
    node.set_parameters([Parameter("mount_rpy_deg", value=[0.0, 0.0, 0.0])])
    answer = robot.calibrate()
    assert answer.success, answer.message
    assert "warn" not in answer.message


def test_a_calibration_of_another_pose_is_reported(loaded):
    """The pose that `magcal doctor` names is given, but the old calibration is still loaded."""
    actor = loaded()
    node = actor._audience
    assert not node._pipeline.complaints()
    node.set_parameters([Parameter("mount_rpy_deg", value=[0.0, 0.0, 90.0])])
    (found,) = node._pipeline.complaints()
    assert re.search(
        r"'mag_link' is turned by (89|90)° against .* yaw 90°\): .* calibrate again", found
    )
    node.set_parameters([Parameter("mount_rpy_deg", value=[0.0, 0.0, 0.0])])
    assert not node._pipeline.complaints()


@pytest.mark.parametrize("text", ["[.nan, 0, 0]", "[180, 0]"])
def test_half_a_pose_is_refused(start_node, text):
    node = start_node()
    (result,) = node.set_parameters([Parameter("mount_rpy_deg", value=text)])
    assert not result.successful
    assert "mount_rpy_deg must be" in result.reason


def test_the_fit_uses_the_described_top_of_the_vehicle(start_node, actor):
    node = start_node(DESCRIBED)
    robot = actor()
    describe(robot, "0 0 0", "0.1 0 0")
    robot.run(PATIENCE, stop=lambda: node._frames.mounting().upward[1] > 0.0)
    expected = [0.0, math.sin(0.1), math.cos(0.1)]
    assert node._frames.mounting().upward == pytest.approx(expected, abs=1e-9)


@pytest.mark.parametrize("base", ["", "base_link"])
def test_the_fit_uses_the_front_of_the_vehicle(start_node, actor, base):
    """The IMU's x points to the left: ahead is its negative y axis."""
    node = start_node({"vehicle_yaw_deg": 90.0, "base_frame": base})
    robot = actor()
    if base:
        describe(robot, "0 0 0", "0 0 0")
        robot.run(PATIENCE, stop=lambda: node._frames.mounting().forward[0] < 0.5)
    forward = node._frames.mounting().forward
    assert forward == pytest.approx([0.0, -1.0, 0.0], abs=1e-9)
