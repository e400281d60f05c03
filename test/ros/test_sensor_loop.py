"""The loop of the sensors: no message is lost, and rclpy's executor is used if necessary."""

import contextlib
import itertools
import threading
import time

import other_rclpy
import pytest
import rclpy
from rclpy.duration import Duration
from rclpy.serialization import deserialize_message
from std_msgs.msg import Float64
from support import PATIENCE, wait_until

from magcal_ros.ros.threads import MOST_AT_ONCE, SensorGroup, Spinner


def number_in(data):
    return deserialize_message(data, Float64).data


class Served:
    """A node that receives numbers, spun in a thread like the executable."""

    def __init__(self):
        self.node = rclpy.create_node("served")
        self.group, self.received, self.errors = SensorGroup(), [], []
        self.group.subscribe(self.node, Float64, "number", self.hear)
        self.aside = []
        self.group.subscribe(
            self.node, Float64, "aside", lambda data: self.aside.append(number_in(data)), False
        )
        self.spinner = Spinner(self.node, self.group, self.errors.append)
        self.thread = threading.Thread(target=self.spinner.spin, daemon=True)
        self.on_number = self.received.append

    def hear(self, data):
        self.on_number(number_in(data))

    def close(self):
        assert self.spinner.shutdown(timeout_sec=PATIENCE)
        if self.thread.ident:
            self.thread.join(PATIENCE)
        assert not self.thread.is_alive()
        self.node.destroy_node()


@pytest.fixture
def served(graph):
    """Return a node that is not spun yet."""
    served = Served()
    yield served
    served.close()


@contextlib.contextmanager
def publishing(topic):
    """Publish numbers with what is given, which waits until they lie before the node."""
    node = rclpy.create_node("outside")
    publisher = node.create_publisher(Float64, topic, 100)
    wait_until(publisher.get_subscription_count)

    def publish(*values):
        for value in values:
            publisher.publish(Float64(data=float(value)))
        assert publisher.wait_for_all_acked(Duration(seconds=PATIENCE))

    yield publish
    node.destroy_node()


@pytest.fixture
def number(served):
    """Return a function that publishes numbers to the node."""
    with publishing("number") as publish:
        yield publish


@pytest.fixture
def warnings(served, monkeypatch):
    """Return the warnings of the node."""
    lines = []
    logger = served.node.get_logger()
    monkeypatch.setattr(logger, "warning", lines.append)
    monkeypatch.setattr(served.node, "get_logger", lambda: logger)
    return lines


def test_low_priority_messages_are_taken_with_the_next_others(served, number):
    with publishing("aside") as aside:
        served.thread.start()
        number(1.0)
        wait_until(lambda: served.received == [1.0])
        aside(*range(40))
        time.sleep(0.2)
        assert served.aside == []
        for step in range(10):
            number(step)
            wait_until(lambda: len(served.received) == step + 2)  # noqa: B023
        wait_until(lambda: served.aside == list(range(40)))


def test_every_message_is_delivered_once_and_in_order(served, number):
    served.thread.start()
    number(*range(80))
    wait_until(lambda: len(served.received) >= 80)
    time.sleep(0.05)
    assert served.received == list(range(80))
    assert not served.group.is_open


@pytest.mark.parametrize("uses", [0, 7])
@pytest.mark.parametrize(("owner", "name"), other_rclpy.CALLS)
def test_a_missing_function_leaves_the_work_to_rclpy(served, number, warnings, owner, name, uses):
    """At once or in mid-spin: each message once, in order, and one line about it."""
    bring_back = other_rclpy.vanish(owner, name, uses)
    try:
        served.thread.start()
        for k in range(80):
            number(k)
            time.sleep(0.002)
        wait_until(lambda: len(served.received) >= 80)
        time.sleep(0.05)
    finally:
        bring_back()
    assert served.received == list(range(80))
    assert served.group.is_open
    assert not served.errors
    assert len(warnings) == 1
    assert name in warnings[0]
    assert "rclpy's own executor serves the sensors from now on" in warnings[0]


def test_an_rclpy_without_a_wait_set_uses_its_executor(served, number, warnings, monkeypatch):
    from rclpy.impl import implementation_singleton

    with monkeypatch.context() as patched:
        patched.delattr(implementation_singleton, "rclpy_implementation")
        served.thread.start()
        wait_until(lambda: warnings)
    number(1)
    wait_until(lambda: served.received == [1.0])


def test_an_error_in_a_callback_is_not_taken_for_one_of_rclpy(served, number, warnings):
    def fail_at_odd_numbers(value):
        if value % 2.0:
            # Like a failure inside rclpy.
            raise AttributeError("of the callback's own")
        served.received.append(value)

    served.on_number = fail_at_odd_numbers
    served.thread.start()
    number(*range(40))
    wait_until(lambda: len(served.received) == 20)
    assert len(served.errors) == 20
    assert not warnings
    assert not served.group.is_open


def test_a_flood_is_processed_in_parts(served, number, monkeypatch):
    """Between any two parts another thread may have the lock."""
    turns = []

    class Lock:
        def __enter__(self):
            turns.append(len(served.received))

        def __exit__(self, *_):
            pass

    served.spinner._lock = Lock()
    number(*range(90))
    served.thread.start()
    wait_until(lambda: len(served.received) == 90)
    assert max(b - a for a, b in itertools.pairwise(turns)) == MOST_AT_ONCE


def test_a_node_works_with_any_executor(served, number):
    executor = rclpy.executors.SingleThreadedExecutor()
    executor.add_node(served.node)
    number(5)
    wait_until(lambda: executor.spin_once(timeout_sec=0.05) or served.received == [5.0])
    executor.shutdown()


def test_a_loop_ended_before_its_start_ends(served, number):
    served.spinner.end()
    served.thread.start()
    served.thread.join(PATIENCE)
    assert not served.thread.is_alive()
    number(1)
    time.sleep(0.1)
    assert not served.received
