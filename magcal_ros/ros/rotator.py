"""Commands the base of a robot that turns itself, and sends zeros at every end.

A guard in a process of its own stands by from the request until the closing zeros are sent, for
the ways out on which this process can send none.
"""

from __future__ import annotations

import argparse
import contextlib
import math
import os
import select
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Sequence

from geometry_msgs.msg import Twist, TwistStamped
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile

from magcal_ros.processes import start
from magcal_ros.ros.parameters import Rotation

SILENCE = 0.3
"""Seconds without a word after which the node counts as gone, or the guard."""

ZEROS_FOR, ZEROS_EVERY = 1.0, 0.05
"""Seconds for which zeros are sent, and between two of them: a single message may be lost."""

ENDING = 2.0
"""Seconds that a guard is given to go by itself."""

ASKED, ALIVE, DISMISSED = b"?", b".", b"q"
"""What a line of the node begins with; a question follows the first two, and the second says that
the robot may move."""

STOPPED = b"stopped the base"
"""What the guard says at its end; all else are answers."""

HANDLED = ("SIGINT", "SIGTERM", "SIGHUP", "SIGQUIT", "SIGUSR1", "SIGUSR2", "SIGALRM")
"""Signals that are meant for the node: whoever ends both must not end the guard first."""


class Guard:
    """The node's end of the line to a guard of a base's topic, given by its full name."""

    def __init__(self, topic: str, stamped: bool, frame: str) -> None:
        self._process = start(
            __name__,
            *("--topic", topic, "--frame", frame, "--silence", str(SILENCE)),
            *(["--stamped"] if stamped else []),
            extra=_without_shared_memory(),
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
        """Whether it could stop the base now: it has just answered what it would do."""
        self._ask(ASKED)
        return not self.has_ended and time.monotonic() - self._proved_at < SILENCE

    @property
    def has_ended(self) -> bool:
        """Whether it is of no use any more: it stopped the base, or something ended it."""
        self._listen()
        return self._has_stopped or self._process.poll() is not None

    def tell_alive(self) -> None:
        """Say that the node is alive; from the first time on silence stops the base."""
        self._ask(ALIVE)

    def dismiss(self) -> None:
        """Let it go without stopping anything."""
        self._say(DISMISSED)
        with self._lock:
            self._line = self._answers = -1
            for stream in (self._process.stdin, self._process.stdout):
                assert stream is not None
                stream.close()
        try:
            threading.Thread(target=self._see_off, name="magcal-guard", daemon=True).start()
        except RuntimeError:  # no room for another thread
            self._process.kill()

    def _see_off(self) -> None:
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
        """Take note of what it has said."""
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
    """Return what a guard does, as it answers a question."""
    return f"zeros as {kind} on {topic} after {silence:g} s".encode()


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
    # Whatever blocks the node's log must not block the guard.
    with open(os.devnull, "wb") as nowhere:
        os.dup2(nowhere.fileno(), sys.stderr.fileno())

    def answer(question: bytes) -> None:
        if brake.has_met_base:
            _say(question + b" " + brake.duty(options.silence))

    if not is_needed(sys.stdin.fileno(), options.silence, answer):
        return 0
    brake.stop_base(lambda: _say(STOPPED))
    return 1


def _say(words: bytes) -> None:
    # The node may be gone already.
    with contextlib.suppress(BrokenPipeError):
        os.write(sys.stdout.fileno(), words + b"\n")


def is_needed(
    line: int, silence: float = SILENCE, answer: Callable[[bytes], object] = lambda _: None
) -> bool:
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
        """Return what this brake does, by its publisher's own word."""
        return duty(type(self._zero).__name__, self._out.topic_name, silence)

    def stop_base(self, tell: Callable[[], None] = lambda: None) -> None:
        """Publish zeros for a second; after the first of them somebody is told."""
        deadline = time.monotonic() + ZEROS_FOR
        self._out.publish(self._zero)
        tell()
        while time.monotonic() < deadline:
            time.sleep(ZEROS_EVERY)
            self._out.publish(self._zero)


PERIOD = 0.05
"""Seconds between velocity messages."""

LAST_ZEROS = 5
"""How often zero is sent when the process ends, `LAST_PERIOD` seconds apart."""
LAST_PERIOD = 0.03
ACKNOWLEDGED_WITHIN = 0.2
"""Seconds that the last zeros are given to arrive."""


class Rotator:
    """Publishes velocities, once there is something to say."""

    def __init__(self, node: Node, guard: Callable[[str, bool, str], Guard] = Guard) -> None:
        self._node, self._start_guard = node, guard
        self._halted = False
        self._may_move = False
        self._halting, self._lock = threading.Lock(), threading.Lock()
        self._out: Publisher | None = None
        self._made_for: Rotation | None = None
        self._guard: Guard | None = None

    @property
    def is_guarded(self) -> bool:
        """Whether a guard would stop the base if this process could not."""
        return self._guard is not None and self._guard.is_ready

    @property
    def listeners(self) -> int:
        """How many hear what is said."""
        return 0 if self._out is None else self._out.get_subscription_count()

    def prepare(self, rotation: Rotation) -> None:
        """Make the publisher when it is first needed or the type has changed; start a guard."""
        if self._made_for is None or self._made_for.stamped != rotation.stamped:
            if self._out is not None:
                if self._may_move:
                    self.move(0.0)
                self._node.destroy_publisher(self._out)
            kind = TwistStamped if rotation.stamped else Twist
            self._out = self._node.create_publisher(kind, "cmd_vel", QoSProfile(depth=1))
        self._made_for = rotation
        self._dismiss_guard()
        assert self._out is not None
        try:
            self._guard = self._start_guard(self._out.topic_name, rotation.stamped, rotation.frame)
        except OSError as error:
            self._node.get_logger().error(
                f"the guard of the turning robot cannot be started: {error.strerror or error}"
            )

    def move(self, rate: float) -> None:
        """Tell the base to turn at a rate, rad/s; nothing is said once the robot was halted."""
        with self._lock:
            if not self._halted:
                if self._guard is not None:
                    self._guard.tell_alive()
                self._send(rate)
                self._may_move = True

    def rest(self) -> None:
        """Note that the base was told to stand, often enough; the guard may go."""
        self._may_move = False
        self._dismiss_guard()

    def halt(self) -> None:
        """Stop the robot for good, from any thread; returns when the zeros are on their way."""
        # Whoever comes second waits: the context must not go before the zeros have gone.
        with self._halting:
            with self._lock:
                was_halted, self._halted = self._halted, True
            if self._may_move and not was_halted:
                # The context may be gone already: then the guard has the last word.
                with contextlib.suppress(Exception):
                    self._send_last_zeros()
                    self._dismiss_guard()

    def _dismiss_guard(self) -> None:
        guard, self._guard = self._guard, None
        if guard is not None:
            guard.dismiss()

    def _send_last_zeros(self) -> None:
        for _ in range(LAST_ZEROS):
            self._send(0.0)
            time.sleep(LAST_PERIOD)
        if self._out is not None:
            self._out.wait_for_all_acked(Duration(seconds=ACKNOWLEDGED_WITHIN))

    def _send(self, rate: float) -> None:
        assert self._out is not None
        assert self._made_for is not None
        message = Twist()
        message.angular.z = rate
        if self._made_for.stamped:
            message = TwistStamped(twist=message)
            message.header.stamp = self._node.get_clock().now().to_msg()
            message.header.frame_id = self._made_for.frame
        self._out.publish(message)
