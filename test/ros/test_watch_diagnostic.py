"""What the watch says reaches diagnostics and status, and a new calibration clears it."""

import dataclasses

import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from support import REFERENCE, ROBOT, store_calibration

from magcal_ros.core.monitoring.watch import Watched


@pytest.fixture
def scene(start_node, actor):
    node = start_node(REFERENCE)
    robot = actor(ROBOT)
    heard = {}

    def keep(message):
        heard.update({status.name: status for status in message.status})

    robot.node.create_subscription(DiagnosticArray, "/diagnostics", keep, 10)
    return node, robot, lambda: heard["calibrator: Watch"]


def test_it_is_told_and_cleared_by_a_new_calibration(scene, ros_home):
    node, robot, said = scene
    robot.run(1.3)
    assert "before a calibration is in force" in said().message
    assert robot.status["watch"] is None
    store_calibration(ros_home / "magcal" / "calibrator.mag_link.yaml")
    assert robot.answer(robot.call("load")).success
    robot.run(1.3, 0.5)
    assert said().level == DiagnosticStatus.OK
    assert said().message.startswith("Not judged yet")
    assert len(node._watch._records) > 3, "field messages reach the watch"
    node._watch._watched = dataclasses.replace(Watched(), is_stale=True, minutes=4.0)
    robot.run(1.3)
    assert said().level == DiagnosticStatus.WARN
    assert "has not held for about 4 min" in said().message
    assert robot.status["watch"]["stale"]
    assert robot.answer(robot.call("load")).success
    robot.run(1.3)
    assert said().level == DiagnosticStatus.OK
    assert not robot.status["watch"]["stale"]
