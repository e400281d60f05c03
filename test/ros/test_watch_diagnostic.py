"""What the drive says about a calibration is in diagnostics and status until another one."""

import dataclasses

import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from support import PATIENCE, REFERENCE, ROBOT, store_calibration

from magcal_ros.core.self_calibration import Watch


@pytest.fixture
def scene(start_node, actor):
    node = start_node(REFERENCE)
    robot = actor(ROBOT)
    received = {}

    def keep(message):
        received.update({status.name: status for status in message.status})

    robot.node.create_subscription(DiagnosticArray, "/diagnostics", keep, 10)
    return node, robot, lambda: received.get("calibrator: Watch")


def test_a_stale_calibration_is_reported_until_a_new_one(scene, ros_home):
    node, robot, stated = scene

    def wait_for(words):
        robot.run(PATIENCE, stop=lambda: words in stated().message)
        assert words in stated().message

    robot.run(PATIENCE, stop=lambda: stated() is not None)
    assert "before a calibration is in force" in stated().message
    assert robot.status["watch"] is None
    store_calibration(ros_home / "magcal" / "calibrator.mag_link.yaml")
    assert robot.answer(robot.call("load")).success
    wait_for("Not judged yet")
    assert stated().level == DiagnosticStatus.OK
    machine = node._self_calibration.machine
    robot.run(PATIENCE, 0.5, lambda: machine._in_force is not None)
    machine.watch = dataclasses.replace(Watch(), is_stale=True, since=0.0, clock=240.0)
    wait_for("has not held for about 4 min of driving")
    assert stated().level == DiagnosticStatus.WARN
    robot.run(PATIENCE, stop=lambda: robot.status["watch"]["stale"])
    assert robot.answer(robot.call("load")).success
    wait_for("has not held")
    store_calibration(ros_home / "magcal" / "calibrator.mag_link.yaml", iron=1e-6)
    assert robot.answer(robot.call("load")).success
    wait_for("Not judged yet")
    assert stated().level == DiagnosticStatus.OK
    robot.run(PATIENCE, stop=lambda: not robot.status["watch"]["stale"])
    assert not robot.status["watch"]["stale"]
