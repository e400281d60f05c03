"""Speeds and fixes, for the up vector, the vehicle's front and the check of compass by course."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from typing import Any, TypeAlias

from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import TwistStamped
from nav_msgs.msg import Odometry
from rclpy.callback_groups import CallbackGroup
from rclpy.node import Node
from sensor_msgs.msg import NavSatFix

from magcal_ros.core.driving.driving_tuning import SpeedSource
from magcal_ros.core.driving.mounting_yaw import fault_words
from magcal_ros.core.driving.travel_estimator import TravelEstimator
from magcal_ros.core.earth_field.reference import Fix, LocalPlane
from magcal_ros.core.heading.base_heading import (
    DrivenYaw,
    VehicleYaw,
    compare_with_course,
)
from magcal_ros.core.heading.heading_tuning import VEHICLE_YAW
from magcal_ros.core.knowledge import ReferenceField
from magcal_ros.core.samples.streams import SpeedSample, VelocitySample
from magcal_ros.ros import wire
from magcal_ros.ros.announcer import Announcer
from magcal_ros.ros.threads import SENSOR_DATA, BackgroundThread
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
        group: CallbackGroup,
        on_fix: Callable[[Fix], None],
    ) -> None:
        self._node, self._thread, self._tell_fix = node, thread, on_fix
        self._plane = LocalPlane()
        self._unusable: dict[str, str] = {}
        self._topics: dict[SpeedSource | None, str] = {}
        self.estimator = TravelEstimator(run=self._run)
        self.driven_yaw = DrivenYaw()
        self.kept: VehicleYaw | None = None
        """The yaw that is stored with the calibration in force."""
        self.subscriptions = []  # of odometry, velocity and fixes; their callbacks take bytes
        for source, kind, topic, read in RECEIVED:
            self._topics[source] = node.resolve_topic_name(topic)
            take = partial(self._take, source, read)
            subscription = node.create_subscription(
                kind, topic, take, SENSOR_DATA, raw=True, callback_group=group
            )
            self.subscriptions.append(subscription)

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
