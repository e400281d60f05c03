"""Two loops, one callback at a time: fair, in order, and without idle wake-ups."""

import contextlib
import threading
import time

import pytest
import rclpy
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.task import Future
from std_msgs.msg import Float64
from std_srvs.srv import Trigger
from support import PATIENCE, wait_until
from test_sensor_loop import Served


@pytest.fixture
def served(graph):
    """Return a node that is spun in a thread."""
    served = Served()
    served.thread.start()
    yield served
    served.close()


@pytest.fixture
def outside(graph):
    """Return another node in the graph."""
    node = rclpy.create_node("outside")
    yield node
    node.destroy_node()


@pytest.fixture
def ask(outside):
    """Return a function that calls a service and returns the future of its answer."""
    executor = SingleThreadedExecutor()
    executor.add_node(outside)
    thread = threading.Thread(target=executor.spin, daemon=True)

    def call(name):
        client = outside.create_client(Trigger, name)
        assert client.wait_for_service(PATIENCE)
        if not thread.is_alive():
            thread.start()
        return client.call_async(Trigger.Request())

    yield call
    executor.shutdown()
    thread.join(PATIENCE)


def flood(served):
    """Publish another number for each received one, a dozen at a time."""
    publisher = served.node.create_publisher(Float64, "number", 100)

    def follow(value):
        served.received.append(value)
        publisher.publish(Float64(data=value))

    served.on_number = follow
    wait_until(publisher.get_subscription_count)
    for k in range(12):
        publisher.publish(Float64(data=float(k)))


def test_timers_and_services_run_during_a_flood(served, ask):
    """The flood never ends, so waiting for its end would never return."""
    ticks = []
    served.node.create_timer(0.02, lambda: ticks.append(len(served.received)))
    served.node.create_service(Trigger, "answer", lambda _, response: response)
    flood(served)
    for _ in range(10):
        wait_until(ask("answer").done)
    wait_until(lambda: len(ticks) > 20)
    wait_until(lambda: len(served.received) > max(500, ticks[20]))


def test_callbacks_never_overlap(served):
    inside, overlaps, slow = [0], [0], [0]

    def work(seconds):
        inside[0] += 1
        overlaps[0] += inside[0] > 1
        time.sleep(seconds)
        inside[0] -= 1

    def tick():
        slow[0] += 1
        work(0.005)

    served.node.create_timer(0.005, tick)
    flood(served)
    follow = served.on_number

    def number(value):
        work(0.0002)
        follow(value)

    served.on_number = number
    wait_until(lambda: slow[0] > 40)
    assert overlaps == [0]


@pytest.mark.parametrize("by", ["a timer", "a sensor", "another thread"])
def test_a_coroutine_that_waits_is_resumed(served, outside, ask, by):
    done = Future(executor=served.node.executor)

    async def wait(_, response):
        response.success = await done
        return response

    served.node.create_service(Trigger, "wait", wait, callback_group=ReentrantCallbackGroup())
    answer = ask("wait")
    time.sleep(0.3)
    assert not answer.done()
    # As the node's own services do.
    done.add_done_callback(lambda _: None)
    if by == "a timer":
        timer = served.node.create_timer(0.1, lambda: (timer.cancel(), done.set_result(True)))
    elif by == "a sensor":
        served.on_number = lambda _: done.set_result(True)
        publisher = outside.create_publisher(Float64, "number", 10)
        wait_until(publisher.get_subscription_count)
        publisher.publish(Float64())
    else:
        done.set_result(True)
    wait_until(answer.done)
    assert answer.result().success


def test_entities_created_and_destroyed_while_it_waits_are_noticed(served, outside):
    received = []
    publisher = outside.create_publisher(Float64, "late", 10)
    for _ in range(5):
        received.clear()
        subscription = served.node.create_subscription(Float64, "late", received.append, 10)
        wait_until(lambda: publisher.publish(Float64()) or received)
        served.node.destroy_subscription(subscription)


