"""A second process that stops the robot when the node no longer can.

Nothing that the node does helps against SIGKILL, SIGSTOP, a fault in the interpreter, or a disk or
terminal that blocks it. So the node reports twenty times a second to a small process; when the
reports stop, or the line breaks, this process publishes zeros. It exists only while the robot turns
itself. Each time it has to answer what it would publish and where: a guard that is stopped, or that
does something else, is no guard.
"""

from __future__ import annotations

import contextlib
import math
import os
import select
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable

from magcal_ros.processes import start

SILENCE = 0.3  # seconds without a word after which the node counts as gone, or the guard

ZEROS_FOR, ZEROS_EVERY = 1.0, 0.05
"""Seconds for which zeros are sent, and between two of them: a single message may be lost."""

ENDING = 2.0  # seconds that a guard is given to go by itself

TRANSPORTS = "FASTDDS_BUILTIN_TRANSPORTS"

ASKED, ALIVE, DISMISSED = b"?", b".", b"q"
"""What a line of the node begins with; a question follows the first two, and the second says that
the robot may move."""

STOPPED = b"stopped the base"

HANDLED = ("SIGINT", "SIGTERM", "SIGHUP", "SIGQUIT", "SIGUSR1", "SIGUSR2", "SIGALRM")
"""Signals that are meant for the node: where both get one, the guard must not end first."""


class Guard:
    """The node's end of the pipe to a guard; `topic` is the full name of the base's topic."""

    def __init__(self, topic: str, stamped: bool, frame: str) -> None:
        self._process = start(
            __name__,
            *(topic, frame, "stamped" if stamped else "", str(SILENCE)),
            # A process that is stopped while it writes to the shared memory of Fast DDS keeps the
            # lock of the base's port there, and all who write to it wait for seconds. Who chose
            # transports keeps them.
            extra={TRANSPORTS: os.environ.get(TRANSPORTS, "UDPv4")},
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            # Ctrl-C in the node's terminal is not meant for the guard.
            start_new_session=True,
        )
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._line, self._answers = self._process.stdin.fileno(), self._process.stdout.fileno()
        os.set_blocking(self._line, False)
        os.set_blocking(self._answers, False)
        self._duty = duty("TwistStamped" if stamped else "Twist", topic, SILENCE)
        self._asked: dict[bytes, float] = {}
        self._proved_at = -math.inf
        self._has_stopped = False
        self._heard = b""
        # The signals' thread dismisses it while the executor's listens.
        self._lock = threading.Lock()

    @property
    def is_ready(self) -> bool:
        """Whether it could stop the base now: it has just answered what it publishes and where."""
        self._ask(ASKED)
        return not self.has_ended and time.monotonic() - self._proved_at < SILENCE

    @property
    def has_ended(self) -> bool:
        """Whether it has stopped the base, or its process has ended."""
        self._listen()
        return self._has_stopped or self._process.poll() is not None

    def tell_alive(self) -> None:
        """Report that the node is alive; after the first report, silence stops the base."""
        self._ask(ALIVE)

    def dismiss(self) -> None:
        """End the guard without stopping the base."""
        self._say(DISMISSED)
        with self._lock:
            self._line = self._answers = -1
            for stream in (self._process.stdin, self._process.stdout):
                assert stream is not None
                stream.close()
        try:
            threading.Thread(target=self._wait_for_end, name="magcal-guard", daemon=True).start()
        except RuntimeError:  # no room for another thread
            self._process.kill()

    def _wait_for_end(self) -> None:
        try:
            self._process.wait(ENDING)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()

    def _ask(self, kind: bytes) -> None:
        now, question = time.monotonic(), os.urandom(8).hex().encode()
        # An answer that comes later proves nothing any more.
        self._asked = {each: at for each, at in self._asked.items() if now - at < SILENCE}
        self._asked[question] = now
        self._say(kind + question)

    def _listen(self) -> None:
        """Read its answers."""
        with self._lock, contextlib.suppress(BlockingIOError):
            if self._answers >= 0:
                self._heard += os.read(self._answers, 65536)
        *lines, self._heard = self._heard.split(b"\n")
        for line in lines:
            question, _, answer = line.partition(b" ")
            if answer == self._duty and question in self._asked:
                self._proved_at = max(self._proved_at, self._asked.pop(question))
            self._has_stopped |= line == STOPPED

    def _say(self, words: bytes) -> None:
        # A full pipe has heard enough; a broken one shows in `has_ended`.
        with self._lock, contextlib.suppress(BlockingIOError, BrokenPipeError):
            if self._line >= 0:
                os.write(self._line, words + b"\n")


