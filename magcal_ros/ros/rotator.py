"""Commands the base of a robot that turns itself, and sends zeros whenever a turn ends.

From the request until the last zeros, a guard in a second process runs, which sends zeros if this
process cannot.
"""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Callable

from geometry_msgs.msg import Twist, TwistStamped
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile

from magcal_ros.ros.guard import Guard
from magcal_ros.ros.parameters import Rotation

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
        message = Twist()
        message.angular.z = rate
        if self._made_for.stamped:
            message = TwistStamped(twist=message)
            message.header.stamp = self._node.get_clock().now().to_msg()
            message.header.frame_id = self._made_for.frame
        self._out.publish(message)
