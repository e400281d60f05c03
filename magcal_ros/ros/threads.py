"""The node's threads: one for the messages of the sensors, others for long computations.

For each message, rclpy's executor collects all entities of the node, builds a wait set and creates
a task for the callback, twice. This is most of the CPU load of a rclpy node. Here a thread waits
for the sensors only, with a wait set that is kept. It uses only those internals of rclpy that the
public `wait_for_message` uses. If one of these calls fails, rclpy's executor serves the sensors
again, and the messages in their queues are not lost.
"""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable
from contextlib import ExitStack
from functools import partial
from queue import SimpleQueue
from threading import Lock
from typing import Any, TypeVar

from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.executors import (
    ConditionReachedException,
    ShutdownException,
    SingleThreadedExecutor,
    TimeoutException,
)
from rclpy.guard_condition import GuardCondition
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.subscription import Subscription
from rclpy.task import Future

SENSOR_DATA = QoSProfile(depth=100, reliability=ReliabilityPolicy.BEST_EFFORT)
"""Compatible with every publisher. With the usual depth of 5, messages of a fast IMU would be lost
when the machine is busy for some milliseconds, and then the gyro cannot be integrated."""

MOST_AT_ONCE = 16  # messages of one subscription that are taken before other callbacks are served

FOR_EVER = -1


class SensorGroup(MutuallyExclusiveCallbackGroup):
    """A callback group that rclpy's executor ignores while a thread of the `Spinner` serves it.

    The events of its subscriptions (a publisher of another type) are ignored too, because each
    message would wake them. While `is_open`, as at first, rclpy's executor serves the group.
    Messages of `unhurried` subscriptions do not wake the thread; they are taken with the next
    message of the `urgent` ones.
    """

    def __init__(self) -> None:
        super().__init__()
        self.is_open = True
        self.urgent: list[Subscription] = []
        self.unhurried: list[Subscription] = []

    def subscribe(
        self,
        node: Node,
        kind: type,
        topic: str,
        take: Callable[[bytes], None],
        is_urgent: bool = True,
    ) -> None:
        """Subscribe to the serialized messages on a topic, before the group is served."""
        subscription = node.create_subscription(
            kind, topic, take, SENSOR_DATA, raw=True, callback_group=self
        )
        (self.urgent if is_urgent else self.unhurried).append(subscription)

    def can_execute(self, entity: Any) -> bool:
        """Whether rclpy's executor may wait for an entity."""
        return self.is_open and super().can_execute(entity)


class FairLock:
    """A lock that two threads acquire alternately whenever both wait for it.

    A plain lock is usually acquired again by the thread that has just released it. With very many
    messages a service would then never be answered.
    """

    def __init__(self) -> None:
        self._held, self._next = Lock(), Lock()

    def __enter__(self) -> None:
        with self._next:
            self._held.acquire()

    def __exit__(self, *_: object) -> None:
        self._held.release()


