"""A process beside the node, for what computes long.

A fit in a thread of the node's own takes turns with the messages that arrive meanwhile, and they
come late. A process of its own does not hold them up, can be ended at any moment, and takes the
memory that it used with it.
"""

from __future__ import annotations

import contextlib
import os
import pickle
import selectors
import signal
import sys
from collections.abc import Callable
from threading import Lock
from typing import TYPE_CHECKING, Any, TypeVar

from magcal_ros.core.errors import MagcalError
from magcal_ros.processes import start
from magcal_ros.ros import memory_limit

if TYPE_CHECKING:
    import subprocess

T = TypeVar("T")

LOOK = 1.0
"""Seconds between two looks whether a process that computes is still allowed to."""

ENDING = 1.0
"""Seconds after its last word in which a process that ends is gone."""

SIZE = 8
"""Bytes before each message on the line, which say how long it is."""


class Lost(MagcalError):
    """The process beside the node is gone, or could not be started; the text says why."""


class Stopped(Lost):
    """The node itself has ended it."""

    def __init__(self) -> None:
        super().__init__("the node has ended the process that fits")


class Aside:
    """Runs functions in a process that is there only while it is needed.

    All but `stop` and `end` wait, so they belong into a thread other than that of the messages.
    """

    def __init__(self) -> None:
        self._lock = Lock()
        self._process: subprocess.Popen[bytes] | None = None
        self._is_over = False

    def start(self) -> subprocess.Popen[bytes]:
        """Start the process, if it is not there; returns it.

        Raises
        ------
        Lost
            If there is no room for it, or if it was ended for good: a process that is begun while
            this one ends finds nobody.
        """
        import subprocess

        with self._lock:
            if self._is_over:
                raise Stopped
            if self._process is None or self._process.poll() is not None:
                try:
                    self._process = start(
                        __name__,
                        stdin=subprocess.PIPE,
                        stdout=subprocess.PIPE,
                        # Ctrl-C in the node's terminal is not meant for it.
                        start_new_session=True,
                    )
                except OSError as error:
                    raise Lost(
                        f"the process that fits cannot be started: {error.strerror or error}; "
                        "see which of the machine's resources are used up"
                    ) from error
            return self._process

    def run(self, function: Callable[..., T], *arguments: Any) -> T:
        """Return what a function of a module returns, or raise what it raises.

        Raises
        ------
        Lost
            If the process could not be started, or ended or was stopped meanwhile.
        """
        process = self.start()
        call = pickle.dumps((function, arguments))
        try:
            reply = _exchange(process, call)
        except (EOFError, OSError) as error:
            with self._lock:
                is_ours = self._process is not process
            raise (Stopped() if is_ours else Lost(_how_it_ended(process))) from error
        is_result, answer = pickle.loads(reply)
        if not is_result:
            raise answer
        result: T = answer
        return result

    def stop(self) -> None:
        """End the process at once, whatever it does."""
        with self._lock:
            process, self._process = self._process, None
        if process is not None:
            process.kill()

    def end(self) -> None:
        """End the process for good."""
        self._is_over = True
        self.stop()


def _exchange(process: subprocess.Popen[bytes], call: bytes) -> bytes:
    """Send a call and return the answer.

    Raises
    ------
    EOFError, OSError
        If the process goes meanwhile, or somebody stops it.
    """
    assert process.stdin is not None
    assert process.stdout is not None
    to, back = process.stdin.fileno(), process.stdout.fileno()
    os.set_blocking(to, False)
    unsent, heard = memoryview(len(call).to_bytes(SIZE, "big") + call), bytearray()
    with selectors.DefaultSelector() as line:
        line.register(to, selectors.EVENT_WRITE)
        line.register(back, selectors.EVENT_READ)
        while len(heard) < SIZE or len(heard) < SIZE + int.from_bytes(heard[:SIZE], "big"):
            ready = line.select(LOOK)
            for key, _ in ready:
                if key.fd == to:
                    unsent = unsent[os.write(to, unsent) :]
                    if not unsent:
                        line.unregister(to)
                elif words := os.read(back, 65536):
                    heard += words
                else:
                    raise EOFError
            if not ready and _is_stopped(process):
                raise EOFError
    return bytes(heard[SIZE:])


def _is_stopped(process: subprocess.Popen[bytes]) -> bool:
    """Whether somebody keeps the process from running, and so the node waiting."""
    try:
        found = os.waitid(os.P_PID, process.pid, os.WSTOPPED | os.WNOHANG | os.WNOWAIT)
    except ChildProcessError:
        return False
    return found is not None


def _how_it_ended(process: subprocess.Popen[bytes]) -> str:
    """Say why there was no answer; from then on the process is surely gone."""
    import subprocess

    if _is_stopped(process):
        process.kill()
        return "the process that fits was stopped (SIGSTOP), and the node has ended it"
    try:
        status = process.wait(ENDING)
    except subprocess.TimeoutExpired:
        process.kill()
        return "the process that fits has closed its line, and the node has ended it"
    if status == -signal.SIGKILL:
        return "the process that fits was killed (SIGKILL), as the system does without memory"
    name = signal.Signals(-status).name if status < 0 else f"status {status}"
    return f"the process that fits has ended ({name})"


def main() -> int:
    """Answer calls on standard input until nobody is there any more; returns 0."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    memory_limit.unbound()
    back = os.dup(sys.stdout.fileno())
    # What a library prints is no answer.
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())
    with contextlib.suppress(EOFError, OSError), open(back, "wb") as line:
        while size := sys.stdin.buffer.read(SIZE):
            function, arguments = pickle.loads(sys.stdin.buffer.read(int.from_bytes(size, "big")))
            try:
                answer = (True, function(*arguments))
            except Exception as error:  # whatever it is, the caller is told
                answer = (False, error)
            reply = pickle.dumps(answer)
            line.write(len(reply).to_bytes(SIZE, "big") + reply)
            line.flush()
    return 0
