"""The velocities sent to a base, by publisher."""

from types import SimpleNamespace

import pytest
from geometry_msgs.msg import Twist, TwistStamped

from magcal_ros.ros.guard import LAST_ZEROS, Rotator
from magcal_ros.ros.parameters import Rotation

PLAIN, STAMPED = Rotation(True, 0.5, False, ""), Rotation(True, 0.5, True, "base")


class Wire:
    """A node that records the published messages with their publishers."""

    def __init__(self):
        self.received = []

    def create_publisher(self, kind, topic, _):
        self.received.append(("made", kind))
        return Line(self.received, kind)

    def destroy_publisher(self, line):
        self.received.append(("gone", line.kind))

    def get_clock(self):
        import rclpy.clock

        return rclpy.clock.Clock()


class Line:
    topic_name = "/cmd_vel"

    def __init__(self, received, kind):
        self.received, self.kind = received, kind

    def publish(self, message):
        assert type(message) is self.kind
        twist = message.twist if self.kind is TwistStamped else message
        self.received.append((self.kind, twist.angular.z))

    def get_subscription_count(self):
        return 3

    def wait_for_all_acked(self, _):
        self.received.append("acknowledged")


class Guard:
    """Records its events together with the commands to the base."""

    is_ready = True

    def __init__(self, received):
        self.received = received

    def tell_alive(self):
        self.received.append("alive")

    def dismiss(self):
        self.received.append("dismissed")


@pytest.fixture
def wire():
    return Wire()


@pytest.fixture
def rotator(wire):
    """Return a rotator with simulated guards."""
    return Rotator(wire, lambda *_: Guard([]))


def test_a_change_of_type_in_motion_sends_zero_in_the_old_type_first(wire, rotator):
    assert rotator.listeners == 0
    rotator.prepare(PLAIN)
    rotator.move(0.4)
    rotator.prepare(STAMPED)
    rotator.move(0.1)
    assert wire.received == [
        ("made", Twist),
        (Twist, 0.4),
        (Twist, 0.0),
        ("gone", Twist),
        ("made", TwistStamped),
        (TwistStamped, 0.1),
    ]
    assert rotator.listeners == 3


def test_a_change_of_type_at_rest_sends_nothing(wire, rotator):
    rotator.prepare(PLAIN)
    rotator.prepare(STAMPED)
    assert wire.received == [("made", Twist), ("gone", Twist), ("made", TwistStamped)]


def test_halting_sends_the_zeros_once(wire, rotator):
    rotator.prepare(PLAIN)
    rotator.move(0.4)
    rotator.halt()
    rotator.halt()
    rotator.move(0.4)
    assert wire.received[2:] == [(Twist, 0.0)] * LAST_ZEROS + ["acknowledged"]


@pytest.mark.parametrize("has_rested", [False, True])
def test_nothing_is_sent_at_the_end_to_a_robot_at_rest(wire, rotator, has_rested):
    rotator.prepare(PLAIN)
    if has_rested:
        rotator.move(0.0)
        rotator.rest()
    received = list(wire.received)
    rotator.halt()
    assert wire.received == received


def test_the_guard_is_told_each_command_and_dismissed_after_the_last_zeros(wire):
    asked = []

    def start(*what):
        asked.append(what)
        return Guard(wire.received)

    rotator = Rotator(wire, start)
    assert not rotator.is_guarded
    rotator.prepare(Rotation(True, 0.5, True, "base"))
    assert asked == [("/cmd_vel", True, "base")]
    assert rotator.is_guarded
    rotator.move(0.4)
    rotator.move(0.0)
    rotator.rest()
    reported = ["alive", (TwistStamped, 0.4), "alive", (TwistStamped, 0.0), "dismissed"]
    assert wire.received[1:] == reported
    assert not rotator.is_guarded


def test_after_a_halt_the_guard_ends_when_the_zeros_have_arrived(wire):
    rotator = Rotator(wire, lambda *_: Guard(wire.received))
    rotator.prepare(PLAIN)
    rotator.move(0.4)
    rotator.halt()
    assert wire.received[-3:] == [(Twist, 0.0), "acknowledged", "dismissed"]


def test_if_the_zeros_cannot_be_sent_the_guard_stays(wire):
    rotator = Rotator(wire, lambda *_: Guard(wire.received))
    rotator.prepare(PLAIN)
    rotator.move(0.4)
    Line.publish, publish = None, Line.publish
    try:
        rotator.halt()
    finally:
        Line.publish = publish
    assert "dismissed" not in wire.received


def test_a_guard_that_cannot_be_started_is_reported(wire):
    def fail(*_):
        raise OSError(12, "Cannot allocate memory")

    stated = []
    wire.get_logger = lambda: SimpleNamespace(error=stated.append)
    rotator = Rotator(wire, fail)
    rotator.prepare(PLAIN)
    assert not rotator.is_guarded
    assert "guard" in stated[0]
    assert "Cannot allocate memory" in stated[0]
