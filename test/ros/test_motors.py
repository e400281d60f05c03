"""A robot whose motors add a field, over real middleware."""

import math
from dataclasses import replace

import numpy as np
import pytest
from geometry_msgs.msg import Twist, TwistStamped
from long_form import first_of
from nav_msgs.msg import Odometry
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import BatteryState, Imu
from support import PATIENCE, REFERENCE

from magcal_ros.core import Compass
from magcal_ros.core.calibration import MotorField, MotorInput
from magcal_ros.core.geometry import wrap_angle
from magcal_ros.core.samples import FieldSample
from magcal_ros.files import read_calibration, write_calibration

GAIN = np.array([[4e-6, -3e-6, 2e-6], [0.0, 5e-6, 0.0], [1e-6, 1e-6, 0.0]])
"""Tesla while it moves, per rad/s, and per ampere."""
INPUTS = (MotorInput.MOVING, MotorInput.TURN_RATE, MotorInput.CURRENT)
SIGMA = 0.5e-6
IDLE = 0.5
"""Amperes at rest."""
APPLY, OFF = {"self_calibration": "apply"}, {"self_calibration": "off"}


@pytest.fixture
def knowing(calibration_of_the_robot, tmp_path):
    """Return a function that stores a calibration of the robot that knows motors by inputs."""

    def store(*inputs):
        known, origin = read_calibration(calibration_of_the_robot)
        covariance = SIGMA**2 * np.diag(np.repeat([1.0, 0.0, 0.0], 3))
        motors = MotorField(inputs, GAIN, covariance, np.zeros((12, 9)), 0.0, (1.0, 0.5, 2.0))
        path = tmp_path / "known.yaml"
        write_calibration(path, replace(known, motors=motors), origin)
        return path

    return store


@pytest.fixture
def with_motors(knowing):
    """A calibration of the robot with its motor field."""
    return knowing(*INPUTS)


def yaw_of(message):
    q = message.orientation
    return math.atan2(2 * (q.w * q.z + q.x * q.y), 1 - 2 * (q.y * q.y + q.z * q.z))


def stamp_of(message):
    return round(message.header.stamp.sec + message.header.stamp.nanosec * 1e-9, 3)


def test_the_motor_field_is_subtracted_and_its_sigma_published(graph, with_motors, tmp_path):
    actor = graph.loaded(with_motors, tmp_path, parameters={**REFERENCE, **OFF})
    received, now = [], {"rate": 0.0, "current": IDLE}
    yaws = {}
    actor.node.create_subscription(Imu, "compass/mag/enu/imu", received.append, 10)
    battery = actor.node.create_publisher(BatteryState, "battery", 1)

    def add(sample):
        if isinstance(sample, FieldSample):
            moves = float(now["rate"] != 0.0)
            # The calibration is that of the robot at rest, its current there included.
            added = np.array([moves, now["rate"], now["current"] - IDLE]) @ GAIN
            sample = sample._replace(field=tuple(np.add(sample.field, added)))
            yaws[round(sample.stamp, 3)] = actor.ride.magnetic_yaw
            battery.publish(BatteryState(current=now["current"]))
        return [sample]

    actor.mangle = add
    actor.speed = 1.0

    def drive(rate, current):
        now.update(rate=rate, current=current)
        actor.run(1.0, rate)
        received.clear()
        actor.run(1.5, rate)
        off = [float(wrap_angle(yaw_of(m) - yaws[stamp_of(m)])) for m in received]
        return abs(np.median(off)), np.median([m.orientation_covariance[8] for m in received])

    rest, at_rest = drive(0.0, IDLE)
    turning, while_moving = drive(0.6, 3.0)
    assert max(rest, turning) < math.radians(3.0)
    level = 48e-6 * math.cos(math.radians(65.0))
    # A rest a moment ago has shown the place, and so a part of what the motors add.
    assert while_moving - at_rest > 0.15 * (SIGMA / level) ** 2
    assert while_moving - at_rest < 4.0 * (SIGMA / level) ** 2
    actor.run(PATIENCE, 0.6, lambda: actor.status["motors"]["moves"])
    reported = actor.status["motors"]["inputs"]
    assert reported["current"]["from"] == "/battery"
    assert reported["turn_rate"]["from"] == "gyro"
    assert reported["moving"]["field_ut"] == [4.0, -3.0, 2.0]
    assert reported["moving"]["sigma_ut"] == pytest.approx(math.sqrt(3.0) * 0.5, abs=0.01)
    # Further magnetometers may have been calibrated at other currents.
    calibration, now_running = (
        read_calibration(with_motors)[0],
        graph.calibrators[0]._pipeline.motors,
    )
    stamp, state = actor.ride.stamp, now_running.reader.motor_state
    compasses = [
        Compass(replace(calibration, motors=replace(calibration.motors, reference=amperes)))
        for amperes in (0.5, 2.0)
    ]
    found = [state(stamp, each).current for each in compasses]
    assert found == [2.5, 1.0]
    # Another calibration keeps the inputs of the motors.
    loaded = actor.answer(actor.call("load"))
    assert loaded.success, loaded.message
    actor.run(0.5)
    assert actor.status["motors"]["inputs"].keys() == reported.keys()


def test_a_robot_without_known_motors_reports_none(loaded):
    assert loaded().status["motors"] is None


def odometry(stamp, speed):
    message = Odometry()
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(round(stamp * 1e9), 10**9)
    message.header.frame_id, message.child_frame_id = "odom", "base_link"
    message.twist.twist.linear.x = speed
    return message


