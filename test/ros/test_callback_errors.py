"""Errors of callbacks, also those of rclpy: each kind is logged once, all are counted."""

import pytest
from diagnostic_msgs.msg import DiagnosticArray
from rcl_interfaces.msg import Parameter, ParameterValue
from rcl_interfaces.srv import SetParameters
from rosgraph_msgs.msg import Clock
from support import PATIENCE, REFERENCE, goes_on

from magcal_ros.ros.announcer import LONGEST, CallbackErrors


def raised(fail, *arguments):
    try:
        fail(*arguments)
    except Exception as error:
        return error
    raise AssertionError("it did not fail")


def divide(by):
    return 1 / by


def look_up(name):
    return {}[name]


def test_a_kind_is_logged_once_with_its_place_and_counted_each_time():
    lines = []
    callback_errors = CallbackErrors(lines.append)
    for _ in range(3):
        callback_errors.note(raised(divide, 0))
        callback_errors.note(raised(look_up, "a\nb" * 1000))
    assert callback_errors.total == 6
    assert len(lines) == 2
    place = f"test_callback_errors.py, line {divide.__code__.co_firstlineno + 1}"
    assert "ZeroDivisionError" in lines[0]
    assert place in lines[0]
    assert "KeyError" in lines[1]
    assert all("\n" not in line and len(line) < LONGEST + 200 for line in lines)


def test_the_same_type_of_error_elsewhere_is_another_kind():
    lines = []
    callback_errors = CallbackErrors(lines.append)
    callback_errors.note(raised(divide, 0))
    callback_errors.note(raised(lambda: 1 // 0))
    callback_errors.note(ZeroDivisionError("never raised"))
    assert len(lines) == 3


@pytest.fixture
def watched(loaded):
    """Return a robot, and the node's last diagnostic of errors in callbacks."""
    actor = loaded(parameters={**REFERENCE, "use_sim_time": True})
    counts = []

    def hear(message):
        for status in message.status:
            values = {pair.key: pair.value for pair in status.values}
            if status.name.endswith("Inputs"):
                counts.append(int(values["callback errors"]))

    actor.node.create_subscription(DiagnosticArray, "/diagnostics", hear, 10)
    actor.run(PATIENCE, stop=lambda: counts)
    return actor, counts


@pytest.mark.nightly
def test_a_clock_before_zero_is_counted_and_the_node_continues(watched):
    actor, counts = watched
    assert counts[-1] == 0
    clock = actor.node.create_publisher(Clock, "/clock", 10)
    actor.run(PATIENCE, stop=lambda: clock.get_subscription_count())
    impossible, good = Clock(), Clock()
    impossible.clock.sec, good.clock.sec = -1, 777
    for n in (1, 2):
        clock.publish(impossible)
        actor.run(PATIENCE, stop=lambda n=n: counts[-1] == n)
    assert counts[-1] == 2
    clock.publish(good)
    goes_on(actor)


def test_a_parameter_of_unknown_type_is_counted_and_the_node_continues(watched):
    actor, counts = watched
    client = actor.node.create_client(SetParameters, "/calibrator/set_parameters")
    assert client.wait_for_service(PATIENCE)
    unknown = Parameter(name="method", value=ParameterValue(type=200))
    client.call_async(SetParameters.Request(parameters=[unknown]))
    actor.run(PATIENCE, stop=lambda: counts[-1] == 1)
    assert counts[-1] == 1
    answer = actor.answer(client.call_async(SetParameters.Request()))
    assert answer.results == []
    goes_on(actor)


def test_an_error_in_a_sensor_callback_is_counted_and_the_node_continues(graph, loaded):
    robot = loaded()
    node = graph.calibrators[0]
    sound = node._inputs.imu.note_message
    left = [5]

    def fail(frame):
        if left[0]:
            left[0] -= 1
            raise ZeroDivisionError
        sound(frame)

    node._inputs.imu.note_message = fail
    robot.run(PATIENCE, stop=lambda: node.callback_errors.total >= 5)
    robot.run(0.2)
    assert node.callback_errors.total == 5
    goes_on(robot)
