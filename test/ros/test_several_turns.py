"""Turns on different tilts, one service call each, joined by the running node."""

import math
from dataclasses import replace

import pytest
from rclpy.parameter import Parameter
from simulated.turns import slope_rpy
from support import REFERENCE, ROBOT, rms_deg

ACCUMULATE = {**REFERENCE, "accumulate": True, "report_folder": "none"}
TURNED = replace(ROBOT, yaw=0.1)
LEVEL = [(0.0, 0.0)]


def stand_on_a_slope(actor, azimuth, tilt=math.radians(10.0)):
    actor.ride.stand(*slope_rpy(tilt, azimuth, 0.4))


def calibrate(actor):
    return actor.calibrate(yaw_rate=1.0)


@pytest.mark.nightly
def test_turns_with_different_tilts_join_and_one_of_another_robot_does_not(start_node, actor):
    node = start_node(ACCUMULATE)
    robot = actor(TURNED)
    first = calibrate(robot)
    assert first.success, first.message
    assert "1 turn together: " in first.message
    assert "Next turn " in first.message
    assert rms_deg(robot.published_errors(LEVEL, 6)) == pytest.approx(5.7, abs=0.8)
    stand_on_a_slope(robot, 0.0)
    second = calibrate(robot)
    assert second.success, second.message
    assert "2 turns together: installation yaw ±0." in second.message
    assert rms_deg(robot.published_errors(LEVEL, 6)) <= 1.2
    several = robot.status["several"]
    assert [turn["joined"] for turn in several["turns"]] == [True, True]
    assert several["shown"]["installation_yaw_deg"] < 1.0
    assert robot.status["turns_kept"] == 2

    robot.ride.robot = replace(TURNED, hard_iron=TURNED.hard_iron + 6e-6)
    stand_on_a_slope(robot, math.pi)
    third = calibrate(robot)
    assert not third.success
    assert "turn 3 does not join the 2 turns before it: it contradicts" in third.message
    assert "The calibration in force is unchanged" in third.message
    robot.ride.robot = TURNED
    assert rms_deg(robot.published_errors(LEVEL, 6)) <= 1.2
    assert robot.status["turns_kept"] == 2

    cancelled = robot.call("calibrate")
    robot.run(0.5, 1.0)
    robot.answer(robot.call("cancel"))
    assert not robot.answer(cancelled).success
    robot.run(0.3)
    assert robot.status["turns_kept"] == 2
    assert node.set_parameters([Parameter("accumulate", value=False)])[0].successful
    robot.run(5.0, stop=lambda: robot.status["turns_kept"] == 0)
    assert robot.status["turns_kept"] == 0


@pytest.mark.nightly
def test_reset_forgets_the_turns(stage):
    robot = stage(parameters=ACCUMULATE)
    assert calibrate(robot).success
    robot.run(3.0, stop=lambda: robot.status["turns_kept"] == 1)
    robot.reset()
    robot.run(3.0, stop=lambda: robot.status["turns_kept"] == 0)
    assert robot.status["turns_kept"] == 0
