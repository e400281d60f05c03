"""A base that obeys cmd_vel and keeps its last command, the worst case."""

import time

from geometry_msgs.msg import Twist, TwistStamped
from support import PATIENCE


class MobileBase:
    """Turns the actor's robot as commanded, times `gain`; keeps every received command."""

    def __init__(self, actor, stamped=False, gain=1.0):
        self.actor = actor
        self.gain = gain
        self.commands = []
        self.messages = []
        kind = TwistStamped if stamped else Twist
        actor.node.create_subscription(kind, "cmd_vel", self._on_command, 50)

    def _on_command(self, message):
        twist = message.twist if isinstance(message, TwistStamped) else message
        self.messages.append(message)
        self.commands.append((time.monotonic(), twist.angular.z))

    @property
    def rates(self):
        return [rate for _, rate in self.commands]

    @property
    def command(self):
        return self.commands[-1][1] if self.commands else 0.0

    @property
    def moves(self):
        return abs(self.command) > 0.0

    def live(self, seconds, stop=lambda: False):
        self.actor.run(seconds, lambda: self.gain * self.command, stop)

    def live_until_moving(self):
        self.live(PATIENCE, lambda: abs(self.command) > 0.2)
        assert abs(self.command) > 0.2, self.actor.status

    def answer(self, future, patience=2.0 * PATIENCE):
        self.live(patience, future.done)
        assert future.done()
        self.live(1.0)
        return future.result()

    def assert_stopped_and_silent(self):
        """The last commands are several zeros, and then none."""
        assert self.rates[-5:] == [0.0] * 5
        received = len(self.commands)
        self.live(0.4)
        assert len(self.commands) == received
