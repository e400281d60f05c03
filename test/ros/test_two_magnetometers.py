"""Two magnetometers: two nodes in one namespace, and both in one node."""

import math
import threading
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import MagneticField
from support import DEGREE, PATIENCE, REFERENCE, ROBOT

from magcal_ros.core.heading import SeveralCompasses
from magcal_ros.core.samples import FieldSample, Streams
from magcal_ros.core.session import Conclusion
from magcal_ros.files import read_calibration
from magcal_ros.ros.heading_pipeline import Inputs, Sensor
from magcal_ros.ros.magnetometers import Magnetometers, joined, of_turns
from magcal_ros.ros.preflight import inspect
from magcal_ros.ros.rehearsal import set_time

FRAME = "mag_link"


def named(name):
    return ["--ros-args", "-r", f"__node:={name}"]


@pytest.mark.nightly
def test_each_node_loads_its_own_calibration(start_node, actor, ros_home):
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
    assert right._store.calibration is None
    again = start_node(arguments=named("left"))
    robot.run(PATIENCE, stop=lambda: again._store.calibration is not None)
    assert again._store.origin.node == "/left"


SECOND = replace(
    ROBOT, roll=-2.0 * DEGREE, pitch=5.0 * DEGREE, hard_iron=np.array([-20e-6, 5e-6, 12e-6])
)
"""The same robot, as its second magnetometer sees it."""


class Pair:
    """Publishes what a second magnetometer reads with each message of the first.

    Whichever is in `silent` says nothing.
    """

    def __init__(self, actor):
        self.silent = set()
        self._out = actor.node.create_publisher(MagneticField, "imu/mag_2", qos_profile_sensor_data)
        actor.mangle = self.publish

    def publish(self, sample):
        if not isinstance(sample, FieldSample):
            return [sample]
        if "imu/mag_2" not in self.silent:
            body = np.linalg.solve(ROBOT.distortion, sample.field - ROBOT.hard_iron)
            message = MagneticField()
            message.header.frame_id = "mag_2_link"
            set_time(message.header.stamp, sample.stamp)
            field = message.magnetic_field
            field.x, field.y, field.z = SECOND.raw_field(body)
            self._out.publish(message)
        return [] if "imu/mag" in self.silent else [sample]


def entries(actor):
    return {entry["topic"]: entry for entry in actor.status["magnetometers"]}


def status_after_look(robot):
    """The result of the preflight while the robot sends."""
    looker = rclpy.create_node("looker")
    found = []
    look = threading.Thread(target=lambda: found.append(inspect(looker, "/calibrator", 0.5)))
    look.start()
    robot.run(PATIENCE, stop=lambda: not look.is_alive())
    looker.destroy_node()
    return found[0]


@pytest.mark.parametrize("silent", ["imu/mag_2", "imu/mag"])
def test_a_silent_magnetometer_is_reported_without_naming_the_others_topic(
    start_node, actor, silent
):
    start_node()
    robot = actor()
    pair = Pair(robot)
    pair.silent = {silent}
    found = status_after_look(robot)
    assert found.ready
    assert f"/{silent}: nothing arrives (1 publishers)" in found.lines
    assert f"  /{silent} is silent and is not calibrated" in found.lines
    assert not [line for line in found.lines if "remap" in line]


def test_one_turn_calibrates_both_and_the_heading_needs_only_one(start_node, actor, ros_home):
    start_node()
    robot = actor(speed=8.0)
    pair = Pair(robot)
    robot.run(PATIENCE, stop=lambda: len(robot.status["magnetometers"]) == 2)
    found = status_after_look(robot)
    assert found.ready
    assert [line.partition(":")[0] for line in found.lines] == [
        "/imu/data_raw",
        "/imu/mag",
        "/imu/mag_2",
    ]
    answer = robot.calibrate()
    assert answer.success, answer.message
    folder = ros_home / "magcal"
    files = folder / "calibrator.mag_link.yaml", folder / "calibrator.mag_2_link.2.yaml"
    for topic, path, truth in zip(("/imu/mag", "/imu/mag_2"), files, (ROBOT, SECOND), strict=True):
        assert f"{topic}: " in answer.message
        assert f"saved to {path}" in answer.message
        found = read_calibration(path)[0].correction.hard_iron
        assert np.abs(found - truth.hard_iron)[:2].max() < 1e-6
    robot.speed = 4.0
    for silent in ((), ("imu/mag",), ("imu/mag_2",)):
        pair.silent = set(silent)
        topics = {f"/{topic}" for topic in silent}
        robot.run(
            PATIENCE,
            stop=lambda topics=topics: (
                {topic for topic, entry in entries(robot).items() if entry["weight"] < 0.1}
                == {topic for topic, entry in entries(robot).items() if "silent" in entry["why"]}
                == topics
            ),
        )
        assert all("silent" in entries(robot)[topic]["why"] for topic in topics)
        robot.yaws.clear()
        robot.run(PATIENCE, yaw_rate=0.3, stop=lambda: len(robot.yaws) > 30)
        off = robot.published_errors([(0.0, 0.0)], headings=1)[0]
        assert abs(math.degrees(off)) < 5.0
    pair.silent.clear()
    # Every service acts on both.
    assert robot.answer(robot.call("start")).success
    cancelled = robot.answer(robot.call("cancel"))
    assert cancelled.message.count("cancelled") == 2
    assert robot.answer(robot.call("reset")).success
    robot.run(PATIENCE, stop=lambda: robot.status["state"] == "uncalibrated")
    assert not any(entry["calibrated"] for entry in entries(robot).values())
    loaded = robot.answer(robot.call("load"))
    assert loaded.success, loaded.message
    assert all(f"loaded {path}" in loaded.message for path in files)
    assert robot.answer(robot.call("save")).success


