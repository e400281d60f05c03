"""The node's threads: one for the messages of the sensors, others for long computations.

For each message rclpy's executor gathers everything the node owns, builds a wait set of it and
makes a task of the callback, twice over: most of what a rclpy node costs. Here the sensors have a
wait set of their own that is kept, and a thread that waits for nothing else. It makes the calls
that rclpy's public `wait_for_message` makes, and no others of rclpy's inside; when one of them
fails, the sensors go back to rclpy's executor with all that lies in their queues.
"""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from functools import partial
from queue import SimpleQueue
from threading import Lock
from typing import Any, TypeVar

from rclpy.callback_groups import CallbackGroup
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
"""Matches every publisher. The usual depth of 5 loses messages of a fast IMU whenever the machine
is busy for some milliseconds, and the gyro's path with them."""

MOST_AT_ONCE = 16  # messages of one subscription that are taken before anything else has its turn

FOR_EVER = -1


class SensorGroup(CallbackGroup):
    """Keeps subscriptions from rclpy's executor while a thread of the `Spinner` serves them.

    Their events of the middleware (a publisher of another type) are kept from it too: in a wait set
    they are woken by each message. While `is_open`, as at first, rclpy's executor serves them.
    """

    def __init__(self) -> None:
        super().__init__()
        self.is_open = True

    def can_execute(self, _: Any) -> bool:
        """Whether rclpy's executor may wait for an entity."""
        return self.is_open

    def beginning_execution(self, _: Any) -> bool:
        """Whether rclpy's executor may call an entity's callback."""
        return self.is_open

    def ending_execution(self, _: Any) -> None:
        """Nothing has to be noted: one thread calls back at a time."""


class FairLock:
    """A lock that two threads get in turn whenever both want it.

    With a plain one, the thread that releases it and wants it again at once usually gets it again,
    and under a flood of messages a service would never be answered.
    """

    def __init__(self) -> None:
        self._held, self._next = Lock(), Lock()

    def __enter__(self) -> None:
        with self._next:
            self._held.acquire()

    def __exit__(self, *_: object) -> None:
        self._held.release()


class Spinner:
    """Serves a node, one callback at a time, and chosen subscriptions with the least effort.

    rclpy's executor finds what is ready, and the handlers it returns are called here, under a lock
    that is shared with a thread that serves the subscriptions. Messages of `unhurried` ones wake
    nothing and are taken with the next of the others. An error in a callback is noted and ends
    nothing. If a call of rclpy fails in that thread, rclpy's executor serves the subscriptions.
    """

    def __init__(
        self,
        node: Node,
        subscriptions: Sequence[Subscription],
        group: SensorGroup,
        note: Callable[[Exception], None],
        unhurried: Sequence[Subscription] = (),
    ) -> None:
        self._node, self._group, self._note_error = node, group, note
        self._awaited = tuple(subscriptions)
        self._subscriptions = (*subscriptions, *unhurried)
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
        """Wait until something is ready, at most so many seconds, and serve it.

        From the first call on the chosen subscriptions are served too, until the shutdown.
        """
        if not self._is_started:
            self._is_started = True
            self._start_thread()
        try:
            ready: Any = self._executor.wait_for_ready_callbacks(timeout_sec, None, self._has_ended)
        except (TimeoutException, ConditionReachedException, ShutdownException):
            return
        except MemoryError as error:  # a request that claims to be huge has taken it for a moment
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
        """Let `spin` and `spin_once` return, for good; from any thread."""
        self._is_over = True
        if self._thread.is_alive() and self._guard is not None:
            self._guard.trigger()
        self._wake()

    def shutdown(self, timeout_sec: float | None = None) -> bool:
        """Stop; returns whether the callbacks of the subscriptions have ended in time."""
        self.end()
        if self._thread.is_alive() and self._thread is not threading.current_thread():
            self._thread.join(timeout_sec)
        has_ended = not self._thread.is_alive()
        with self._waking:
            return self._executor.shutdown(timeout_sec) and has_ended

    def _wake(self) -> None:
        # Not while the shutdown destroys what it is woken by.
        with self._waking:
            self._executor.wake()

    def _has_ended(self) -> bool:
        # Given another function, rclpy forgets all else that was ready.
        return self._is_over

    def _look_at(self, handler: Future) -> None:
        self._waiting.discard(handler)
        error = handler.exception()
        if error is not None:
            self._note(error)

    def _note(self, error: Exception) -> None:
        # The context may go away in the middle of a callback: that is an end, no fault.
        if self._node.context.ok():
            self._note_error(error)

    def _start_thread(self) -> None:
        try:
            # One of the node would be gone with it, and nothing left to end the thread with.
            self._guard = GuardCondition(None, None, context=self._node.context)
            self._group.is_open = False
            self._thread.start()
        except Exception as error:
            self._hand_back(error)

    def _run(self) -> None:
        try:
            self._serve()
        except Exception as error:
            # When the context is gone its parts fail, and there is nothing left to serve.
            if self._node.context.ok() and not self._is_over:
                self._hand_back(error)

    def _hand_back(self, error: Exception) -> None:
        self._group.is_open = True
        self._node.get_logger().warning(
            f"this version of rclpy is not known ({type(error).__name__}: {error}): rclpy's own "
            "executor serves the sensors from now on, with more CPU load"
        )
        self._wake()

    def _serve(self) -> None:
        # Imported where its absence can be survived.
        from rclpy.impl.implementation_singleton import rclpy_implementation

        assert self._guard is not None
        # Their types promise less than there is.
        context: Any = self._node.context
        new_wait_set: Any = rclpy_implementation.WaitSet
        guard = self._guard.handle
        served: list[Any] = [subscription.handle for subscription in self._subscriptions]
        handles: list[Any] = [subscription.handle for subscription in self._awaited]
        with ExitStack() as in_use:
            for handle in (context.handle, guard, *served):
                # Nothing of it is destroyed while it is waited for.
                in_use.enter_context(handle)
            wait_set = new_wait_set(len(handles), 1, 0, 0, 0, 0, context.handle)
            while not self._is_over and context.ok():
                wait_set.clear_entities()
                for handle in handles:
                    wait_set.add_subscription(handle)
                wait_set.add_guard_condition(guard)
                wait_set.wait(FOR_EVER)
                with self._lock:
                    for subscription in self._subscriptions:
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
    """Free the callback group of what failed before its callback: rclpy leaves it taken."""
    group = None if entity is None else entity.callback_group
    if group is not None and not group.can_execute(entity):
        group.ending_execution(entity)


