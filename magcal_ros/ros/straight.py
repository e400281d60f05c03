"""An executor that hands the sensors' messages on straight away.

For each message rclpy gathers everything the node owns, builds a wait set of it and makes a task
of the callback, twice over: most of what a rclpy node costs. Here the wait set is kept, and filled
again by as many calls as it has entries; messages of the chosen subscriptions are taken from it
without a task. Whatever else is ready is served by rclpy's own executor.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from contextlib import ExitStack, suppress
from threading import RLock
from typing import Any

from rclpy.exceptions import InvalidHandle
from rclpy.executors import Executor, ExternalShutdownException, SingleThreadedExecutor
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.subscription import Subscription
from rclpy.utilities import timeout_sec_to_nsec

MOST_AT_ONCE = 16
"""Messages of one subscription that are taken before anything else has its turn."""

IMPLEMENTATION: Any = rclpy_implementation
"""rclpy's inside: its types promise less than there is."""


def executor_for(node: Node, straight: Sequence[Subscription[Any]]) -> Executor:
    """Return the executor that serves a node cheapest, with the node in it.

    Parameters
    ----------
    node : rclpy.node.Node
        The node to serve.
    straight : sequence of Subscription
        Those of its subscriptions that bring nearly all messages; their callbacks are plain
        functions.

    Returns
    -------
    Executor
        A `StraightExecutor`, or rclpy's own where rclpy is another inside than it is known here.
    """
    try:
        executor: Executor = StraightExecutor(straight, context=node.context)
    except (AttributeError, TypeError):
        executor = SingleThreadedExecutor(context=node.context)
    executor.add_node(node)
    return executor


class StraightExecutor(SingleThreadedExecutor):
    """Serves chosen subscriptions without detours, and everything else as rclpy does.

    Events of the middleware (a QoS that does not match) are looked at with the next timer or
    service, not at once.

    Parameters
    ----------
    straight : sequence of Subscription
        Subscriptions whose callbacks are plain functions.
    **kwargs
        Passed on to `rclpy.executors.SingleThreadedExecutor`.

    Raises
    ------
    AttributeError, TypeError
        If rclpy is another inside than it is known here.
    """

    def __init__(self, straight: Sequence[Subscription[Any]], **kwargs: Any) -> None:
        self._straight: tuple[Any, ...] = tuple(straight)
        self._is_stale = True
        self._in_use = ExitStack()
        self._spinning = RLock()
        self._entries: list[tuple[Callable[..., Any], Any]] = []
        self._others = range(0)
        self._wait_set: Any = None
        super().__init__(**kwargs)
        self._gather()

    def wake(self) -> None:
        """Wake up, and look again at what the nodes own."""
        self._is_stale = True
        super().wake()

    def add_node(self, node: Node) -> bool:
        """Serve a node from now on; returns whether it is new here."""
        added = super().add_node(node)
        self.wake()
        return added

    def remove_node(self, node: Node) -> None:
        """Serve a node no longer."""
        super().remove_node(node)
        self.wake()

    def shutdown(self, timeout_sec: float | None = None) -> bool:
        """Stop; returns whether what was being served has ended in time."""
        stopped = super().shutdown(timeout_sec)
        if not self._spinning.acquire(timeout=-1 if timeout_sec is None else timeout_sec):
            return False
        self._in_use.close()
        self._spinning.release()
        return stopped

    def spin_once(self, timeout_sec: float | None = None) -> None:
        """Wait until something is ready, at most so many seconds, and serve it.

        Raises
        ------
        ExternalShutdownException
            If the context has ended.
        """
        with self._spinning:
            if not self._wait(timeout_sec):
                return
            if not self._context.ok():
                raise ExternalShutdownException
            if not self._serve_straight() or self._is_more_ready():
                # rclpy looks at one thing a call, and a coroutine that waits is one of them.
                for _ in range(1 + len(self._tasks)):
                    super().spin_once(0.0)
                self._is_stale = True

    def _wait(self, timeout_sec: float | None) -> bool:
        """Wait until something is ready or the time is up; False once the executor is shut down."""
        if self._is_stale:
            self._gather()
        if self._is_shutdown:
            return False
        wait_set = self._wait_set
        wait_set.clear_entities()
        for add, handle in self._entries:
            add(handle)
        wait_set.wait(timeout_sec_to_nsec(timeout_sec))
        return not self._is_shutdown

    def _serve_straight(self) -> bool:
        served = False
        for subscription in self._straight:
            take, kind, raw = (
                subscription.handle.take_message,
                subscription.msg_type,
                subscription.raw,
            )
            for _ in range(MOST_AT_ONCE):
                taken = take(kind, raw)
                if taken is None:
                    break
                served = True
                subscription.callback(taken[0])
        return served

    def _is_more_ready(self) -> bool:
        if self._is_shutdown:
            return False
        ready, is_ready = self._wait_set.get_ready_entities, self._wait_set.is_ready
        if any(ready(kind) for kind in ("guard_condition", "timer", "service", "client")):
            return True
        return any(is_ready("subscription", index) for index in self._others)

    def _gather(self) -> None:
        """Make the wait set anew of what may run now; nothing in it is destroyed meanwhile."""
        self._is_stale = False
        self._in_use.close()
        nodes = self.get_nodes()
        others = [each for node in nodes for each in node.subscriptions]
        others = [each for each in others if each not in self._straight]
        alarms = [self._guard, self._sigint_gc]
        straight = self._handles(self._straight)
        kinds = (
            straight + self._handles(filter(self.can_execute, others)),
            self._handles(filter(None, alarms)) + self._of(nodes, "guards"),
            self._of(nodes, "timers"),
            self._of(nodes, "clients"),
            self._of(nodes, "services"),
        )
        wait_set = IMPLEMENTATION.WaitSet(*map(len, kinds), 0, self.context.handle)
        adders = (
            wait_set.add_subscription,
            wait_set.add_guard_condition,
            wait_set.add_timer,
            wait_set.add_client,
            wait_set.add_service,
        )
        self._wait_set = wait_set
        self._others = range(len(straight), len(kinds[0]))
        self._entries = [
            (add, handle) for add, handles in zip(adders, kinds, strict=True) for handle in handles
        ]

    def _of(self, nodes: Iterable[Node], kind: str) -> list[Any]:
        entities = [each for node in nodes for each in getattr(node, kind)]
        return self._handles(filter(self.can_execute, entities))

    def _handles(self, entities: Iterable[Any]) -> list[Any]:
        """Return the handles of what is alive, held so that they stay it."""
        handles = []
        for entity in entities:
            with suppress(InvalidHandle):
                self._in_use.enter_context(entity.handle)
                handles.append(entity.handle)
        return handles