@pytest.mark.nightly
def test_a_magnetometer_that_stops_during_the_turn_does_not_affect_the_others(
    start_node, actor, ros_home
):
    start_node({**REFERENCE, "window.silence_s": 3.0})
    robot = actor(speed=8.0)
    pair = Pair(robot)
    robot.run(PATIENCE, stop=lambda: len(robot.status["magnetometers"]) == 2)

    def follow(progress):
        if progress["arc_deg"] > 20.0:
            pair.silent = {"imu/mag_2"}

    answer = robot.calibrate(follow)
    assert answer.success, answer.message
    assert answer.message.startswith("/imu/mag_2: not calibrated, or not saved; ")
    assert "/imu/mag_2 has been silent" in answer.message
    assert f"saved to {ros_home / 'magcal' / 'calibrator.mag_link.yaml'}" in answer.message
    calibrated = {topic: entry["calibrated"] for topic, entry in entries(robot).items()}
    assert calibrated == {"/imu/mag": True, "/imu/mag_2": False}


def test_turns_succeed_if_one_of_them_does():
    good, bad = Conclusion(True, "excellent."), Conclusion(False, "silent; nothing was seen")
    assert of_turns({"/a": good}) == good
    assert of_turns({"/a": good, "/b": good}) == joined({"/a": good, "/b": good})
    assert not of_turns({"/a": bad, "/b": bad}).success
    for found in (of_turns({"/a": good, "/b": bad}), of_turns({"/b": bad, "/a": good})):
        assert found.success
        assert found.message.startswith("/b: not calibrated, or not saved; ")
        assert "/b: silent; nothing was seen" in found.message
        assert ".;" not in found.message


def test_two_publishers_of_the_common_imu_are_reported_and_its_rate_is_right():
    now = [0.0]
    imu = Sensor("/imu", lambda: now[0])
    pipeline = SimpleNamespace(
        node=SimpleNamespace(
            get_publishers_info_by_topic=lambda _: [SimpleNamespace(topic_type="")]
        ),
        settings=SimpleNamespace(max_gap=0.2, accumulate=True),
        compasses=SeveralCompasses(),
    )
    inputs = [Inputs(imu, Sensor(f"/mag_{k}"), Streams(0.2)) for k in (1, 2)]
    each = [SimpleNamespace(number=k, inputs=i, pipeline=pipeline) for k, i in enumerate(inputs)]
    both = Magnetometers(each[0])
    both.add(each[1])
    for _ in range(5):
        for k in range(10):
            imu.note_message("ab"[k % 2])
        now[0] += 1.0
        both.look()
    assert imu.rate == 10.0
    assert "the frame of /imu changes between 'a' and 'b'" in imu.complaint()


def test_a_node_for_one_magnetometer_subscribes_to_no_other(start_node):
    node = start_node({"magnetometers": 1})
    assert not [sub for sub in node.subscriptions if sub.topic_name.endswith("imu/mag_2")]


def test_a_second_node_is_warned_of_mixed_headings(start_node, actor):
    start_node(arguments=named("left"))
    start_node(arguments=named("right"))
    robot, received = actor(calibrator="/left"), {}

    def hear(message):
        received.update({status.name: status for status in message.status})

    robot.node.create_subscription(DiagnosticArray, "/diagnostics", hear, 50)

    def reported():
        inputs = received.get("left: Inputs")
        return inputs is not None and "/compass/yaw is also published by /right" in inputs.message

    robot.run(PATIENCE, stop=reported)
    assert reported()
    assert received["left: Inputs"].level == DiagnosticStatus.ERROR
    assert "imu/mag_2" in received["left: Inputs"].message
