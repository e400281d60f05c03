"""The state of the motors, and the magnetic field that they add."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

from geometry_msgs.msg import Twist, TwistStamped
from rclpy.node import Node
from rclpy.subscription import Subscription
from sensor_msgs.msg import BatteryState

from magcal_ros.core.calibration.correction import MotorField, MotorInput, MotorState
from magcal_ros.core.heading.compass import Compass
from magcal_ros.core.heading.motor_inputs import MotionDetector
from magcal_ros.core.messages import seconds
from magcal_ros.core.samples.battery import SILENT, Messages
from magcal_ros.core.samples.streams import FieldSample
from magcal_ros.core.self_calibration.jobs import Mode
from magcal_ros.core.self_calibration.motor_learning import MotorLearning
from magcal_ros.core.up.follower import UpFollower
from magcal_ros.ros.threads import SENSOR_DATA
from magcal_ros.ros.travel import BETTER_SIGMA_RATIO, Travel

PAUSE = 60  # seconds of learning between two saves


class CommandTopic:
    """Receives the commanded speed, in the message type of its publisher.

    There is no subscription while wheels measure the speed, or while this node turns the robot and
    counts the subscriptions of its own commands.
    """

    def __init__(self, node: Node, up: UpFollower) -> None:
        self._node, self._up = node, up
        self.topic = node.resolve_topic_name("cmd_vel")
        self._subscription: Subscription | None = None
        self._speed, self._received = math.nan, -math.inf

    @property
    def is_received(self) -> bool:
        """Whether a command has arrived since the subscription."""
        return math.isfinite(self._speed)

    def speed_near(self, stamp: float) -> float:
        """Return the commanded speed, m/s; NaN without a command near a stamp, seconds."""
        return self._speed if abs(stamp - self._received) < SILENT else math.nan

    def follow(self, is_wanted: bool) -> None:
        """Subscribe or unsubscribe, once a second."""
        if not is_wanted:
            self.leave()
            return
        kinds = {kind.__name__: kind for kind in (Twist, TwistStamped)}
        own = self._node.get_name(), self._node.get_namespace()
        published = [
            each.topic_type.rsplit("/", 1)[-1]
            for each in self._node.get_publishers_info_by_topic(self.topic)
            if (each.node_name, each.node_namespace) != own
        ]
        kind = next((kinds[each] for each in published if each in kinds), None)
        present = None if self._subscription is None else self._subscription.msg_type
        if kind is not None and kind is not present:
            self.leave()
            self._subscription = self._node.create_subscription(
                kind, self.topic, self._on_command, SENSOR_DATA
            )

    def leave(self) -> None:
        """Unsubscribe."""
        if self._subscription is not None:
            self._node.destroy_subscription(self._subscription)
        self._subscription, self._speed = None, math.nan

    def _on_command(self, message: Twist | TwistStamped) -> None:
        # The time of a command is that of its arrival, on the clock of the sensors.
        twist = message.twist if isinstance(message, TwistStamped) else message
        self._speed, self._received = float(twist.linear.x), self._up.newest_stamp


class Motors:
    """Determines the state of the motors by gyro, wheels and battery, and learns their field."""

    def __init__(self, node: Node, up: UpFollower, travel: Travel) -> None:
        self._up, self._estimator = up, travel.estimator
        self._detector = MotionDetector()
        self._current, self._received = math.nan, -math.inf
        self._compass: Compass | None = None
        self._learning: MotorLearning | None = None
        self._learns, self._has_learnt, self._waited = False, False, 0
        self.commands = CommandTopic(node, up)
        self._topic = node.resolve_topic_name("battery")
        self._odom = node.resolve_topic_name("odom")
        node.create_subscription(BatteryState, "battery", self._on_battery, SENSOR_DATA)

    def motor_state(self, stamp: float, motors: MotorField | None) -> MotorState:
        """Return the state of the motors at the stamp of a field message, seconds.

        The current is relative to the reference current of `motors`.
        """
        rate = self._up.rate if self._up.is_propagated else None
        current = self._current if abs(stamp - self._received) < SILENT else math.nan
        speed = self._estimator.wheel_speed(stamp)
        speed = self.commands.speed_near(stamp) if math.isnan(speed) else speed
        reference = math.nan if motors is None else motors.reference
        return self._detector.at(stamp, rate, self._up.is_at_rest, speed, current, reference)

    @property
    def currents(self) -> Messages:
        """The battery's newest message, if there is one."""
        return () if math.isnan(self._current) else ((self._received, self._current),)

    def take(self, compass: Compass | None, sample: FieldSample) -> FieldSample:
        """Learn from a sample; returns it without the field of the motors known to a compass."""
        if compass is not self._compass:
            self._use(compass)
        if compass is None:
            return sample
        learns = self._learns and self._up.is_propagated
        if not learns and compass.motors is None:
            return sample
        motor_state = self.motor_state(sample.stamp, compass.motors)
        if learns:
            if self._learning is None:
                known = replace(compass.calibration, motors=compass.motors)
                self._learning = MotorLearning(known)
            is_done = self._learning.add(sample.stamp, sample.field, self._up.rate, motor_state)
            self._has_learnt = is_done or self._has_learnt
        return FieldSample(sample.stamp, compass.without_motors(sample.field, motor_state))

    def follow(self, mode: Mode, is_turning: bool, kept: MotorField | None) -> MotorField | None:
        """Use the learnt field, once a second; returns a field to store in place of `kept`."""
        # While this node turns the robot, it counts the subscriptions of its commands.
        self.commands.follow(not self._estimator.has_wheels and not is_turning)
        if mode is Mode.OFF:
            self._learning = None
        # Determined once a second and not for each message, because it rarely changes.
        known = self._current, self.commands.speed_near(self._up.newest_stamp)
        has_input = self._estimator.has_wheels or any(map(math.isfinite, known))
        self._learns = has_input and mode is not Mode.OFF
        if self._learning is None or self._compass is None or not self._has_learnt:
            return None
        self._has_learnt = False
        motors = self._learning.motors
        self._compass.use_motors(motors)
        self._waited += 1
        if mode is not Mode.APPLY or self._waited < PAUSE:
            return None
        if not motors.improves_on(kept, BETTER_SIGMA_RATIO):
            return None
        self._waited = 0
        return motors

    def _use(self, compass: Compass | None) -> None:
        """Take another calibration, and keep the inputs of the motors."""
        before = None if self._compass is None else self._compass.motors
        self._compass, self._learning, self._has_learnt = compass, None, False
        if compass is not None and compass.motors is not None and before is not None:
            compass.use_motors(compass.motors.combined_with(before))

    def facts(self, compass: Compass | None) -> dict[str, Any] | None:
        """Return the part of `~/status` on the motors; None if their field is unknown."""
        motors = None if compass is None else compass.motors
        if motors is None:
            return None
        now = self._detector.newest
        delay = None if self._learning is None else [round(s, 2) for s in self._learning.delay]
        return {
            "moves": None if now.moving == 0.5 else now.moving > 0.5,
            "learns": self._learning is not None,
            "ripple_ut": round(motors.ripple * 1e6, 2),
            "current_delay_s": delay if MotorInput.CURRENT in motors.inputs else None,
            "inputs": {
                each.value: {
                    "from": self._source(each),
                    "per": each.unit,
                    "field_ut": [round(float(value) * 1e6, 2) for value in motors.gain[k]],
                    "sigma_ut": round(motors.sigma(k) * 1e6, 2),
                }
                for k, each in enumerate(motors.inputs)
            },
        }

    def _source(self, which: MotorInput) -> str:
        """Return the source of an input, in words."""
        if which is MotorInput.CURRENT:
            return self._topic
        if which in (MotorInput.TURN_RATE, MotorInput.SIDE, MotorInput.ABS_TURN_RATE):
            return "gyro"
        speed = self.commands.topic if self.commands.is_received else self._odom
        if which in (MotorInput.SPEED, MotorInput.ABS_SPEED):
            return speed
        is_known = self._estimator.has_wheels or self.commands.is_received
        return f"gyro and {speed}" if is_known else "gyro"

    def _on_battery(self, message: BatteryState) -> None:
        # Many drivers of batteries send zero stamps, so the newest stamp of the IMU replaces a
        # stamp that is far from it.
        stamp = seconds(message.header.stamp)
        newest = self._up.newest_stamp
        self._received = stamp if abs(stamp - newest) < SILENT else newest
        self._current = float(message.current)
