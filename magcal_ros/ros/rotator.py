"""Lets the robot turn itself while a turn is collected, and stops it on every way out.

Nothing is published, not even zero, before a turn is opened with `rotate.enabled`; and nothing
after the zeros that end it.
"""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Callable

from geometry_msgs.msg import Twist, TwistStamped
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile

from magcal_ros.core.rotation_plan import Phase, RotationPlan, planned_duration
from magcal_ros.core.rotation_proof import RotationProof
from magcal_ros.core.streams import Pair
from magcal_ros.ros.control import Conclusion, Control, State
from magcal_ros.ros.inputs import Sensor
from magcal_ros.ros.settings import Rotation, Settings

PERIOD = 0.05
"""Seconds between velocity messages."""

ZEROS = 10
"""How often zero is sent at the end, for a single message may be lost."""

LAST_ZEROS = 5
"""How often it is sent when the process ends, `LAST_PERIOD` seconds apart."""
LAST_PERIOD = 0.03
ACKNOWLEDGED_WITHIN = 0.2
"""Seconds that the last zeros are given to arrive."""

SILENCE = 1.0
"""Seconds without a sensor after which a moving robot is stopped."""

LISTENERS_WITHIN = 3.0
"""Seconds within which something must have subscribed to cmd_vel."""