def learnt_of_speed(actor, now):
    """Start and stop at several speeds, and return the node's facts on the field by speed."""
    for _ in range(2):
        for speed in (0.0, 0.5, 0.5, 0.9, 0.9, 0.5):
            now["speed"] = speed
            actor.run(0.6)

    def reported():
        return (actor.status["motors"] or {}).get("inputs", {})

    actor.run(PATIENCE, stop=lambda: "speed" in reported())
    return reported()["speed"]


def test_a_motor_field_by_wheels_is_learnt_and_stored(graph, with_motors, tmp_path, monkeypatch):
    """The turn knew of nothing that goes with the speed; a few starts and stops show it."""
    monkeypatch.setattr("magcal_ros.ros.vehicle.PAUSE", 2)
    actor = graph.loaded(with_motors, tmp_path, parameters={**REFERENCE, **APPLY})
    out = actor.node.create_publisher(Odometry, "odom", qos_profile_sensor_data)
    now = {"speed": 0.0}
    by_speed = np.array([6e-6, -4e-6, 0.0])

    def add(sample):
        if isinstance(sample, FieldSample):
            out.publish(odometry(sample.stamp, now["speed"]))
            moves = now["speed"] > 0.0
            added = moves * GAIN[0] + now["speed"] * by_speed
            sample = sample._replace(field=tuple(np.add(sample.field, added)))
        return [sample]

    actor.mangle = add
    found = learnt_of_speed(actor, now)
    assert found["from"] == "/odom"
    gap = np.array(found["field_ut"]) * 1e-6 - by_speed
    assert np.linalg.norm(gap) < 4.0 * max(found["sigma_ut"] * 1e-6, 0.1e-6)
    assert found["sigma_ut"] < 4.0
    assert actor.status["motors"]["learns"]
    actor.run(PATIENCE, stop=lambda: len(kept(tmp_path).inputs) > len(INPUTS))
    assert MotorInput.SPEED in kept(tmp_path).inputs


def kept(folder):
    return read_calibration(folder / "calibration.yaml")[0].motors


@pytest.mark.parametrize("kind", first_of([TwistStamped, Twist]))
def test_the_command_is_the_speed_without_wheels(graph, knowing, tmp_path, kind):
    known = knowing(MotorInput.MOVING, MotorInput.TURN_RATE, MotorInput.SPEED)
    actor = graph.loaded(known, tmp_path, parameters={**REFERENCE, **APPLY})
    out = actor.node.create_publisher(kind, "cmd_vel", 1)
    message = kind()
    (message.twist if kind is TwistStamped else message).linear.x = 0.5
    actor.node.create_timer(0.05, lambda: out.publish(message))

    def reported():
        return actor.status["motors"]["inputs"]["speed"]["from"]

    actor.run(PATIENCE, stop=lambda: reported() == "/cmd_vel")
    assert reported() == "/cmd_vel"


@pytest.mark.nightly
@pytest.mark.parametrize("kind", [TwistStamped, Twist])
def test_a_motor_field_by_commands_is_learnt(graph, with_motors, tmp_path, kind):
    """Without wheels the commanded speed is the input, whichever of the two types it comes as."""
    actor = graph.loaded(with_motors, tmp_path, parameters={**REFERENCE, **APPLY})
    out = actor.node.create_publisher(kind, "cmd_vel", 1)
    now = {"speed": 0.0}
    by_speed = np.array([6e-6, -4e-6, 0.0])

    def add(sample):
        if isinstance(sample, FieldSample):
            message = kind()
            twist = message.twist if kind is TwistStamped else message
            twist.linear.x = now["speed"]
            out.publish(message)
            moves = now["speed"] > 0.0
            added = moves * GAIN[0] + now["speed"] * by_speed
            sample = sample._replace(field=tuple(np.add(sample.field, added)))
        return [sample]

    actor.mangle = add
    actor.run(PATIENCE, stop=out.get_subscription_count)
    found = learnt_of_speed(actor, now)
    assert found["from"] == "/cmd_vel"
    gap = np.array(found["field_ut"]) * 1e-6 - by_speed
    assert np.linalg.norm(gap) < 4.0 * max(found["sigma_ut"] * 1e-6, 0.1e-6)


def test_the_node_does_not_count_as_a_subscriber_of_its_commands(graph, with_motors, tmp_path):
    """A subscription for the motors is no evidence of a base that would turn."""
    settings = {**REFERENCE, **APPLY, "rotate.enabled": True}
    actor = graph.loaded(with_motors, tmp_path, parameters=settings)
    out = actor.node.create_publisher(Twist, "cmd_vel", 1)
    actor.run(PATIENCE, stop=out.get_subscription_count)
    started = actor.call("start")
    actor.run(PATIENCE, stop=started.done)
    assert started.result().success
    actor.run(PATIENCE, stop=lambda: not out.get_subscription_count())
    # Two seconds after its start a turn that nobody hears ends, and the node listens again.
    actor.run(1.0)
    assert out.get_subscription_count() == 0


@pytest.mark.parametrize("size", [math.inf, np.finfo(np.float32).max])
def test_a_current_or_command_that_no_robot_has_counts_as_missing(start_node, size):
    """Some drivers send the largest number for an unknown one: the heading would become NaN."""
    node = start_node()
    motors = node._pipeline.motors
    motors._on_battery(BatteryState(current=float(size)))
    command = Twist()
    command.linear.x = -float(size)
    motors.commands._on_command(command)
    assert not motors.currents
    assert math.isnan(motors.inputs(motors._up.newest_stamp)[1])
    assert not motors.commands.is_received
