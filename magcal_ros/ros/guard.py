"""Commands the base of a robot that turns itself, and stops it when the node cannot.

The node sends zeros whenever a turn ends. It cannot stop the robot after SIGKILL, SIGSTOP or a
crash of the interpreter, or while a disk or terminal blocks it. The node therefore reports twenty
times a second to a small process, the guard. The guard publishes zeros when the reports stop or the
pipe breaks. It exists only from the request of a turn until the last zeros. It answers each report
with the message type and topic of its zeros, so that the node notices a guard that is stopped or
wrong.
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
from typing import TYPE_CHECKING

import rclpy
from geometry_msgs.msg import Twist, TwistStamped
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile
from rclpy.signals import SignalHandlerOptions

from magcal_ros.processes import start

if TYPE_CHECKING:
    from magcal_ros.ros.parameters import Rotation

SILENCE = 0.3  # seconds without a report or an answer after which node or guard count as failed

ZEROS_FOR, ZEROS_EVERY = 1.0, 0.05
"""Seconds for which zeros are sent, and between two zeros, because a message may be lost."""

ENDING = 2.0  # seconds that a guard is given to end after its dismissal

TRANSPORTS = "FASTDDS_BUILTIN_TRANSPORTS"

ASKED, ALIVE, DISMISSED = b"?", b".", b"q"
"""First byte of a line from the node. A question follows the first two; the second reports that the
robot may move."""

STOPPED = b"stopped the base"

NAMES = ("INT", "TERM", "HUP", "QUIT", "ABRT", "USR1", "USR2", "ALRM", "VTALRM", "PROF", "XCPU")
SIGNALS = tuple(getattr(signal, f"SIG{name}") for name in NAMES)
"""All signals that would end a process and can be caught. The node stops a moving robot then; the
guard ignores them, so that it does not end before the node."""


class Guard:
    """The node's end of the pipe to a guard; `topic` is the full name of the base's topic."""

    def __init__(self, topic: str, stamped: bool, frame: str) -> None:
        self._process = start(
            __name__,
            *(topic, frame, "stamped" if stamped else "", str(SILENCE)),
            # A process that is stopped while it writes to the shared memory of Fast DDS keeps the
            # lock of the base's port, and all other writers wait for seconds. Transports that the
            # user chose are kept.
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
        self._task = task("TwistStamped" if stamped else "Twist", topic, SILENCE)
        self._proved_at = -math.inf
        self._has_stopped = False
        self._received = b""
        # The thread of the signals dismisses the guard while the executor's thread reads.
        self._lock = threading.Lock()

    @property
    def is_ready(self) -> bool:
        """Whether the guard can stop the base: it has just answered with the right topic."""
        self._ask(ASKED)
        return not self.has_ended and time.monotonic() - self._proved_at < SILENCE

    @property
    def has_ended(self) -> bool:
        """Whether the guard has stopped the base or its process has ended."""
        self._listen()
        return self._has_stopped or self._process.poll() is not None

    def tell_alive(self) -> None:
        """Report that the node is alive; after the first report, the guard reacts to silence."""
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
        # An answer repeats the question, and so the time to which it belongs.
        self._say(kind + repr(time.monotonic()).encode())

    def _listen(self) -> None:
        """Read the answers of the guard."""
        with self._lock, contextlib.suppress(BlockingIOError):
            if self._answers >= 0:
                self._received += os.read(self._answers, 65536)
        *lines, self._received = self._received.split(b"\n")
        for line in lines:
            asked_at, _, answer = line.partition(b" ")
            if answer == self._task:
                self._proved_at = max(self._proved_at, float(asked_at))
            self._has_stopped |= line == STOPPED

    def _say(self, words: bytes) -> None:
        # A full pipe already holds enough reports; `has_ended` reports a broken pipe.
        with self._lock, contextlib.suppress(BlockingIOError, BrokenPipeError):
            if self._line >= 0:
                os.write(self._line, words + b"\n")


PERIOD = 0.05  # seconds between velocity messages
LAST_ZEROS = 5  # zeros that are sent when the process ends, `LAST_PERIOD` seconds apart
LAST_PERIOD = 0.03
ACKNOWLEDGED_WITHIN = 0.2
"""Longest wait for the acknowledgement of the last zeros, seconds."""


class Rotator:
    """Publishes velocities during a turn."""

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
        """Number of subscriptions of the velocities."""
        return 0 if self._out is None else self._out.get_subscription_count()

    def prepare(self, rotation: Rotation) -> None:
        """Create the publisher at first, or if the type has changed, and start a guard."""
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
        """Command the base to turn at a rate, rad/s; nothing is sent after `halt`."""
        with self._lock:
            if not self._halted:
                if self._guard is not None:
                    self._guard.tell_alive()
                self._send(rate)
                self._may_move = True

    def rest(self) -> None:
        """End the guard, after enough zeros were sent."""
        self._may_move = False
        self._dismiss_guard()

    def halt(self) -> None:
        """Stop the robot permanently, from any thread; returns when the zeros are sent."""
        # A second caller waits, because the context must not end before the zeros are sent.
        with self._halting:
            with self._lock:
                was_halted, self._halted = self._halted, True
            if self._may_move and not was_halted:
                # If the context has ended already, the guard sends the zeros.
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
        message = velocity(rate, self._made_for.stamped, self._made_for.frame)
        if isinstance(message, TwistStamped):
            message.header.stamp = self._node.get_clock().now().to_msg()
        self._out.publish(message)


def velocity(rate: float, stamped: bool, frame: str) -> Twist | TwistStamped:
    """Return the command to turn at a rate, rad/s."""
    message = Twist()
    message.angular.z = rate
    if stamped:
        message = TwistStamped(twist=message)
        message.header.frame_id = frame
    return message


def task(kind: str, topic: str, silence: float) -> bytes:
    """Return the answer of a guard that would stop the base as described."""
    return f"zeros as {kind} on {topic} after {silence:g} s".encode()


def main() -> int:
    """Watch standard input; returns 0 if dismissed and 1 if the base was stopped."""
    for number in SIGNALS:
        signal.signal(number, signal.SIG_IGN)
    topic, frame, stamped, silence = sys.argv[1], sys.argv[2], bool(sys.argv[3]), float(sys.argv[4])
    rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
    # Bases that check the stamp take zero as now; their clock may differ from this one.
    zero = velocity(0.0, stamped, frame)
    out = _publisher(type(zero), topic)
    # A blocked log of the node must not block the guard.
    with open(os.devnull, "wb") as nowhere:
        os.dup2(nowhere.fileno(), sys.stderr.fileno())
    proof = task(type(zero).__name__, out.topic_name, silence)
    was_connected = False

    def answer(question: bytes) -> None:
        nonlocal was_connected
        was_connected = was_connected or out.get_subscription_count() > 0
        if was_connected:
            _say(question + b" " + proof)

    if not is_needed(sys.stdin.fileno(), silence, answer):
        return 0
    deadline = time.monotonic() + ZEROS_FOR
    out.publish(zero)
    _say(STOPPED)
    while time.monotonic() < deadline:
        time.sleep(ZEROS_EVERY)
        out.publish(zero)
    return 1


def _publisher(kind: type, topic: str) -> Publisher:
    """Return the publisher of a new node.

    The node is not kept, so that its publisher of parameter events is closed.
    """
    # A name that begins with an underscore is hidden in lists of nodes.
    node = rclpy.create_node(
        f"_magcal_guard_{os.getpid()}",
        enable_rosout=False,
        start_parameter_services=False,
        parameter_overrides=[Parameter("start_type_description_service", value=False)],
    )
    return node.create_publisher(kind, topic, QoSProfile(depth=1))


def _say(words: bytes) -> None:
    # The node may have ended already.
    with contextlib.suppress(BrokenPipeError):
        os.write(sys.stdout.fileno(), words + b"\n")


def is_needed(line: int, silence: float, answer: Callable[[bytes], object]) -> bool:
    """Read the reports until the guard may end; returns whether the node failed in a turn.

    The node fails by `silence` seconds without a report or by closing the pipe.
    """
    deadline, rest = math.inf, b""
    while True:
        patience = max(0.0, deadline - time.monotonic()) if deadline < math.inf else None
        ready, _, _ = select.select([line], [], [], patience)
        words = os.read(line, 4096) if ready else b""
        *lines, rest = (rest + words).split(b"\n")
        for each in lines:
            if each == DISMISSED:
                return False
            if each.startswith(ALIVE):
                deadline = time.monotonic() + silence
            answer(each[1:])
        if not words or time.monotonic() > deadline:
            return deadline < math.inf
