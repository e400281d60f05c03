"""Invalid messages, and a node that receives them without an executor."""

import contextlib
import inspect
import json
import math

import numpy as np
import rclpy.publisher
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import Imu, MagneticField, NavSatFix
from std_msgs.msg import Float64, String
from std_srvs.srv import Trigger
from visualization_msgs.msg import MarkerArray

NUMBERS = (
    0.0, -0.0, 1.0, -1.0, 9.81, 4e-5, -4e-5, 5e-324, 1e-310, 1e-160, 1e-30, 1e3, 1e9, 1e77, 1e154,
    1e300, 1.7976931348623157e308, -1e308, math.nan, math.inf, -math.inf,
)  # fmt: skip
FRAMES = (
    "mag_link", "imu_link", "", "x" * 100_000, "../../x", "/etc/passwd", "C:\\con", "NUL", "µ 磁",
    "<script>alert(1)</script>", "\x1b[2J\x1b]0;owned\x07", "[red]", "a\nb", "{frame}", "%s",
)  # fmt: skip


def fill_vector(rng, vector, good):
    values = good if rng.random() < 0.5 else [float(rng.choice(NUMBERS)) for _ in range(3)]
    vector.x, vector.y, vector.z = map(float, values)


def fill_stamp(rng, stamp, now):
    kind = rng.integers(0, 12)
    moment = {0: 0.0, 1: now - 3.0, 2: now + 1e-9, 3: 2.0**31 - 1, 4: now + 86_400.0}.get(kind, now)
    stamp.sec, stamp.nanosec = int(moment), int(moment % 1.0 * 1e9)
    if kind == 5:
        stamp.sec, stamp.nanosec = -int(rng.integers(1, 2**31)), 2**32 - 1


def hostile_fix(rng, now):
    message = NavSatFix()
    fill_stamp(rng, message.header.stamp, now)
    message.status.status = int(rng.integers(-128, 128))
    place = [float(rng.choice(NUMBERS)) for _ in range(3)] if rng.random() < 0.5 else (50.0, 8.0, 0)
    message.latitude, message.longitude, message.altitude = map(float, place)
    return message


def hostile_message(rng, now):
    """Return one message of a sensor; about half of each one's parts are sound."""
    if rng.random() < 0.02:
        return hostile_fix(rng, now)
    is_imu = rng.random() < 0.6
    message = Imu() if is_imu else MagneticField()
    frame = FRAMES[rng.integers(0, len(FRAMES))] if rng.random() < 0.3 else FRAMES[not is_imu]
    message.header.frame_id = FRAMES[is_imu] if frame in FRAMES[:2] else frame
    fill_stamp(rng, message.header.stamp, now)
    covariance = np.array([float(rng.choice(NUMBERS)) for _ in range(9)])
    if is_imu:
        fill_vector(rng, message.linear_acceleration, (0.1, -0.2, 9.8))
        fill_vector(rng, message.angular_velocity, (0.0, 0.01, 0.5))
        if rng.random() < 0.3:
            message.angular_velocity_covariance = covariance
            message.linear_acceleration_covariance = covariance
    else:
        turn = 0.5 * now
        fill_vector(
            rng,
            message.magnetic_field,
            (2e-5 * math.cos(turn) + 1e-5, -2e-5 * math.sin(turn), -4e-5),
        )
        if rng.random() < 0.3:
            message.magnetic_field_covariance = covariance
    return message


class HandFed:
    """A node whose callbacks are called directly: more messages than a middleware can carry."""

    def __init__(self, node, monkeypatch):
        self.node = node
        self.published = {}
        self._waiting = []
        self._services = {service.srv_name.rpartition("/")[2]: service for service in node.services}
        publish = rclpy.publisher.Publisher.publish

        def watched(publisher, message):
            is_bytes = isinstance(message, bytes)
            kind = publisher.msg_type
            require_finite(deserialize_message(message, kind) if is_bytes else message)
            self.published[kind] = self.published.get(kind, 0) + 1
            publish(publisher, message)

        monkeypatch.setattr(rclpy.publisher.Publisher, "publish", watched)
        # Messages without a subscription are not made.
        monkeypatch.setattr(rclpy.publisher.Publisher, "get_subscription_count", lambda _: 1)

    def feed(self, message):
        """Pass a message to all subscriptions of its kind: both magnetometers get one field."""
        for subscription in self.node.subscriptions:
            if subscription.msg_type is type(message):
                subscription.callback(serialize_message(message) if subscription.raw else message)

    def call(self, service):
        """Call a service until its answer, or until it waits for the end of the turn."""
        answer = self._services[service].callback(Trigger.Request(), Trigger.Response())
        if inspect.iscoroutine(answer):
            with contextlib.suppress(StopIteration):
                answer.send(None)
            self._waiting.append(answer)

    def tick(self):
        for timer in self.node.timers:
            timer.callback()


def require_finite(message):
    """Every published number is finite, and the status is valid JSON."""
    if isinstance(message, Imu):
        q = message.orientation
        numbers = [q.x, q.y, q.z, q.w, *message.orientation_covariance]
    elif isinstance(message, MagneticField):
        field = message.magnetic_field
        numbers = [field.x, field.y, field.z, *message.magnetic_field_covariance]
    elif isinstance(message, Float64):
        numbers = [message.data]
    elif isinstance(message, MarkerArray):
        numbers = [v for mark in message.markers for p in mark.points for v in (p.x, p.y, p.z)]
    else:
        numbers = []
        if isinstance(message, String):
            json.loads(message.data, parse_constant=lambda word: numbers.append(math.nan))
    assert np.isfinite(numbers).all(), message
