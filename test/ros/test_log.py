"""The log in /rosout."""

import time
from functools import partial

import pytest
import rclpy
from geometry_msgs.msg import TwistWithCovarianceStamped
from rcl_interfaces.msg import Log
from rclpy.context import Context
from sensor_msgs.msg import NavSatFix
from support import PATIENCE, REFERENCE

from magcal_ros.ros import node
from magcal_ros.ros.announcer import PAUSE, Announcer

WARN, INFO = 30, 20


@pytest.fixture
def received(graph):
    return []


def listen(node, received):
    def hear(message):
        if message.name == "calibrator":
            level = message.level if isinstance(message.level, int) else ord(message.level)
            received.append((level, message.msg))

    return node.create_subscription(Log, "/rosout", hear, 1000)


def test_missing_sensors_give_a_warning_and_a_turn_is_logged(
    start_node, actor, received, monkeypatch
):
    monkeypatch.setattr(node, "Announcer", partial(Announcer, lasting=0.5))
    start_node(REFERENCE)
    robot = actor(speed=8.0)
    listen(robot.node, received)
    until = time.monotonic() + PATIENCE
    while time.monotonic() < until and len(received) < 2:
        robot._executor.spin_once(timeout_sec=0.1)
    warnings = [words for level, words in received if level == WARN]
    assert any("nothing has arrived on /imu/data_raw" in words for words in warnings)
    assert any("nothing has arrived on /imu/mag" in words for words in warnings)
    for service in ("start", "cancel"):
        assert robot.answer(robot.call(service)).success
    robot.run(PATIENCE, stop=lambda: any("the turn is over" in words for _, words in received))
    reported = [words for level, words in received if level == INFO]
    (begins,) = (k for k, words in enumerate(reported) if words == "a turn begins")
    (over,) = (k for k, words in enumerate(reported) if words.startswith("the turn is over: "))
    assert begins < over
    assert "cancelled" in reported[over]
    assert len(received) < 12


def test_an_optional_topic_of_another_type_is_named(start_node, actor, received, monkeypatch):
    """For example the velocity of u-blox's driver, which comes with a covariance."""
    monkeypatch.setattr(node, "Announcer", partial(Announcer, lasting=0.5))
    start_node(REFERENCE)
    robot = actor()
    listen(robot.node, received)
    # DDS refuses a second type of a topic in the same participant.
    context = Context()
    context.init()
    try:
        driver = rclpy.create_node("driver", context=context)
        driver.create_publisher(TwistWithCovarianceStamped, "gps/vel", 10)
        driver.create_publisher(NavSatFix, "gps/fix", 10)
        robot.run(PATIENCE, stop=lambda: any("can arrive" in words for _, words in received))
    finally:
        context.shutdown()
    (named,) = (words for _, words in received if "can arrive" in words)
    wrong = "geometry_msgs/msg/TwistWithCovarianceStamped is published there"
    assert named.startswith(f"nothing can arrive on /gps/vel: {wrong}, not geometry_msgs/msg/Twist")


@pytest.mark.nightly
def test_a_faulty_receiver_does_not_flood_the_log(start_node, actor, received):
    start_node({})
    robot = actor()
    listen(robot.node, received)
    fixes = robot.node.create_publisher(NavSatFix, "gps/fix", 10)
    start = time.monotonic()
    for k in range(1, 10_000):
        fix = NavSatFix(latitude=40.0 + 10.0 * (k // 5 % 2), longitude=10.0 + k % 3)
        fix.header.stamp.sec = k
        fixes.publish(fix)
        if k % 200 == 0:
            robot._executor.spin_once(timeout_sec=0.1)
    for _ in range(20):
        robot._executor.spin_once(timeout_sec=0.1)
    # Two subjects, one line in ten seconds each, and some at the start.
    assert len(received) < 15 + 2.0 * (time.monotonic() - start) / PAUSE