def duty(kind: str, topic: str, silence: float) -> bytes:
    """Return what a guard does, in the words of its answer."""
    return f"zeros as {kind} on {topic} after {silence:g} s".encode()


def main() -> int:
    """Watch standard input; returns 0 if dismissed and 1 if the base was stopped."""
    for name in HANDLED:
        signal.signal(getattr(signal, name), signal.SIG_IGN)
    topic, frame, stamped, silence = sys.argv[1], sys.argv[2], bool(sys.argv[3]), float(sys.argv[4])
    brake = Brake(topic, stamped, frame)
    # Whatever blocks the node's log must not block the guard.
    with open(os.devnull, "wb") as nowhere:
        os.dup2(nowhere.fileno(), sys.stderr.fileno())

    def answer(question: bytes) -> None:
        if brake.has_met_base:
            _say(question + b" " + brake.duty(silence))

    if not is_needed(sys.stdin.fileno(), silence, answer):
        return 0
    brake.stop_base(lambda: _say(STOPPED))
    return 1


def _say(words: bytes) -> None:
    # The node may be gone already.
    with contextlib.suppress(BrokenPipeError):
        os.write(sys.stdout.fileno(), words + b"\n")


def is_needed(line: int, silence: float, answer: Callable[[bytes], object]) -> bool:
    """Read the node's line; returns whether it went (silent for so many s) in a turn."""
    deadline, heard = math.inf, b""
    while True:
        patience = max(0.0, deadline - time.monotonic()) if deadline < math.inf else None
        ready, _, _ = select.select([line], [], [], patience)
        words = os.read(line, 4096) if ready else b""
        *lines, heard = (heard + words).split(b"\n")
        for each in lines:
            if each == DISMISSED:
                return False
            if each.startswith(ALIVE):
                deadline = time.monotonic() + silence
            answer(each[1:])
        if not words or time.monotonic() > deadline:
            return deadline < math.inf


class Brake:
    """Publishes zeros."""

    def __init__(self, topic: str, stamped: bool, frame: str) -> None:
        import rclpy
        from geometry_msgs.msg import Twist, TwistStamped
        from rclpy.parameter import Parameter
        from rclpy.qos import QoSProfile
        from rclpy.signals import SignalHandlerOptions

        rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
        # A name that begins with an underscore is left out of lists of nodes.
        node = rclpy.create_node(
            f"_magcal_guard_{os.getpid()}",
            enable_rosout=False,
            start_parameter_services=False,
            parameter_overrides=[Parameter("start_type_description_service", value=False)],
        )
        # A stamp of zero counts as now for bases that look at it; this clock need not be theirs.
        self._zero = TwistStamped() if stamped else Twist()
        if stamped:
            self._zero.header.frame_id = frame
        self._out = node.create_publisher(type(self._zero), topic, QoSProfile(depth=1))
        self._has_met_base = False

    @property
    def has_met_base(self) -> bool:
        """Whether something has been there to listen."""
        self._has_met_base = self._has_met_base or self._out.get_subscription_count() > 0
        return self._has_met_base

    def duty(self, silence: float) -> bytes:
        """Return what this process would publish, as its publisher describes itself."""
        return duty(type(self._zero).__name__, self._out.topic_name, silence)

    def stop_base(self, tell: Callable[[], None]) -> None:
        """Publish zeros for a second; `tell` is called after the first of them."""
        deadline = time.monotonic() + ZEROS_FOR
        self._out.publish(self._zero)
        tell()
        while time.monotonic() < deadline:
            time.sleep(ZEROS_EVERY)
            self._out.publish(self._zero)