T = TypeVar("T")

Done = Callable[[], object]


class BackgroundThread:
    """Runs one job after another in a thread; what follows runs in the executor.

    The thread starts with the first job. It does not delay the end of the process: a disk that does
    not answer may block it for ever. If no thread can be started, the job fails with that error.
    """

    def __init__(self, node: Node, name: str) -> None:
        self._node, self._name = node, name
        self._waiting: SimpleQueue[Callable[[], Done]] = SimpleQueue()
        self._done: SimpleQueue[Done] = SimpleQueue()
        self._thread: threading.Thread | None = None

    def run(
        self,
        work: Callable[[], T],
        then: Callable[[T], object],
        otherwise: Callable[[Exception], object],
    ) -> None:
        """Do some work, then go on in the executor's thread."""

        def job() -> Done:
            try:
                result = work()
            except Exception as error:  # the caller handles it
                return partial(otherwise, error)
            return partial(then, result)

        # Where memory is short the thread itself may end in an error.
        if self._thread is None or not self._thread.is_alive():
            thread = threading.Thread(target=self._work, name=self._name, daemon=True)
            try:
                thread.start()
            except RuntimeError as error:
                self._hand_over(partial(otherwise, error))
                return
            self._thread = thread
        self._waiting.put(job)

    def deliver(self) -> None:
        """Hand over what is done; the executor calls it, and a heartbeat may."""
        while not self._done.empty():
            self._done.get()()

    def finish_within(self, patience: float) -> bool:
        """Wait so many seconds for the work that was asked for; returns whether it is done."""
        if self._thread is None:
            return True
        is_done = threading.Event()

        def last() -> Done:
            is_done.set()
            return lambda: None

        self._waiting.put(last)
        return is_done.wait(patience)

    def _work(self) -> None:
        while True:
            self._hand_over(self._waiting.get()())

    def _hand_over(self, done: Done) -> None:
        self._done.put(done)
        executor = self._node.executor
        # One that is shut down at this moment has lost what wakes it; nothing waits any more.
        with contextlib.suppress(Exception):
            if executor is not None:
                executor.create_task(self.deliver)
