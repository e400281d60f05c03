"""Runs the callbacks: rclpy's executor, and beside it the loop of the sensors; counts errors."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from threading import Lock
from types import TracebackType
from typing import Any

from rclpy.executors import (
    ConditionReachedException,
    ShutdownException,
    SingleThreadedExecutor,
    TimeoutException,
)
from rclpy.node import Node
from rclpy.subscription import Subscription
from rclpy.task import Future

from magcal_ros.ros.sensor_loop import SensorGroup, SensorLoop


class FairLock:
    """A lock that two threads have by turns whenever both want it.

    With a plain one, who releases it and wants it again at once usually gets it again, and under a
    flood of messages a service would never be answered.
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

    rclpy's executor finds what is ready and the handlers it returns are called here, under a lock
    that is shared with the loop of the subscriptions. An error in a callback is noted and does not
    end anything.
    """

    def __init__(
        self,
        node: Node,
        subscriptions: Sequence[Subscription],
        group: SensorGroup,
        note: Callable[[Exception], None],
        unhurried: Sequence[Subscription] = (),
    ) -> None:
        self._node = node
        self._note_error = note
        self._is_over = self._is_started = False
        self._lock, self._waking = FairLock(), Lock()
        self._waiting: set[Future] = set()
        self._executor = SingleThreadedExecutor(context=node.context)
        self._executor.add_node(node)
        self._loop = SensorLoop(
            node, subscriptions, group, self._lock, self._note, self._say_and_go_on, unhurried
        )

    def spin(self) -> None:
        """Serve the node until `end` is called or the context ends.

        Raises
        ------
        rclpy.executors.ExternalShutdownException
            If the context has ended.
        """
        while self._node.context.ok() and not self._is_over:
            self.spin_once()

    def spin_once(self, timeout_sec: float | None = None) -> None:
        """Wait until something is ready, at most so many seconds, and serve it.

        From the first call on the chosen subscriptions are served too, until the shutdown.

        Raises
        ------
        rclpy.executors.ExternalShutdownException
            If the context has ended.
        """
        if not self._is_started:
            self._is_started = True
            self._loop.start()
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
                # Who resumes a coroutine, and by which handler, is rclpy's own affair.
                self._waiting.add(handler)
                handler.add_done_callback(self._look_at)

    def end(self) -> None:
        """Let `spin` and `spin_once` return, for good; from any thread."""
        self._is_over = True
        self._loop.end()
        self._wake()

    def shutdown(self, timeout_sec: float | None = None) -> bool:
        """Stop; returns whether the callbacks of the subscriptions have ended in time."""
        self.end()
        has_ended = self._loop.join(timeout_sec)
        with self._waking:
            return self._executor.shutdown(timeout_sec) and has_ended

    def _wake(self) -> None:
        # Not while the shutdown destroys what it is woken by.
        with self._waking:
            self._executor.wake()

    def _has_ended(self) -> bool:
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

    def _say_and_go_on(self, error: Exception) -> None:
        self._node.get_logger().warning(
            f"this rclpy is unlike those known ({type(error).__name__}: {error}): rclpy's own "
            "executor serves the sensors from now on, at more CPU"
        )
        self._wake()


def _release(entity: Any) -> None:
    """Free the callback group of what failed before its callback: rclpy leaves it taken."""
    group = None if entity is None else entity.callback_group
    if group is not None and not group.can_execute(entity):
        group.ending_execution(entity)


LONGEST = 300
"""Characters of an error's own words that go into the log; some quote a whole message."""


class CallbackErrors:
    """Counts the errors of all callbacks and logs each kind of them once.

    A kind is a type of error at a line of code.
    """

    def __init__(self, log: Callable[[str], object]) -> None:
        self._log = log
        self._known: set[tuple[type[BaseException], str]] = set()
        self.total = 0

    def note(self, error: BaseException) -> str:
        """Count an error that a callback raised, and log it if its kind is new; says what it is."""
        self.total += 1
        kind = type(error), _place(error.__traceback__)
        words = " ".join(str(error).split())[:LONGEST]
        said = f"an error in a callback, {kind[0].__name__} in {kind[1]}"
        if _is_of_clock(error.__traceback__):
            said = "the simulated time on /clock jumped to a time that ROS does not have"
        if kind not in self._known:
            self._known.add(kind)
            self._log(
                f"{said}: {words}. The node goes on; from now on this kind is only counted, "
                "in Inputs of /diagnostics"
            )
        return said


def _is_of_clock(trace: TracebackType | None) -> bool:
    """Whether it comes of what rclpy does with a message on /clock."""
    while trace is not None and trace.tb_frame.f_globals.get("__name__") != "rclpy.time_source":
        trace = trace.tb_next
    return trace is not None


def _place(trace: TracebackType | None) -> str:
    """Return file and line of the innermost call."""
    if trace is None:
        return "an unknown place"
    while trace.tb_next is not None:
        trace = trace.tb_next
    return f"{os.path.basename(trace.tb_frame.f_code.co_filename)}, line {trace.tb_lineno}"
