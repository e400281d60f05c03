"""Work that may take long, off the executor's thread, and its results back in it."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable
from queue import SimpleQueue
from typing import TypeVar

from rclpy.node import Node

T = TypeVar("T")

Done = Callable[[], object]


class Errands:
    """Runs one piece of work after another in a thread; what follows runs in the executor.

    The thread is there from the first errand on, and holds nobody up at the end: a disk that does
    not answer may keep it for ever.

    Parameters
    ----------
    node : rclpy.node.Node
        Whose executor takes the results.
    name : str
        The thread's.
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
        """Do some work, then go on in the executor's thread.

        Parameters
        ----------
        work : callable
            Runs in the thread.
        then : callable
            Is given what it returned.
        otherwise : callable
            Is given what it raised.
        """

        def errand() -> Done:
            try:
                result = work()
            except Exception as error:  # whoever asked judges it
                fault = error
                return lambda: otherwise(fault)
            return lambda: then(result)

        with self._lock:
            self._open += 1
            self._idle.clear()
        self._waiting.put(errand)
        if self._thread is None:
            self._thread = threading.Thread(target=self._work, name=self._name, daemon=True)
            self._thread.start()

    def deliver(self) -> None:
        """Hand over what is done; the executor calls it, and a heartbeat may."""
        while not self._done.empty():
            self._done.get()()

    def finish_within(self, patience: float) -> bool:
        """Wait so many seconds for the work that was asked for; returns whether it is done."""
        return self._idle.wait(patience)

    def _work(self) -> None:
        while True:
            self._done.put(self._waiting.get()())
            with self._lock:
                self._open -= 1
                if not self._open:
                    self._idle.set()
            executor = self._node.executor
            # One that is shut down at this moment has lost what wakes it; nobody waits any more.
            with contextlib.suppress(Exception):
                if executor is not None:
                    executor.create_task(self.deliver)
