"""Speed and fixes: they improve up, and show the vehicle's front and the compass against course."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, TypeVar

from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import TwistStamped
from nav_msgs.msg import Odometry
from rclpy.callback_groups import CallbackGroup
from rclpy.node import Node
from sensor_msgs.msg import NavSatFix

from magcal_ros.core.driving.driving_tuning import SpeedSource
from magcal_ros.core.driving.mounting_yaw import fault_words
from magcal_ros.core.driving.travelling import Travelling
from magcal_ros.core.earth_field.reference import Fix, LocalPlane
from magcal_ros.core.geometry.vec3 import Triple
from magcal_ros.core.heading.base_view import (
    FRONT,
    Declination,
    Front,
    VehicleYaw,
    where_is_the_front,
)
from magcal_ros.core.heading.compass import Moment
from magcal_ros.core.knowledge import ReferenceField
from magcal_ros.core.monitoring.recorded_course import (
    check_by_course,
    course_fault,
)
from magcal_ros.core.samples.streams import ImuSample, SpeedSample, VelocitySample
from magcal_ros.core.up import UpFollower
from magcal_ros.ros import wire
from magcal_ros.ros.announcer import Announcer
from magcal_ros.ros.sensor_frames import SensorFrames
from magcal_ros.ros.threads import SENSOR_DATA, BackgroundThread
from magcal_ros.ros.wire import Unreadable

Sample = TypeVar("Sample", SpeedSample, VelocitySample, Fix)

BETTER = 0.7
"""Share of the sigma that is kept, below which a newly found yaw is kept instead."""


class Travel:
    """Receives `odom`, `gps/vel` and `gps/fix`; without any of them it does nothing.

    `subscriptions` are those of wheels, velocity and fixes; their callbacks take bytes.
    """

    def __init__(
        self,
        node: Node,
        thread: BackgroundThread,
        group: CallbackGroup,
        on_fix: Callable[[Fix], None],
    ) -> None:
        self._node, self._thread, self._tell_fix = node, thread, on_fix
        self._plane = LocalPlane()
        self._odd: dict[str, str] = {}
        self._topics: dict[SpeedSource | None, str] = {
            SpeedSource.ODOMETRY: node.resolve_topic_name("odom"),
            SpeedSource.VELOCITY: node.resolve_topic_name("gps/vel"),
            SpeedSource.FIXES: node.resolve_topic_name("gps/fix"),
        }
        self._travelling = Travelling(run=self._run)
        self.front = Front()
        self.kept: VehicleYaw | None = None
        """The yaw that lies beside the calibration in force."""
        self.subscriptions = [
            node.create_subscription(
                kind, topic, callback, SENSOR_DATA, raw=True, callback_group=group
            )
            for kind, topic, callback in (
                (Odometry, "odom", self._on_odometry),
                (TwistStamped, "gps/vel", self._on_velocity),
                (NavSatFix, "gps/fix", self._on_fix),
            )
        ]

    @property
    def yaw(self) -> VehicleYaw | None:
        """How the IMU sits in the vehicle: what is found now, else what was kept."""
        found, kept = self.front.yaw, self.kept
        if found is None or (kept is not None and found.sigma > kept.sigma and _agree(found, kept)):
            return kept
        return found

    def on_imu(self, sample: ImuSample, follower: UpFollower) -> Triple | None:
        """Take an IMU sample; returns the vehicle's own acceleration, m/s², where it is known."""
        return self._travelling.add_imu(sample, follower.gyro_bias.rate)

    @property
    def speed(self) -> float:
        """The newest speed, m/s; NaN where it is unknown."""
        return self._travelling.speed

    @property
    def has_wheels(self) -> bool:
        """Whether the speed of wheels comes often enough to time starts and stops by it."""
        track = self._travelling.speedometer.track
        if track is None or track.source is not SpeedSource.ODOMETRY:
            return False
        return math.isfinite(track.newest) and not track.is_slow

    def speed_near(self, stamp: float) -> float:
        """Return what wheels say, m/s; NaN without a measurement near a stamp, seconds."""
        track = self._travelling.speedometer.tracks[SpeedSource.ODOMETRY]
        if abs(stamp + track.delay - track.newest) > track.gap or not self.has_wheels:
            return math.nan
        return track.last

    def on_moment(self, moment: Moment) -> None:
        """Take what a field message comes to."""
        if moment.heading is not None:
            self._travelling.add_yaw(moment.heading.yaw)

    def use(self, kept: VehicleYaw | None) -> None:
        """Another calibration is in force; take what lies beside it."""
        self._travelling.forget_compass()
        if kept is not None:
            self.kept = kept
            self._travelling.believe(kept.offset, kept.sigma)

    def look(self, reference: ReferenceField) -> VehicleYaw | None:
        """Compare what is known, once a second; returns a yaw that is to be kept, if there is."""
        travelling = self._travelling
        if not travelling.is_heard:
            return None
        known = reference.declination
        sigma = reference.declination_sigma
        declination = Declination() if known is None else Declination(known, sigma)
        self.front = where_is_the_front(travelling.known_mounting, travelling.course, declination)
        found, kept = self.front.yaw, self.kept
        if found is None or found.sigma > FRONT.useful:
            return None
        if kept is not None and found.sigma > BETTER * kept.sigma and _agree(found, kept):
            return None
        self.kept = found
        return found

    def follow(
        self, reference: ReferenceField, frames: SensorFrames, announcer: Announcer
    ) -> VehicleYaw | None:
        """Use what is known, once a second, and say what is new; returns what is to be kept."""
        news = self.look(reference)
        frames.note_vehicle_yaw(self.yaw)
        if self.verdict:
            announcer.tell("course", self.verdict, wrong=True)
        if news is not None:
            announcer.tell("front", news.words)
        return news

    @property
    def complaints(self) -> list[str]:
        """What is wrong with speeds, compass or declination, in words."""
        watch = self._travelling.mounting
        words = [
            fault_words(self._topics[source], fault, watch.seen[source])
            for source, fault in watch.faults.items()
            if source in watch.seen
        ]
        words += [f"{topic}: {why}" for topic, why in self._odd.items()]
        if self.front.suspicion:
            words.append(self.front.suspicion)
        return words

    @property
    def verdict(self) -> str:
        """What course says against the calibration in force; empty if nothing."""
        if self._travelling.known_mounting is None:
            # A vehicle that moves sideways would make every compass look wrong.
            return ""
        return course_fault(check_by_course(self._travelling.course))

    def facts(self) -> dict[str, Any] | None:
        """Return the part of `~/status` on the drive; None where no speed and no fix came."""
        travelling, yaw = self._travelling, self.yaw
        if not travelling.is_heard and yaw is None:
            return None
        course = travelling.course
        return {
            "speed_from": self._topics.get(travelling.source),
            "own_acceleration_taken_off": travelling.own.is_used,
            "metres": round(travelling.metres, -1),
            "drifts": travelling.drift.is_drifting,
            "course_gap_deg": _degrees(self.front.compass_gap),
            "course_gap_sigma_deg": _degrees(self.front.compass_sigma),
            "course_metres": None if course is None else round(course.metres, -1),
            "course_swing_deg": None if course is None else _degrees(course.swing(1)[0]),
            "verdict": self.verdict,
        }

    def diagnostics(self, name: str) -> list[DiagnosticStatus]:
        """Say what the drive has shown so far; nothing where no speed and no fix has come."""
        if not self._travelling.is_heard:
            return []
        yaw, verdict = self.yaw, self.verdict
        front = "the vehicle's front is not known yet" if yaw is None else yaw.words
        wrong = [*self.complaints, *([verdict] if verdict else [])]
        level = DiagnosticStatus.WARN if wrong else DiagnosticStatus.OK
        values = {key: str(value) for key, value in (self.facts() or {}).items()}
        return [wire.diagnostic(name, "Drive", "; ".join([front, *wrong]), values, level)]

    def _run(self, work: Callable[[], Any], then: Callable[[Any], None]) -> None:
        def fail(error: Exception) -> None:
            self._travelling.give_up_fit()
            self._node.get_logger().error(f"a fit of the drive has failed: {error!r}")

        self._thread.run(work, then, fail)

    def _on_odometry(self, data: bytes) -> None:
        if not self._travelling.wants_speed(wire.read_stamp(data)):
            return
        sample = self._read(SpeedSource.ODOMETRY, wire.read_speed, data)
        if sample is not None:
            self._travelling.add_travel(sample)

    def _on_velocity(self, data: bytes) -> None:
        sample = self._read(SpeedSource.VELOCITY, wire.read_velocity, data)
        if sample is not None:
            self._travelling.add_travel(sample)

    def _on_fix(self, data: bytes) -> None:
        fix = self._read(SpeedSource.FIXES, wire.read_fix, data)
        if fix is None:
            return
        # What is wrong with fixes is said where the place is looked up.
        self._tell_fix(fix)
        position = self._plane.position(fix)
        if position is not None:
            self._travelling.add_travel(position)

    def _read(
        self, source: SpeedSource, read: Callable[[bytes], Sample | str], data: bytes
    ) -> Sample | None:
        """Return the sample that bytes hold; where they hold none, keep why as a complaint."""
        try:
            found = read(data)
        except Unreadable as error:
            found = str(error)
        topic = self._topics[source]
        if isinstance(found, str):
            self._odd[topic] = found
            return None
        self._odd.pop(topic, None)
        return found


def _agree(one: VehicleYaw, other: VehicleYaw) -> bool:
    gap = math.remainder(one.offset - other.offset, math.tau)
    return abs(gap) < 3.0 * math.hypot(one.sigma, other.sigma)


def _degrees(angle: float) -> float | None:
    return round(math.degrees(angle), 1) if math.isfinite(angle) else None
