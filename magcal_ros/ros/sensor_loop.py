"""A loop of its own for the sensors' messages.

For each message rclpy's executor gathers everything the node owns, builds a wait set of it and
makes a task of the callback, twice over: most of what a rclpy node costs. Here the sensors have a
wait set of their own that is kept, and a thread that waits for nothing else. It makes the calls
that rclpy's public `wait_for_message` makes, and no others of rclpy's inside; when one of them
fails, the sensors go back to rclpy's executor with all that lies in their queues.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, ExitStack
from typing import Any

from rclpy.callback_groups import CallbackGroup
from rclpy.guard_condition import GuardCondition
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.subscription import Subscription

SENSOR_DATA = QoSProfile(depth=100, reliability=ReliabilityPolicy.BEST_EFFORT)
"""Matches every publisher. The usual depth of 5 loses messages of a fast IMU whenever the machine
is busy for some milliseconds, and the gyro's path with them."""

MOST_AT_ONCE = 16
"""Messages of one subscription that are taken before anything else has its turn."""

FOR_EVER = -1


class SensorGroup(CallbackGroup):
    """Keeps subscriptions from rclpy's executor for as long as somebody else serves them.

    Their events of the middleware (a publisher of another type) are kept from it too: in a wait set
    they are woken by each message.

    Attributes
    ----------
    is_open : bool
        Whether rclpy's executor serves them, as it does until a `SensorLoop` takes over.
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


class SensorLoop:
    """A thread that takes the messages of chosen subscriptions and calls back, under a lock.

    `note` is given what a callback raised; the loop goes on. `give_up` is called in the loop's
    thread, with the group open again, where a call of rclpy has failed. Messages of `unhurried`
    subscriptions wake nobody and are taken with the next of the others.
    """

    def __init__(
        self,
        node: Node,
        subscriptions: Sequence[Subscription],
        group: SensorGroup,
        lock: AbstractContextManager[None],
        note: Callable[[Exception], None],
        give_up: Callable[[Exception], None],
        unhurried: Sequence[Subscription] = (),
    ) -> None:
        self._node = node
        self._awaited = tuple(subscriptions)
        self._subscriptions = (*subscriptions, *unhurried)
        self._group = group
        self._lock = lock
        self._note = note
        self._give_up = give_up
        self._is_over = False
        self._guard: GuardCondition | None = None
        self._thread = threading.Thread(target=self._run, name="magcal-sensors", daemon=True)

    def start(self) -> None:
        """Take the subscriptions over."""
        try:
            # One of the node would be gone with it, and nothing left to end the thread with.
            self._guard = GuardCondition(None, None, context=self._node.context)
            self._group.is_open = False
            self._thread.start()
        except Exception as error:
            self._hand_back(error)

    def end(self) -> None:
        """Serve nothing any more once the callback that runs has returned; from any thread."""
        self._is_over = True
        if self._thread.is_alive() and self._guard is not None:
            self._guard.trigger()

    def join(self, timeout: float | None = None) -> bool:
        """Wait until the thread has ended; returns whether it has."""
        if self._thread.is_alive() and self._thread is not threading.current_thread():
            self._thread.join(timeout)
        return not self._thread.is_alive()

    def _run(self) -> None:
        try:
            self._serve()
        except Exception as error:
            # When the context is gone its parts fail, and there is nothing left to serve.
            if self._node.context.ok() and not self._is_over:
                self._hand_back(error)

    def _hand_back(self, error: Exception) -> None:
        self._group.is_open = True
        self._give_up(error)

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
                    self._hand_on_all()

    def _hand_on_all(self) -> None:
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