class Spinner:
    """Runs the callbacks of a node one at a time, and serves those of a group efficiently.

    rclpy's executor waits for the other entities and returns their handlers. A thread serves the
    subscriptions of the group, and a lock prevents simultaneous callbacks. After an error in a
    callback, which is passed to `note`, the node continues. If a call of rclpy fails in the thread,
    rclpy's executor serves the group.
    """

    def __init__(self, node: Node, group: SensorGroup, note: Callable[[Exception], None]) -> None:
        self._node, self._group, self._note_error = node, group, note
        self._is_over = self._is_started = False
        self._lock, self._waking = FairLock(), Lock()
        self._waiting: set[Future] = set()
        self._executor = SingleThreadedExecutor(context=node.context)
        self._executor.add_node(node)
        self._guard: GuardCondition | None = None
        self._thread = threading.Thread(target=self._run, name="magcal-sensors", daemon=True)

    def spin(self) -> None:
        """Serve the node until `end` is called; ExternalShutdownException if the context ends."""
        while self._node.context.ok() and not self._is_over:
            self.spin_once()

    def spin_once(self, timeout_sec: float | None = None) -> None:
        """Wait at most `timeout_sec` seconds for one ready entity, and serve it.

        The first call starts the thread of the group.
        """
        if not self._is_started:
            self._is_started = True
            self._start_thread()
        try:
            ready: Any = self._executor.wait_for_ready_callbacks(timeout_sec, None, self._has_ended)
        except (TimeoutException, ConditionReachedException, ShutdownException):
            return
        except MemoryError as error:  # a malformed request that claims a huge size
            self._note(error)
            return
        handler, entity, _ = ready
        with self._lock:
            handler()
            if handler in self._waiting:
                return
            if handler.done():
                self._look_at(handler)
                if handler.exception() is not None:
                    _release(entity)
            else:
                # rclpy decides by which handler a coroutine is resumed.
                self._waiting.add(handler)
                handler.add_done_callback(self._look_at)

    def end(self) -> None:
        """Make `spin` and `spin_once` return, now and later; from any thread."""
        self._is_over = True
        if self._thread.is_alive() and self._guard is not None:
            self._guard.trigger()
        self._wake()

    def shutdown(self, timeout_sec: float | None = None) -> bool:
        """Stop serving; returns whether the running callback has ended in time."""
        self.end()
        if self._thread.is_alive() and self._thread is not threading.current_thread():
            self._thread.join(timeout_sec)
        has_ended = not self._thread.is_alive()
        with self._waking:
            return self._executor.shutdown(timeout_sec) and has_ended

    def _wake(self) -> None:
        # The lock excludes the shutdown, which destroys the executor's guard condition.
        with self._waking:
            self._executor.wake()

    def _has_ended(self) -> bool:
        # Always the same function: with another one rclpy discards the other ready entities.
        return self._is_over

    def _look_at(self, handler: Future) -> None:
        self._waiting.discard(handler)
        error = handler.exception()
        if error is not None:
            self._note(error)

    def _note(self, error: Exception) -> None:
        # If the context was shut down during a callback, the error is no fault.
        if self._node.context.ok():
            self._note_error(error)

    def _start_thread(self) -> None:
        try:
            # A guard condition of the node would be destroyed with the node, and could then not
            # end the thread.
            self._guard = GuardCondition(None, None, context=self._node.context)
            self._group.is_open = False
            self._thread.start()
        except Exception as error:
            self._hand_back(error)

    def _run(self) -> None:
        try:
            self._serve()
        except Exception as error:
            # Errors after the shutdown of the context are expected.
            if self._node.context.ok() and not self._is_over:
                self._hand_back(error)

    def _hand_back(self, error: Exception) -> None:
        self._group.is_open = True
        self._node.get_logger().warning(
            f"this version of rclpy is not supported ({type(error).__name__}: {error}): "
            "rclpy's own executor serves the sensors from now on, with more CPU load"
        )
        self._wake()

    def _serve(self) -> None:
        # Imported here, because the caller handles a failure.
        from rclpy.impl.implementation_singleton import rclpy_implementation

        assert self._guard is not None
        # rclpy's type hints lack the methods that are used here.
        context: Any = self._node.context
        new_wait_set: Any = rclpy_implementation.WaitSet
        guard = self._guard.handle
        handles: list[Any] = [subscription.handle for subscription in self._group.urgent]
        subscriptions = (*self._group.urgent, *self._group.unhurried)
        with ExitStack() as in_use:
            for handle in (context.handle, guard, *(each.handle for each in subscriptions)):
                # Handles must not be destroyed during the wait.
                in_use.enter_context(handle)
            wait_set = new_wait_set(len(handles), 1, 0, 0, 0, 0, context.handle)
            while not self._is_over and context.ok():
                wait_set.clear_entities()
                for handle in handles:
                    wait_set.add_subscription(handle)
                wait_set.add_guard_condition(guard)
                wait_set.wait(FOR_EVER)
                with self._lock:
                    for subscription in subscriptions:
                        if not self._is_over:
                            self._hand_on(subscription)

    def _hand_on(self, subscription: Any) -> None:
        take, kind, raw = subscription.handle.take_message, subscription.msg_type, subscription.raw
        for _ in range(MOST_AT_ONCE):
            taken = take(kind, raw)
            if taken is None:
                return
            message = taken[0]
            try:
                subscription.callback(message)
            except Exception as error:
                self._note(error)


def _release(entity: Any) -> None:
    """Free the callback group of an entity that failed before its callback; rclpy does not."""
    group = None if entity is None else entity.callback_group
    if group is not None and not group.can_execute(entity):
        group.ending_execution(entity)


T = TypeVar("T")

Job = tuple[Callable[[], Any], Callable[[Any], object], Callable[[Exception], object]]
"""Work, and what to do with its result or its error."""


class BackgroundThread:
    """Runs one job after another in a thread; the results are handled in the executor's thread.

    The thread starts with the first job. It is a daemon thread, because a blocked disk must not
    prevent the end of the process. If no thread can be started, the job fails with that error.
    """

    def __init__(self, node: Node, name: str) -> None:
        self._node, self._name = node, name
        self._waiting: SimpleQueue[Job] = SimpleQueue()
        self._done: SimpleQueue[Callable[[], object]] = SimpleQueue()
        self._thread: threading.Thread | None = None

    def run(
        self,
        work: Callable[[], T],
        then: Callable[[T], object],
        otherwise: Callable[[Exception], object],
    ) -> None:
        """Run `work` in the thread, then `then` or `otherwise` in the executor's thread."""
        # The thread may have ended by an error, for example without free memory.
        if self._thread is None or not self._thread.is_alive():
            thread = threading.Thread(target=self._work, name=self._name, daemon=True)
            try:
                thread.start()
            except RuntimeError as error:
                self._hand_over(partial(otherwise, error))
                return
            self._thread = thread
        self._waiting.put((work, then, otherwise))

    def deliver(self) -> None:
        """Handle the results of finished jobs, in the executor's thread."""
        while not self._done.empty():
            self._done.get()()

    def finish_within(self, patience: float) -> bool:
        """Wait at most `patience` seconds for all jobs; returns whether they are finished."""
        if self._thread is None:
            return True
        is_done = threading.Event()
        self.run(is_done.set, lambda _: None, lambda _: None)
        return is_done.wait(patience)

    def _work(self) -> None:
        while True:
            work, then, otherwise = self._waiting.get()
            try:
                done = partial(then, work())
            except Exception as error:  # the caller handles it
                done = partial(otherwise, error)
            self._hand_over(done)

    def _hand_over(self, done: Callable[[], object]) -> None:
        self._done.put(done)
        executor = self._node.executor
        # Waking an executor that is being shut down fails, and no result is needed then.
        with contextlib.suppress(Exception):
            if executor is not None:
                executor.create_task(self.deliver)
