"""A second process that stops the robot when the node no longer can.

Nothing that the node does helps against SIGKILL, SIGSTOP, a fault in the interpreter, or a disk
or terminal that blocks it. So the node tells a small process twenty times a second that it is
alive; when that falls silent, or the line to it breaks, this process publishes zeros. It is there
only while the robot turns itself.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import select
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Sequence

SILENCE = 0.3
"""Seconds without a word after which the node counts as gone."""

ZEROS_FOR, ZEROS_EVERY = 1.0, 0.05
"""Seconds for which zeros are sent, and between two of them: a single message may be lost."""

LISTENERS_WITHIN = 3.0
"""Seconds within which the guard's publisher must have met the base."""

ALIVE, DISMISSED, READY, STOPPED = b".", b"q", b"r", b"s"
"""Words on the line: the node's two, and the guard's two."""

HANDLED = ("SIGINT", "SIGTERM", "SIGHUP", "SIGQUIT", "SIGUSR1", "SIGUSR2", "SIGALRM")
"""Signals that are meant for the node: whoever ends both must not end the guard first."""


class Guard:
    """The node's end of the line to a guard.

    Parameters
    ----------
    topic : str
        Where the base listens, fully resolved.
    stamped : bool
        Whether it takes TwistStamped.
    frame : str
        The frame_id then.
    """

    def __init__(self, topic: str, stamped: bool, frame: str) -> None:
        command = [sys.executable, "-m", __name__, "--topic", topic, "--frame", frame]
        command += ["--silence", str(SILENCE)]
        self._process = subprocess.Popen(
            [*command, "--stamped"] if stamped else command,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            # Ctrl-C in the node's terminal is not meant for the guard.
            start_new_session=True,
            env={**os.environ, **_without_shared_memory()},
        )
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._line, self._answers = self._process.stdin.fileno(), self._process.stdout.fileno()
        os.set_blocking(self._line, False)
        os.set_blocking(self._answers, False)
        self._heard = b""
        # The signals' thread dismisses it while the executor's listens.
        self._lock = threading.Lock()

    @property
    def is_ready(self) -> bool:
        """Whether it could stop the base now."""
        return READY in self._listen() and not self.has_ended

    @property
    def has_ended(self) -> bool:
        """Whether it is of no use any more: it stopped the base, or something ended it."""
        return STOPPED in self._listen() or self._process.poll() is not None

    def tell_alive(self) -> None:
        """Say that the node is alive; from the first time on silence stops the base."""
        self._say(ALIVE)

    def dismiss(self) -> None:
        """Let it go without stopping anything."""
        self._say(DISMISSED)
        with self._lock:
            self._line = self._answers = -1
            for stream in (self._process.stdin, self._process.stdout):
                assert stream is not None
                stream.close()
        threading.Thread(target=self._process.wait, name="magcal-guard", daemon=True).start()

    def _listen(self) -> bytes:
        """Return all that it has said."""
        with self._lock, contextlib.suppress(BlockingIOError):
            if self._answers >= 0:
                self._heard += os.read(self._answers, 16)
        return self._heard

    def _say(self, word: bytes) -> None:
        # A full pipe has heard enough; a broken one shows in `has_ended`.
        with self._lock, contextlib.suppress(BlockingIOError, BrokenPipeError):
            if self._line >= 0:
                os.write(self._line, word)


def _without_shared_memory() -> dict[str, str]:
    """Return the environment in which the guard's messages share no memory with the node's.

    A process that is stopped while it writes to the memory of Fast DDS keeps the lock of the
    base's port there, and all who write to it wait for seconds. Who chose transports keeps them.
    """
    name = "FASTDDS_BUILTIN_TRANSPORTS"
    return {name: os.environ.get(name, "UDPv4")}


def main(arguments: Sequence[str] | None = None) -> int:
    """Watch standard input; returns 0 if dismissed and 1 if the base was stopped."""
    for name in HANDLED:
        signal.signal(getattr(signal, name), signal.SIG_IGN)
    parser = argparse.ArgumentParser(description="Stops a base when its node is gone.")
    parser.add_argument("--topic", required=True)
    parser.add_argument("--frame", default="")
    parser.add_argument("--stamped", action="store_true")
    parser.add_argument("--silence", type=float, default=SILENCE)
    options = parser.parse_args(arguments)
    brake = Brake(options.topic, options.stamped, options.frame)
    brake.wait_for_base()
    # Whatever blocks the node's log must not block the guard.
    with open(os.devnull, "wb") as nowhere:
        os.dup2(nowhere.fileno(), sys.stderr.fileno())
    _answer(READY)
    if not is_needed(sys.stdin.fileno(), options.silence):
        return 0
    brake.stop_base(lambda: _answer(STOPPED))
    return 1


def _answer(word: bytes) -> None:
    # The node may be gone already.
    with contextlib.suppress(BrokenPipeError):
        os.write(sys.stdout.fileno(), word)


def is_needed(line: int, silence: float = SILENCE) -> bool:
    """Wait for the node's last word; returns whether it went while the robot may be moving.

    Parameters
    ----------
    line : int
        File descriptor that the node writes to.
    silence : float
        Seconds without a word after which the node counts as gone.
    """
    may_move = False
    while True:
        heard, _, _ = select.select([line], [], [], silence if may_move else None)
        words = os.read(line, 4096) if heard else b""
        if DISMISSED in words:
            return False
        if not words:
            return may_move
        may_move = True


class Brake:
    """Publishes zeros.

    Parameters
    ----------
    topic, stamped, frame
        As of `Guard`.
    """

    def __init__(self, topic: str, stamped: bool, frame: str) -> None:
        import rclpy
        from geometry_msgs.msg import Twist, TwistStamped
        from rclpy.qos import QoSProfile
        from rclpy.signals import SignalHandlerOptions

        rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
        # A name that begins with an underscore is left out of lists of nodes.
        node = rclpy.create_node(f"_magcal_guard_{os.getpid()}", start_parameter_services=False)
        # A stamp of zero counts as now for bases that look at it; this clock need not be theirs.
        self._zero = TwistStamped() if stamped else Twist()
        if stamped:
            self._zero.header.frame_id = frame
        self._out = node.create_publisher(type(self._zero), topic, QoSProfile(depth=1))

    def wait_for_base(self) -> None:
        """Wait until something listens, for a while."""
        deadline = time.monotonic() + LISTENERS_WITHIN
        while not self._out.get_subscription_count() and time.monotonic() < deadline:
            time.sleep(0.02)

    def stop_base(self, tell: Callable[[], None] = lambda: None) -> None:
        """Publish zeros for a second; after the first of them somebody is told."""
        deadline = time.monotonic() + ZEROS_FOR
        self._out.publish(self._zero)
        tell()
        while time.monotonic() < deadline:
            time.sleep(ZEROS_EVERY)
            self._out.publish(self._zero)


if __name__ == "__main__":
    sys.exit(main())
