"""What the motors do at the moment, and what is known of their field."""

from __future__ import annotations

import math
from typing import Any

from rclpy.node import Node
from sensor_msgs.msg import BatteryState

from magcal_ros.core.calibration.motors import AT_REST, MotorInput, Running
from magcal_ros.core.heading.compass import Compass
from magcal_ros.core.heading.running import MotionSense
from magcal_ros.core.messages import seconds
from magcal_ros.core.samples.streams import FieldSample
from magcal_ros.core.up import UpFollower
from magcal_ros.ros.straight import SENSOR_DATA
from magcal_ros.ros.travel import Travel

SILENT = 1.5
"""Seconds without a message after which nobody knows the current any more."""


class Motors:
    """Follows what the motors do, by gyro, wheels and battery.

    Parameters
    ----------
    node : rclpy.node.Node
        Where the subscription lives.
    up : UpFollower
        Has taken each IMU message.
    travel : Travel
        Knows the speed.
    """

    def __init__(self, node: Node, up: UpFollower, travel: Travel) -> None:
        self._up, self._travel = up, travel
        self._sense = MotionSense()
        self._current, self._told = math.nan, -math.inf
        self._topic = node.resolve_topic_name("battery")
        self._odom = node.resolve_topic_name("odom")
        node.create_subscription(BatteryState, "battery", self._on_battery, SENSOR_DATA)

    def running(self, stamp: float) -> Running:
        """Return what the motors do at the stamp of a field message, seconds."""
        rate = self._up.rate if self._up.is_propagated else None
        current = self._current if abs(stamp - self._told) < SILENT else math.nan
        speed = self._travel.speed_near(stamp)
        return self._sense.at(stamp, rate, self._up.is_at_rest, speed, current)

    def as_used(self, compass: Compass, stamp: float) -> Running:
        """Return the same as far as a compass knows motors."""
        return AT_REST if compass.motors is None else self.running(stamp)

    def at_rest(self, compass: Compass | None, sample: FieldSample) -> FieldSample:
        """Return a sample without what the motors add to it, as a compass knows them."""
        if compass is None or compass.motors is None:
            return sample
        running = self.running(sample.stamp)
        return FieldSample(sample.stamp, compass.without_motors(sample.field, running))

    def facts(self, compass: Compass | None) -> dict[str, Any] | None:
        """Return what `~/status` tells of the motors; None where nothing is known of them."""
        motors = None if compass is None else compass.motors
        if motors is None:
            return None
        now = self._sense.newest
        return {
            "moves": None if now.moving == 0.5 else now.moving > 0.5,
            "ripple_ut": round(motors.ripple * 1e6, 2),
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
        """Return who tells an input, for people."""
        if which is MotorInput.CURRENT:
            return self._topic
        if which is MotorInput.TURN_RATE:
            return "gyro"
        speed = self._odom if self._travel.speed_from is None else self._travel.speed_from
        if which is MotorInput.SPEED:
            return speed
        return "gyro" if self._travel.speed_from is None else f"gyro and {speed}"

    def _on_battery(self, message: BatteryState) -> None:
        # Zero stamps are usual in drivers of batteries: the IMU's newest is as good.
        stamp = seconds(message.header.stamp)
        newest = self._up.newest_stamp
        self._told = stamp if abs(stamp - newest) < SILENT else newest
        self._current = float(message.current)