def test_an_error_in_a_callback_is_noted_and_others_continue(served, ask):
    def fail(*_):
        raise ZeroDivisionError

    async def fail_later(_, __):
        raise LookupError

    ticks = []
    timer = served.node.create_timer(0.02, fail)
    served.node.create_service(Trigger, "fail", fail)
    served.node.create_service(Trigger, "fail_later", fail_later)
    served.node.create_service(Trigger, "answer", lambda _, response: response)
    wait_until(lambda: len(served.errors) > 3)
    timer.cancel()
    served.node.create_timer(0.02, lambda: ticks.append(0))
    ask("fail")
    ask("fail_later")
    wait_until(lambda: any(isinstance(error, LookupError) for error in served.errors))
    wait_until(ask("answer").done)
    wait_until(lambda: ticks)


def test_an_error_of_a_coroutine_that_waited_is_noted_once(served, ask):
    done = Future(executor=served.node.executor)

    async def fail_in_the_end(_, __):
        await done
        raise LookupError

    served.node.create_service(Trigger, "fail", fail_in_the_end)
    ask("fail")
    time.sleep(0.3)
    assert not served.errors
    timer = served.node.create_timer(0.1, lambda: (timer.cancel(), done.set_result(None)),
                                     callback_group=ReentrantCallbackGroup())  # fmt: skip
    wait_until(lambda: served.errors)
    time.sleep(0.1)
    assert [type(error) for error in served.errors] == [LookupError]


def test_a_failure_before_a_callback_releases_its_group(served, outside, monkeypatch):
    """A message that rclpy cannot take: the timers of the same group go on."""
    ticks = []
    served.node.create_timer(0.02, lambda: ticks.append(0))
    odd = served.node.create_subscription(Float64, "odd", print, 10)
    sound = rclpy_implementation.Subscription.take_message

    def fail_for_odd(handle, kind, raw):
        if handle.pointer == odd.handle.pointer:
            raise MemoryError
        return sound(handle, kind, raw)

    monkeypatch.setattr(rclpy_implementation.Subscription, "take_message", fail_for_odd)
    publisher = outside.create_publisher(Float64, "odd", 10)
    wait_until(publisher.get_subscription_count)
    publisher.publish(Float64())
    wait_until(lambda: served.errors)
    assert isinstance(served.errors[0], MemoryError)
    ticks.clear()
    wait_until(lambda: len(ticks) > 3)


def test_the_end_of_the_context_ends_the_spin(graph):
    served = Served()
    ended = []

    def spin():
        with contextlib.suppress(ExternalShutdownException):
            served.spinner.spin()
        ended.append(True)

    thread = threading.Thread(target=spin, daemon=True)
    thread.start()
    time.sleep(0.2)
    rclpy.shutdown()
    thread.join(PATIENCE)
    assert ended
    assert not served.errors
    assert served.spinner.shutdown(timeout_sec=PATIENCE)


def test_end_returns_from_an_idle_spin(graph):
    for _ in range(20):
        served = Served()
        served.thread.start()
        time.sleep(0.01)
        served.close()


@pytest.fixture
def awakenings(monkeypatch):
    """Return a list that grows each time something in this process has waited for rclpy."""
    wait, times = rclpy_implementation.WaitSet.wait, []

    def counted(*arguments):
        times.append(0)
        return wait(*arguments)

    monkeypatch.setattr(rclpy_implementation.WaitSet, "wait", counted)
    return times


def test_no_thread_wakes_up_while_idle(served, awakenings):
    time.sleep(0.3)
    awakenings.clear()
    time.sleep(0.5)
    assert len(awakenings) < 10


def test_a_callback_that_waits_for_its_group_does_not_wake_the_executor(served, ask, awakenings):
    never, is_held = Future(executor=served.node.executor), []

    async def hold(_, response):
        is_held.append(True)
        await never
        return response

    served.node.create_service(Trigger, "hold", hold)
    ticks = []
    served.node.create_timer(0.01, lambda: ticks.append(0))
    ask("hold")
    wait_until(lambda: is_held)
    time.sleep(0.3)
    ticks.clear()
    awakenings.clear()
    time.sleep(0.5)
    # An executor that finds the timer ready again and again comes here hundreds of times.
    assert len(awakenings) < 10
    assert not ticks
