"""What the vehicle does: its speed, its front and course, and the field of its motors."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any, TypeAlias

from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import Twist, TwistStamped
from nav_msgs.msg import Odometry
from rclpy.node import Node
from rclpy.subscription import Subscription
from sensor_msgs.msg import BatteryState, NavSatFix

from magcal_ros.core.calibration.correction import MotorField, MotorInput
from magcal_ros.core.driving.driving_tuning import SPEED, SpeedSource
from magcal_ros.core.driving.mounting_yaw import fault_words
from magcal_ros.core.driving.travel_estimator import TravelEstimator
from magcal_ros.core.earth_field.reference import Fix, LocalPlane
from magcal_ros.core.heading.base_heading import DrivenYaw, VehicleYaw, compare_with_course
from magcal_ros.core.heading.compass import Compass, CompassReader
from magcal_ros.core.heading.heading_tuning import VEHICLE_YAW
from magcal_ros.core.knowledge import ReferenceField
from magcal_ros.core.samples.battery import SILENT, Messages, usable_current
from magcal_ros.core.samples.streams import FieldSample, SpeedSample, VelocitySample
from magcal_ros.core.self_calibration.jobs import Mode
from magcal_ros.core.self_calibration.motor_learning import MotorLearning
from magcal_ros.core.up.follower import UpFollower
from magcal_ros.files.wire import seconds
from magcal_ros.ros import wire
from magcal_ros.ros.announcer import Announcer
from magcal_ros.ros.threads import SENSOR_DATA, BackgroundThread, SensorGroup
from magcal_ros.ros.wire import Unreadable

Sample: TypeAlias = SpeedSample | VelocitySample | Fix
RECEIVED: tuple[tuple[SpeedSource, type, str, Callable[[bytes], Sample | str]], ...] = (
    (SpeedSource.ODOMETRY, Odometry, "odom", wire.read_speed),
    (SpeedSource.VELOCITY, TwistStamped, "gps/vel", wire.read_velocity),
    (SpeedSource.FIXES, NavSatFix, "gps/fix", wire.read_fix),
)

BETTER_SIGMA_RATIO = 0.7  # ratio of new to stored sigma below which a new estimate is stored


class Travel:
    """Receives the optional topics `odom`, `gps/vel` and `gps/fix`."""

    def __init__(
        self,
        node: Node,
        thread: BackgroundThread,
        group: SensorGroup,
        on_fix: Callable[[Fix], object],
    ) -> None:
        self._node, self._thread, self._tell_fix = node, thread, on_fix
        self._plane = LocalPlane()
        self._unusable: dict[str, str] = {}
        self._topics: dict[SpeedSource | None, str] = {}
        self.estimator = TravelEstimator(run=self._run)
        self.driven_yaw = DrivenYaw()
        self.kept: VehicleYaw | None = None
        """The yaw that is stored with the calibration in force."""
        for source, kind, topic, read in RECEIVED:
            self._topics[source] = node.resolve_topic_name(topic)
            # Odometry is useless without the IMU, so it does not wake the node.
            is_urgent = source is not SpeedSource.ODOMETRY
            group.subscribe(node, kind, topic, partial(self._take, source, read), is_urgent)

    @property
    def yaw(self) -> VehicleYaw | None:
        """The yaw of the IMU in the vehicle: the new estimate if it is better, else the stored."""
        found = self.driven_yaw.yaw
        return found if found is not None and self._is_better(found, 1.0) else self.kept

    def _is_better(self, found: VehicleYaw, share: float) -> bool:
        """Whether a yaw has at most a share of the stored sigma, or contradicts the stored yaw."""
        kept = self.kept
        if kept is None or found.sigma <= share * kept.sigma:
            return True
        gap = math.remainder(found.offset - kept.offset, math.tau)
        return abs(gap) >= 3.0 * math.hypot(found.sigma, kept.sigma)

    def use(self, kept: VehicleYaw | None) -> None:
        """Take the yaw that is stored with a new calibration in force."""
        self.estimator.forget_compass()
        if kept is not None:
            self.kept = kept
            self.estimator.use_mounting_yaw(kept.offset, kept.sigma)

    def follow(self, reference: ReferenceField, announcer: Announcer) -> VehicleYaw | None:
        """Estimate the front, once a second, and log changes; returns a yaw to store, if any."""
        estimator = self.estimator
        if not estimator.has_samples:
            return None
        north = reference.declination, reference.declination_sigma
        self.driven_yaw = compare_with_course(estimator.known_mounting, estimator.course, *north)
        found = self.driven_yaw.yaw
        if (
            found is None
            or found.sigma > VEHICLE_YAW.useful
            or not self._is_better(found, BETTER_SIGMA_RATIO)
        ):
            return None
        self.kept = found
        announcer.tell("front", found.words)
        return found

    @property
    def complaints(self) -> list[str]:
        """Faults of speeds, compass or declination, in words."""
        mounting = self.estimator.mounting
        words = [
            fault_words(self._topics[source], fault, mounting.checked[source])
            for source, fault in mounting.faults.items()
            if source in mounting.checked
        ]
        words += [f"{topic}: {why}" for topic, why in self._unusable.items()]
        if self.driven_yaw.suspicion:
            words.append(self.driven_yaw.suspicion)
        return words

    def yaw_facts(self) -> dict[str, Any] | None:
        """Return the part of `~/status` on the yaw of the IMU in the vehicle; None if unknown."""
        yaw = self.yaw
        if yaw is None:
            return None
        deg, sigma = (round(math.degrees(angle), 2) for angle in (yaw.offset, yaw.sigma))
        return {"deg": deg, "sigma_deg": sigma, "by": yaw.source, "words": yaw.words}

    def facts(self) -> dict[str, Any] | None:
        """Return the part of `~/status` on the drive; None without speeds and fixes."""
        estimator, yaw = self.estimator, self.yaw
        if not estimator.has_samples and yaw is None:
            return None
        course = estimator.course
        return {
            "speed_from": self._topics.get(estimator.source),
            "own_acceleration_taken_off": estimator.acceleration.is_measured,
            "metres": round(estimator.metres, -1),
            "drifts": estimator.drifts,
            "course_gap_deg": _degrees(self.driven_yaw.compass_gap),
            "course_gap_sigma_deg": _degrees(self.driven_yaw.compass_sigma),
            "course_metres": None if course is None else round(course.metres, -1),
        }

    def diagnostics(self) -> list[DiagnosticStatus]:
        """Return the diagnostic of the drive; empty without speeds and fixes."""
        if not self.estimator.has_samples:
            return []
        yaw, wrong = self.yaw, self.complaints
        driven_yaw = "the vehicle's front is not known yet" if yaw is None else yaw.words
        level = DiagnosticStatus.WARN if wrong else DiagnosticStatus.OK
        values = {key: str(value) for key, value in (self.facts() or {}).items()}
        return [wire.diagnostic("Drive", "; ".join([driven_yaw, *wrong]), values, level)]

    def _run(self, work: Callable[[], Any], then: Callable[[Any], None]) -> None:
        def fail(error: Exception) -> None:
            self.estimator.give_up_fit()
            self._node.get_logger().error(f"a fit of the drive has failed: {error!r}")

        self._thread.run(work, then, fail)

    def _take(
        self, source: SpeedSource, read: Callable[[bytes], Sample | str], data: bytes
    ) -> None:
        """Take a message; if it has no usable sample, the reason becomes a complaint."""
        is_by_wheels = source is SpeedSource.ODOMETRY
        if is_by_wheels and not self.estimator.wants_speed(wire.read_stamp(data)):
            return
        try:
            found = read(data)
        except Unreadable as error:
            found = str(error)
        if isinstance(found, str):
            self._unusable[self._topics[source]] = found
            return
        self._unusable.pop(self._topics[source], None)
        if not isinstance(found, Fix):
            self.estimator.add_travel(found)
            return
        # The reference field reports the faults of fixes.
        self._tell_fix(found)
        position = self._plane.position(found)
        if position is not None:
            self.estimator.add_travel(position)


def _degrees(angle: float) -> float | None:
    return round(math.degrees(angle), 1) if math.isfinite(angle) else None


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
        published = (
            kinds.get(each.topic_type.rsplit("/", 1)[-1])
            for each in self._node.get_publishers_info_by_topic(self.topic)
            if (each.node_name, each.node_namespace) != own
        )
        kind = next(filter(None, published), None)
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
        speed, self._received = float(twist.linear.x), self._up.newest_stamp
        self._speed = speed if abs(speed) <= SPEED.largest else math.nan


class Motors:
    """Determines the state of the motors by gyro, wheels and battery, and learns their field."""

    def __init__(self, node: Node, up: UpFollower, travel: Travel) -> None:
        self._up, self._estimator = up, travel.estimator
        self.reader = CompassReader(up, self.inputs)
        self._current, self._received = math.nan, -math.inf
        self._compass: Compass | None = None
        self._learning: MotorLearning | None = None
        self._learns, self._has_learnt, self._waited = False, False, 0
        self.commands = CommandTopic(node, up)
        self._topic = node.resolve_topic_name("battery")
        self._odom = node.resolve_topic_name("odom")
        node.create_subscription(BatteryState, "battery", self._on_battery, SENSOR_DATA)

    def inputs(self, stamp: float) -> tuple[float, float]:
        """Return speed and current at the stamp of a field message, for `CompassReader`."""
        current = self._current if abs(stamp - self._received) < SILENT else math.nan
        speed = self._estimator.wheel_speed(stamp)
        return self.commands.speed_near(stamp) if math.isnan(speed) else speed, current

    @property
    def currents(self) -> Messages:
        """The battery's newest message, if there is one."""
        return () if math.isnan(self._current) else ((self._received, self._current),)

    def take(self, compass: Compass | None, sample: FieldSample) -> FieldSample:
        """Learn from a sample; returns it without the field of the motors known to a compass."""
        if compass is not self._compass:
            before = None if self._compass is None else self._compass.motors
            self._compass, self._learning, self._has_learnt = compass, None, False
            if compass is not None and compass.motors is not None and before is not None:
                # The inputs that were learnt before are kept.
                compass.use_motors(compass.motors.combined_with(before))
        if compass is None:
            return sample
        rate = self._up.rate if self._learns else None
        if rate is None and compass.motors is None:
            return sample
        motor_state = self.reader.motor_state(sample.stamp, compass)
        if rate is not None:
            if self._learning is None:
                known = replace(compass.calibration, motors=compass.motors)
                self._learning = MotorLearning(known)
            is_done = self._learning.add(sample.stamp, sample.field, rate, motor_state)
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

    def facts(self, compass: Compass | None) -> dict[str, Any] | None:
        """Return the part of `~/status` on the motors; None if their field is unknown."""
        motors = None if compass is None else compass.motors
        if motors is None:
            return None
        now = self.reader.detector.newest
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
        self._current = usable_current(float(message.current))
