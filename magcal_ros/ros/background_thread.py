"""A thread for work that may take long; its results return to the executor's thread."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable
from queue import SimpleQueue
from typing import TypeVar

from rclpy.node import Node

T = TypeVar("T")

Done = Callable[[], object]


class BackgroundThread:
    """Runs one job after another in a thread; what follows runs in the executor.

    The thread is started with the first job. It does not delay the end of the process: a disk that
    does not answer may block it for ever. If no thread can be started, the work fails as if it had
    raised that error itself.
    """

    def __init__(self, node: Node, name: str) -> None:
        self._node, self._name = node, name
        self._waiting: SimpleQueue[Callable[[], Done]] = SimpleQueue()
        self._done: SimpleQueue[Done] = SimpleQueue()
        self._idle = threading.Event()
        self._idle.set()
        self._open = 0
        self._lock = threading.Lock()
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
                fault = error
                return lambda: otherwise(fault)
            return lambda: then(result)

        # Where memory is short the thread itself may end in an error.
        if self._thread is None or not self._thread.is_alive():
            thread = threading.Thread(target=self._work, name=self._name, daemon=True)
            try:
                thread.start()
            except RuntimeError as error:
                fault = error
                self._hand_over(lambda: otherwise(fault))
                return
            self._thread = thread
        with self._lock:
            self._open += 1
            self._idle.clear()
        self._waiting.put(job)

    def deliver(self) -> None:
        """Hand over what is done; the executor calls it, and a heartbeat may."""
        while not self._done.empty():
            self._done.get()()

    def finish_within(self, patience: float) -> bool:
        """Wait so many seconds for the work that was asked for; returns whether it is done."""
        return self._idle.wait(patience)

    def _work(self) -> None:
        while True:
            self._hand_over(self._waiting.get()())
            with self._lock:
                self._open -= 1
                if not self._open:
                    self._idle.set()

    def _hand_over(self, done: Done) -> None:
        self._done.put(done)
        executor = self._node.executor
        # One that is shut down at this moment has lost what wakes it; nobody waits any more.
        with contextlib.suppress(Exception):
            if executor is not None:
                executor.create_task(self.deliver)
