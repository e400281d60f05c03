import contextlib
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from magcal_ros.core.geometry import FrameTree, rpy_from_rotation
from magcal_ros.files import LARGEST, RobotDescriptionError, joints_of

ROBOT = """<?xml version="1.0"?>
<robot name="mule">
  <!-- a comment -->
  <link name="base_link"><visual><geometry><box size="1 1 1"/></geometry></visual></link>
  <link name="imu_link"/><link name="mag_link"/>
  <joint name="imu" type="fixed">
    <parent link="base_link"/><child link="imu_link"/>
    <origin xyz="0 0 .1" rpy="0 0 1.5707963"/>
  </joint>
  <joint type="fixed" name="mag">
    <origin rpy="3.14159265 0 0"/><child link="mag_link"/><parent link="imu_link"/>
  </joint>
  <joint name="wheel" type="continuous">
    <parent link="base_link"/><child link="wheel_link"/><axis xyz="0 1 0"/>
  </joint>
  <transmission name="t"><joint name="wheel"><hardwareInterface/></joint></transmission>
  <gazebo reference="imu_link"><sensor type="imu"><origin rpy="1 2 3"/></sensor></gazebo>
</robot>
"""


def test_only_the_joints_of_a_robot_are_read():
    joints = joints_of(ROBOT)
    assert [(j.name, j.kind, j.parent, j.child) for j in joints] == [
        ("imu", "fixed", "base_link", "imu_link"),
        ("mag", "fixed", "imu_link", "mag_link"),
        ("wheel", "continuous", "base_link", "wheel_link"),
    ]
    tree = FrameTree(joints)
    roll, pitch, yaw = rpy_from_rotation(tree.pose("imu_link", "base_link"))
    assert (roll, pitch, yaw) == pytest.approx((0.0, 0.0, math.pi / 2), abs=1e-6)
    assert abs(rpy_from_rotation(tree.pose("mag_link", "imu_link"))[0]) == pytest.approx(math.pi)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "not XML"),
        ("<robot>", "not XML"),
        ("<sdf/>", "not a URDF"),
        ("<a><robot><joint name='x' type='fixed'/></robot></a>", "not a URDF"),
        ("<robot><joint name='x' type='fixed'/></robot>", "'x' .* names no parent"),
        ("<robot><joint name='x' type='bolted'/></robot>", "'x' .* type 'bolted'"),
        (ROBOT.replace("0 0 1.5707963", "0 0"), "'imu' .* not three"),
        (ROBOT.replace("0 0 1.5707963", "0 0 nan"), "'imu' .* not three"),
        (ROBOT.replace("0 0 1.5707963", "${pi/2} 0 0"), "'imu' .* not three"),
        (" " * (LARGEST + 1), "at most"),
    ],
)
def test_a_damaged_description_is_refused_with_the_reason(text, words):
    with pytest.raises(RobotDescriptionError, match=words):
        joints_of(text)


def test_an_entity_bomb_is_refused_before_expansion():
    layers = "".join(
        f'<!ENTITY l{k + 1} "{"&l" + str(k) + ";" * 1}{("&l" + str(k) + ";") * 9}">'
        for k in range(9)
    )
    bomb = f'<!DOCTYPE robot [<!ENTITY l0 "ha">{layers}]><robot name="&l9;"/>'
    with pytest.raises(RobotDescriptionError, match="document type"):
        joints_of(bomb)


@given(st.text(alphabet=st.sampled_from("<>/='\" robotjinlkepac\0\x01é"), max_size=80))
def test_any_text_is_read_or_refused(text):
    with contextlib.suppress(RobotDescriptionError):
        assert isinstance(joints_of(text), tuple)
