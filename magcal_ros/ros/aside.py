"""A process beside the node, for what computes long.

A fit in a thread of the node's own takes turns with the messages that arrive meanwhile, and they
come late. A process of its own does not hold them up, can be ended at any moment, and takes the
memory that it used with it.
"""

from __future__ import annotations

import contextlib
import signal
from collections.abc import Callable, Iterator
from threading import Lock
from typing import TYPE_CHECKING, Any, TypeVar

from magcal_ros.ros import memory_limit

if TYPE_CHECKING:
    from multiprocessing.connection import Connection
    from multiprocessing.process import BaseProcess

T = TypeVar("T")


class Aside:
    """Runs functions in a process that is there only while it is needed.

    All but `stop` wait, so they belong into a thread other than that of the messages.
    """

    def __init__(self) -> None:
        self._lock = Lock()
        self._process: BaseProcess | None = None
        self._line: Connection | None = None
        self._is_over = False

    def start(self) -> Connection:
        """Start the process, if it is not there; returns the line to it.

        Raises
        ------
        EOFError
            If it was ended for good: a process that is begun while this one ends finds nobody.
        """
        import multiprocessing

        spawned = multiprocessing.get_context("spawn")
        with self._lock:
            if self._is_over:
                raise EOFError
            if self._line is None or self._process is None or not self._process.is_alive():
                self._line, end = spawned.Pipe()
                self._process = spawned.Process(
                    target=_serve, args=(end,), name="magcal-fit", daemon=True
                )
                with _interrupts_held_back():
                    self._process.start()
                end.close()
            return self._line

    def run(self, function: Callable[..., T], *arguments: Any) -> T:
        """Return what a function of a module returns, or raise what it raises.

        Raises
        ------
        EOFError, OSError
            If the process ended meanwhile.
        """
        line = self.start()
        line.send((function, arguments))
        is_result, answer = line.recv()
        if not is_result:
            raise answer
        result: T = answer
        return result

    def stop(self) -> None:
        """End the process at once, whatever it does."""
        with self._lock:
            if self._process is not None:
                self._process.kill()
                self._process = None
                self._line = None

    def end(self) -> None:
        """End the process for good."""
        self._is_over = True
        self.stop()


def _serve(line: Connection) -> None:
    """Answer calls until nobody is there any more."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    memory_limit.unbound()
    with contextlib.suppress(EOFError, OSError):
        while True:
            function, arguments = line.recv()
            try:
                answer = (True, function(*arguments))
            except Exception as error:  # whatever it is, the caller is told
                answer = (False, error)
            line.send(answer)


@contextlib.contextmanager
def _interrupts_held_back() -> Iterator[None]:
    """Keep Ctrl-C in the node's terminal from a child that has not begun to ignore it."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
