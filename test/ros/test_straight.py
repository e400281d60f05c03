"""The sensors' executor: nothing lost, nothing starved, and rclpy's own where it must."""

import contextlib
import threading
import time

import pytest
import rclpy
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.task import Future
from std_msgs.msg import Float64
from std_srvs.srv import Trigger

from magcal_ros.ros import straight
from magcal_ros.ros.straight import StraightExecutor, executor_for


@pytest.fixture
def served(graph):
    """Return a node that is served, what it heard, and its executor."""
    node = rclpy.create_node("served")
    heard = []
    subscription = node.create_subscription(Float64, "number", heard.append, 50)
    executor = executor_for(node, [subscription])
    assert isinstance(executor, StraightExecutor)
    yield node, heard, executor
    executor.shutdown()
    node.destroy_node()


@pytest.fixture
def outside(graph):
    """Return another node in the graph."""
    node = rclpy.create_node("outside")
    yield node
    node.destroy_node()


def spin_until(executor, condition, patience=5.0):
    deadline = time.monotonic() + patience
    while not condition():
        assert time.monotonic() < deadline, "it did not happen in time"
        executor.spin_once(timeout_sec=0.05)


def connected(publisher):
    return lambda: publisher.get_subscription_count() > 0


def test_every_message_comes_once_and_in_order(served, outside):
    _, heard, executor = served
    publisher = outside.create_publisher(Float64, "number", 50)
    spin_until(executor, connected(publisher))
    for k in range(40):
        publisher.publish(Float64(data=float(k)))
    spin_until(executor, lambda: len(heard) >= 40)
    executor.spin_once(timeout_sec=0.05)
    assert [message.data for message in heard] == [float(k) for k in range(40)]


def test_timers_and_services_have_their_turn_under_a_flood(served, outside):
    node, heard, executor = served
    ticks = []
    node.create_timer(0.02, lambda: ticks.append(0))
    node.create_service(Trigger, "ask", lambda _, response: response)
    publisher = node.create_publisher(Float64, "number", 50)
    spin_until(executor, connected(publisher))
    subscription = next(each for each in node.subscriptions if each.topic_name == "/number")

    def flood(message):
        heard.append(message)
        publisher.publish(message)

    subscription.callback = flood
    client = outside.create_client(Trigger, "ask")
    publisher.publish(Float64())
    assert client.wait_for_service(5.0)
    answer = client.call_async(Trigger.Request())
    others = SingleThreadedExecutor()
    others.add_node(outside)

    def is_done():
        others.spin_once(timeout_sec=0.0)
        return answer.done() and len(ticks) > 5 and len(heard) > 100

    spin_until(executor, is_done)


def test_a_coroutine_that_waits_is_resumed(served, outside):
    node, _, executor = served
    done = Future(executor=executor)

    async def wait(_, response):
        response.success = await done
        return response

    node.create_service(Trigger, "wait", wait, callback_group=ReentrantCallbackGroup())
    clock = node.create_timer(0.3, lambda: done.set_result(True))
    client = outside.create_client(Trigger, "wait")
    others = SingleThreadedExecutor()
    others.add_node(outside)
    assert client.wait_for_service(5.0)
    answer = client.call_async(Trigger.Request())

    def is_answered():
        if done.done():
            clock.cancel()
        others.spin_once(timeout_sec=0.0)
        return answer.done()

    spin_until(executor, is_answered)
    assert answer.result().success


def test_what_is_created_and_destroyed_while_it_waits_is_noticed(served, outside):
    node, _, executor = served
    thread = threading.Thread(target=executor.spin, daemon=True)
    thread.start()
    heard = []
    publisher = outside.create_publisher(Float64, "late", 10)
    for _ in range(5):
        heard.clear()
        subscription = node.create_subscription(Float64, "late", heard.append, 10)
        deadline = time.monotonic() + 5.0
        while not heard and time.monotonic() < deadline:
            publisher.publish(Float64())
            time.sleep(0.02)
        assert heard
        node.destroy_subscription(subscription)
    executor.shutdown()
    thread.join(5.0)
    assert not thread.is_alive()


def test_a_fault_in_a_callback_comes_out_of_spin(served, outside):
    node, _, executor = served
    publisher = outside.create_publisher(Float64, "number", 10)
    spin_until(executor, connected(publisher))

    def fail(_):
        raise ZeroDivisionError

    next(iter(node.subscriptions)).callback = fail
    publisher.publish(Float64())
    with pytest.raises(ZeroDivisionError):
        spin_until(executor, lambda: False)


def test_the_end_of_the_context_ends_the_spin(served):
    _, _, executor = served
    ended = []

    def spin():
        with contextlib.suppress(ExternalShutdownException):
            executor.spin()
        ended.append(True)

    thread = threading.Thread(target=spin, daemon=True)
    thread.start()
    time.sleep(0.2)
    rclpy.shutdown()
    thread.join(5.0)
    assert ended


def test_an_rclpy_that_is_another_inside_serves_itself(graph, monkeypatch):
    monkeypatch.setattr(straight, "IMPLEMENTATION", object())
    node = rclpy.create_node("served")
    executor = executor_for(node, [])
    assert type(executor) is SingleThreadedExecutor
    assert executor.get_nodes() == [node]
    executor.shutdown()
    node.destroy_node()


def test_what_waits_for_its_group_does_not_keep_the_executor_awake(served, outside):
    node, _, executor = served
    never = Future(executor=executor)

    async def hold(_, response):
        await never
        return response

    node.create_service(Trigger, "hold", hold)
    ticks = []
    node.create_timer(0.01, lambda: ticks.append(0))
    client = outside.create_client(Trigger, "hold")
    assert client.wait_for_service(5.0)
    client.call_async(Trigger.Request())
    for _ in range(50):
        executor.spin_once(timeout_sec=0.01)
    ticks.clear()
    used = time.thread_time()
    executor.spin_once(timeout_sec=0.5)
    executor.spin_once(timeout_sec=0.5)
    assert time.thread_time() - used < 0.25
    assert not ticks