class Rotator:
    """Publishes velocities from the first usable samples of a turn until its end.

    Parameters
    ----------
    node : rclpy.node.Node
        Where publisher and timer live.
    control : Control
        Runs the turn; the robot moves only while it collects.
    sensors : tuple of Sensor
        Both must be heard before the robot moves and as long as it does.
    settings : callable
        The parameters of the moment.
    """

    def __init__(
        self,
        node: Node,
        control: Control,
        sensors: tuple[Sensor, ...],
        settings: Callable[[], Settings],
    ) -> None:
        self._node = node
        self._control = control
        self._sensors = sensors
        self._settings = settings
        self._wanted: Rotation | None = None
        self._plan: RotationPlan | None = None
        self._proof: RotationProof | None = None
        self._opened = self._last_pair = 0.0
        self._zeros_left = 0
        self._halted = False
        self._halting, self._lock = threading.Lock(), threading.Lock()
        self._out: Publisher[Twist | TwistStamped] | None = None
        self._made_for: Rotation | None = None
        self._longest = 0.0
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self._timer = node.create_timer(PERIOD, self._on_timer, clock=steady, autostart=False)
        control.on_pair = self._on_pair
        control.is_held = lambda: self._wanted is not None

    def begin(self, settings: Settings) -> Conclusion:
        """Open a turn, and turn the robot if the parameters ask for it."""
        rotation = settings.rotation
        needed = planned_duration(rotation.speed)
        if rotation.enabled and needed > settings.limits.timeout:
            return Conclusion(
                False,
                f"a turn each way at rotate.speed_rad_s {rotation.speed:g} takes {needed:.0f} s,"
                f" longer than window.timeout_s ({settings.limits.timeout:g} s): raise one of them",
            )
        opened = self._control.start(settings)
        if not opened.success or not rotation.enabled:
            return opened
        self._stop()
        self._wanted, self._proof = rotation, RotationProof(settings.knowledge.mounting.to_body)
        self._opened = time.monotonic()
        self._longest = settings.limits.timeout
        self._make_publisher(rotation)
        self._timer.reset()
        return Conclusion(True, "collecting: the robot turns itself, once each way; keep clear")

    def halt(self) -> None:
        """Stop the robot for good, from any thread; returns when the zeros are on their way."""
        # Whoever comes second waits: the context must not go before the zeros have gone.
        with self._halting:
            with self._lock:
                may_move = self._plan is not None or self._zeros_left > 0
                was_halted, self._halted = self._halted, True
            if may_move and not was_halted:
                # The context may be gone already: then there is nothing left to send through.
                with contextlib.suppress(Exception):
                    self._send_last_zeros()

    def _send_last_zeros(self) -> None:
        for _ in range(LAST_ZEROS):
            self._send(0.0)
            time.sleep(LAST_PERIOD)
        if self._out is not None:
            self._out.wait_for_all_acked(Duration(seconds=ACKNOWLEDGED_WITHIN))

    def _on_pair(self, pair: Pair) -> None:
        if self._proof is not None:
            self._last_pair = time.monotonic()
            self._proof.add(pair)

    def _on_timer(self) -> None:
        if self._zeros_left:
            self._publish(0.0)
            self._zeros_left -= 1
        elif self._wanted is None:
            self._timer.cancel()
        elif self._control.state is not State.COLLECTING:
            self._stop()
        else:
            self._look(time.monotonic())

    def _look(self, now: float) -> None:
        objection = self._objection(now)
        if objection:
            self._break_off(objection)
        elif self._plan is not None:
            self._follow(self._plan, now)
        elif all(sensor.age(now) < SILENCE for sensor in self._sensors):
            self._set_off(now)

    def _set_off(self, now: float) -> None:
        assert self._out is not None
        assert self._wanted is not None
        if self._out.get_subscription_count():
            self._plan = RotationPlan(self._wanted.speed, now, self._longest)
            self._last_pair = now
        elif now - self._opened > LISTENERS_WITHIN:
            topic = self._out.topic_name
            self._break_off(f"nobody listens to {topic}: remap cmd_vel to the base's topic")

    def _objection(self, now: float) -> str:
        """Say why the robot must not turn, or turn on; empty if it may."""
        if not self._settings().rotation.enabled:
            return "rotate.enabled was switched off"
        if self._plan is None:
            return ""
        is_unpaired = now - self._last_pair > SILENCE and self._plan.phase is not Phase.PAUSE
        quiet = max(self._sensors, key=lambda sensor: sensor.age(now))
        # Pairs end with the older of the two samples, a little before the sensor's silence.
        if quiet.age(now) > (SILENCE / 2.0 if is_unpaired else SILENCE):
            return f"{quiet.topic} has been silent for {quiet.age(now):.1f} s"
        if is_unpaired:
            return "no new field sample with an acceleration has come while the robot turned"
        return ""

    def _follow(self, plan: RotationPlan, now: float) -> None:
        assert self._proof is not None
        assert self._control.progress is not None
        told = plan.command
        seen = self._proof.seen(self._control.progress)
        self._publish(plan.step(now, seen))
        if plan.fault is not None:
            # Stopping comes first; the words may take a moment.
            self._break_off(self._proof.explain(plan.fault, seen, told))
        elif plan.phase is Phase.ENDED:
            self._stop()
            if plan.is_late:
                self._control.end_turn("the robot did not come round in time")
            elif not seen.is_complete:
                self._control.end_turn("the robot has turned once each way")

    def _break_off(self, reason: str) -> None:
        moved = self._plan is not None
        self._stop()
        self._control.break_off(f"the robot was stopped: {reason}" if moved else reason)

    def _stop(self) -> None:
        """Send zero now and for a while, if the robot may be moving; then be silent."""
        if self._plan is not None:
            self._publish(0.0)
            self._zeros_left = ZEROS
        self._wanted = self._plan = self._proof = None

    def _publish(self, rate: float) -> None:
        with self._lock:
            if not self._halted:
                self._send(rate)

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

    def _make_publisher(self, rotation: Rotation) -> None:
        """Make the publisher when it is first needed, and again when the type has changed."""
        if self._made_for is None or self._made_for.stamped != rotation.stamped:
            if self._out is not None:
                self._node.destroy_publisher(self._out)
            kind = TwistStamped if rotation.stamped else Twist
            self._out = self._node.create_publisher(kind, "cmd_vel", QoSProfile(depth=1))
        self._made_for = rotation
