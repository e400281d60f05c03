"""A worker process for computations that take long.

A fit in a thread of the node would delay the callbacks of messages. A worker process does not delay
them, can be ended at any time, and frees its memory when it ends.
"""

from __future__ import annotations

import contextlib
import os
import pickle
import selectors
import signal
import subprocess
import sys
import tempfile
from collections.abc import Callable
from threading import Lock
from typing import IO, Any, TypeVar

from magcal_ros.core.errors import MagcalError
from magcal_ros.processes import start, unbound_memory

T = TypeVar("T")

LOOK = 1.0  # seconds between two checks whether a signal has stopped the process
ENDING = 1.0  # seconds to wait for the end of a process that has closed its output
SIZE = 8  # bytes of the length that precedes each message


class WorkerLost(MagcalError):
    """The worker process has ended, or could not be started; the text says why."""


class WorkerStopped(WorkerLost):
    """The node itself has ended the worker process."""

    def __init__(self) -> None:
        super().__init__("the node has ended the fitting process")


class WorkerProcess:
    """Runs functions in a process that is started when it is needed.

    All methods except `stop` and `end` block: do not call them from the thread of the messages.
    """

    def __init__(self) -> None:
        self._lock = Lock()
        self._process: subprocess.Popen[bytes] | None = None
        self._is_over = False

    def start(self, calls: IO[bytes] | None = None) -> subprocess.Popen[bytes]:
        """Start the process if it does not run, and return it.

        Its standard input is the file `calls`, or a pipe. Raises Lost if the system cannot start
        the process, and Stopped after `end`.
        """
        with self._lock:
            if self._is_over:
                raise WorkerStopped
            if self._process is None or self._process.poll() is not None:
                try:
                    self._process = start(
                        __name__,
                        stdin=subprocess.PIPE if calls is None else calls,
                        stdout=subprocess.PIPE,
                        # Ctrl-C in the node's terminal must not end this process.
                        start_new_session=True,
                    )
                except OSError as error:
                    raise WorkerLost(
                        f"the fitting process cannot be started: {error.strerror or error}; check "
                        "the memory and other resources of the machine"
                    ) from error
            return self._process

    def run(self, function: Callable[..., T], *arguments: Any) -> T:
        """Call a function of a module in the process; its result or exception is passed on.

        Raises Lost if the process could not be started or has ended, Stopped after `stop`.
        """
        return self._answer(self.start(), _message((function, arguments)))

    def run_once(self, function: Callable[..., T], *arguments: Any) -> T:
        """Do the same as `run` in a new process, which finishes even if the node ends.

        No other call may be running.
        """
        # With a pipe, the call would be incomplete if the node ends before it is read.
        with tempfile.TemporaryFile() as call:
            call.write(_message((function, arguments)))
            call.seek(0)
            process = self.start(call)
        try:
            return self._answer(process, b"")
        finally:
            self.stop()

    def _answer(self, process: subprocess.Popen[bytes], call: bytes) -> Any:
        try:
            reply = _exchange(process, call)
        except (EOFError, OSError) as error:
            with self._lock:
                is_ours = self._process is not process
            raise (WorkerStopped() if is_ours else WorkerLost(_how_it_ended(process))) from error
        is_result, answer = pickle.loads(reply)
        if not is_result:
            raise answer
        return answer

    def stop(self) -> None:
        """End the process immediately."""
        with self._lock:
            process, self._process = self._process, None
        if process is not None:
            process.kill()

    def end(self) -> None:
        """End the process; it cannot be started again."""
        self._is_over = True
        self.stop()


def _message(content: object) -> bytes:
    """Return the bytes of a call or an answer: their length, and the pickled content."""
    words = pickle.dumps(content)
    return len(words).to_bytes(SIZE, "big") + words


def _exchange(process: subprocess.Popen[bytes], call: bytes) -> bytes:
    """Send a call unless it is empty, and return the answer."""
    assert process.stdout is not None
    back, to = process.stdout.fileno(), -1
    unsent, received = memoryview(call), bytearray()
    # Other selectors need a file descriptor, and there may be no free one.
    with selectors.PollSelector() as line:
        if process.stdin is not None:
            to = process.stdin.fileno()
            os.set_blocking(to, False)
            line.register(to, selectors.EVENT_WRITE)
        line.register(back, selectors.EVENT_READ)
        while len(received) < SIZE or len(received) < SIZE + int.from_bytes(received[:SIZE], "big"):
            ready = line.select(LOOK)
            for key, _ in ready:
                if key.fd == to:
                    unsent = unsent[os.write(to, unsent) :]
                    if not unsent:
                        line.unregister(to)
                elif words := os.read(back, 65536):
                    received += words
                else:
                    raise EOFError
            if not ready and _is_stopped(process):
                raise EOFError
    return bytes(received[SIZE:])


def _is_stopped(process: subprocess.Popen[bytes]) -> bool:
    """Whether a signal has stopped the process, which then never answers."""
    try:
        found = os.waitid(os.P_PID, process.pid, os.WSTOPPED | os.WNOHANG | os.WNOWAIT)
    except ChildProcessError:
        return False
    return found is not None


def _how_it_ended(process: subprocess.Popen[bytes]) -> str:
    """Return why there was no answer, and make sure that the process ends."""
    if _is_stopped(process):
        process.kill()
        return "the fitting process was stopped (SIGSTOP), and the node has ended it"
    try:
        status = process.wait(ENDING)
    except subprocess.TimeoutExpired:
        process.kill()
        return "the fitting process has closed its connection, and the node has ended it"
    if status == -signal.SIGKILL:
        return "the fitting process was killed (SIGKILL), as the system does when memory runs out"
    name = signal.Signals(-status).name if status < 0 else f"status {status}"
    return f"the fitting process has ended ({name})"


def main() -> int:
    """Answer calls on standard input until it is closed; returns 0."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    unbound_memory()
    back = os.dup(sys.stdout.fileno())
    # Text that a library prints must not get into the answers.
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())
    with contextlib.suppress(EOFError, OSError), open(back, "wb") as line:
        while size := sys.stdin.buffer.read(SIZE):
            function, arguments = pickle.loads(sys.stdin.buffer.read(int.from_bytes(size, "big")))
            try:
                answer = (True, function(*arguments))
            except Exception as error:  # any error is passed on to the caller
                answer = (False, error)
            line.write(_message(answer))
            line.flush()
    return 0
