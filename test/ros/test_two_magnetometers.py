"""Two nodes in one namespace, each with a magnetometer of the same frame."""

import pytest
from support import PATIENCE, store_calibration

from magcal_ros.files.calibration_file import read_calibration

FRAME = "mag_link"


def named(name):
    return ["--ros-args", "-r", f"__node:={name}"]


@pytest.fixture
def former(ros_home):
    return store_calibration(ros_home / "magcal" / f"{FRAME}.yaml", frame=FRAME)


def test_each_finds_its_own_calibration_and_none_its_neighbours(start_node, actor, ros_home):
    start_node(arguments=named("left"))
    robot = actor(calibrator="/left", speed=8.0)
    answer = robot.calibrate()
    assert answer.success, answer.message
    path = ros_home / "magcal" / f"left.{FRAME}.yaml"
    assert f"saved to {path}" in answer.message
    assert read_calibration(path)[1].node == "/left"
    right = start_node(arguments=named("right"))
    robot.run(PATIENCE, stop=lambda: right._inputs.field.messages)
    robot.run(0.5)
    assert right._keeper.calibration is None
    again = start_node(arguments=named("left"))
    robot.run(PATIENCE, stop=lambda: again._keeper.calibration is not None)
    assert again._keeper.origin.node == "/left"


def test_the_default_node_loads_the_file_of_an_earlier_release(start_node, actor, former):
    node = start_node()
    actor().run(PATIENCE, stop=lambda: node._keeper.calibration is not None)
    assert former.exists()


def test_another_node_does_not_take_it_and_says_how_to_keep_it(start_node, actor, former):
    node = start_node(arguments=named("right"))
    robot = actor(calibrator="/right")
    robot.run(PATIENCE, stop=lambda: node._inputs.field.messages)
    answer = robot.answer(robot.call("load"))
    assert not answer.success
    assert f"mv {former} {former.parent}/right.{FRAME}.yaml" in answer.message
    assert node._keeper.calibration is None
