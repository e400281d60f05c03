"""A heading from a topic, as of two antennas: compared with the gyro, and used."""

from __future__ import annotations

import math
import time
from typing import TYPE_CHECKING, Any

from rclpy.callback_groups import CallbackGroup
from rclpy.node import Node
from sensor_msgs.msg import Imu

from magcal_ros.core.calibration.calibration import Calibration
from magcal_ros.core.calibration.heading_sigma import calibration_sigma
from magcal_ros.core.geometry.vec3 import dot
from magcal_ros.core.heading.base_view import BaseView
from magcal_ros.core.heading.fusion_tuning import FUSION
from magcal_ros.core.keeping.jobs import Mode
from magcal_ros.core.messages import heading_of
from magcal_ros.core.samples.streams import STREAMS, FieldSample, HeadingSample
from magcal_ros.core.session.external_heading import LOG, ExternalHeading, HeadingAgainstGyro
from magcal_ros.ros.background_thread import BackgroundThread
from magcal_ros.ros.heading_pipeline import HeadingPipeline
from magcal_ros.ros.magnetometer import Magnetometer
from magcal_ros.ros.parameters import Settings
from magcal_ros.ros.sensor_loop import SENSOR_DATA
from magcal_ros.ros.wire import Unreadable, by_rclpy
from magcal_ros.ros.worker_process import Stopped, WorkerProcess

if TYPE_CHECKING:
    from magcal_ros.core.calibrate import Outcome
    from magcal_ros.core.session.antenna import HeadingLog

TOPIC = "heading"
FRESH = 1.0
"""Seconds after which the topic's last heading is no heading of this moment."""
METHOD = "known_headings"
MISSED = 10
"""Headings in a row beyond the gate, after which it is said."""
NO_DECLINATION = (
    "it is to true north, and the declination here is not known: give reference.latitude_deg and "
    "longitude_deg, or wait for gps/fix"
)


class Antenna:
    """Listens to `heading`; without it, it does nothing.

    Attributes
    ----------
    is_heard : bool
        Whether the topic speaks, so that IMU and field samples are wanted.
    collected : list of HeadingSample or None
        Where each heading is put for as long as somebody wants it.
    """

    def __init__(
        self,
        node: Node,
        magnetometer: Magnetometer,
        pipeline: HeadingPipeline,
        fits: BackgroundThread,
        group: CallbackGroup,
    ) -> None:
        self._magnetometer, self._settled = magnetometer, pipeline.settled
        self._frames, self._follower, self._fits = pipeline.frames, pipeline.up, fits
        self._fused = pipeline.fused
        self._say = node.get_logger().info
        self._worker = WorkerProcess()
        self.topic = node.resolve_topic_name(TOPIC)
        self.is_heard = False
        self.collected: list[HeadingSample] | None = None
        self._heard: tuple[float, HeadingSample] | None = None
        self._check = HeadingAgainstGyro()
        self._log: HeadingLog | None = None
        self._view: BaseView | None = None
        self._is_fitting = False
        self._missed, self._gap = 0, 0.0
        self._imu_stamp = math.nan
        self._odd = self._answer = self._north = ""
        self.subscription = node.create_subscription(
            Imu, TOPIC, self._on_heading, SENSOR_DATA, raw=True, callback_group=group
        )

    def end(self) -> None:
        """End the process that fits for good."""
        self._worker.end()

    def forget(self) -> None:
        """Begin anew."""
        self._log, self._answer, self._north = None, "", ""
        self._missed = 0

    @property
    def is_fresh(self) -> bool:
        """Whether there is a heading of this moment."""
        return self._heard is not None and time.monotonic() - self._heard[0] < FRESH

    @property
    def silence(self) -> str:
        """Why there is none, in words to go behind its topic."""
        if self._odd:
            return f" (there is one, but {self._odd})"
        return " (the last one came too long ago)" if self._heard is not None else ""

    @property
    def complaints(self) -> list[str]:
        """What is wrong with the heading, in words."""
        words = [self._odd, *([self._check.fault, self._north] if self.is_heard else [])]
        if self.is_heard and self._missed >= MISSED:
            words.append(
                f"it misses the fused yaw by {math.degrees(self._gap):.0f}°, far beyond what both "
                "promise, and is not used: see which north it is to "
                "(known_heading.topic_north), whether its zero is to the east and the antennas' "
                "yaw in the vehicle is in it; or the calibration is out of date (~/reset)"
            )
        return [f"{self.topic}: {each}" for each in words if each]

    def facts(self) -> dict[str, Any] | None:
        """Return what `~/status` tells; None where no heading has come."""
        if self._heard is None:
            return None
        kept = 0 if self._log is None else len(self._log.standings)
        return {"topic": self.topic, "speaks": self.is_heard, "kept": kept, "found": self._answer}

    def on_imu(self, stamp: float) -> None:
        """Take the turn up to an IMU message, of which up knows already."""
        seconds, self._imu_stamp = stamp - self._imu_stamp, stamp
        up = self._follower.newest
        if up is not None and 0.0 < seconds <= STREAMS.longest_gyro_step:
            self._check.add_turn(dot(self._follower.mean_rate, up) * seconds)

    def on_field(self, sample: FieldSample) -> None:
        """Take a field sample while the topic gives a heading."""
        assert self._heard is not None
        heading, follower = self._heard[1], self._follower
        since = sample.stamp - heading.stamp
        if since > FRESH:
            self.is_heard = False
            return
        up, settings, view = follower.at(sample.stamp, 0.0), self._settled(), self._frames.view
        shift = _shift(settings)
        if self._check.fault or view is None or up is None or shift is None or since > LOG.block:
            return
        if not follower.is_propagated:
            return
        if self._log is None or self._view is not view:
            from magcal_ros.core.session.antenna import HeadingLog

            self._log, self._view = HeadingLog(view.pose[0]), view
        external = ExternalHeading(heading.yaw, heading.sigma, settings.heading_is_true)
        seen = sample.stamp, sample.field, up.direction, follower.rate
        if self._log.add(*seen, external, shift, follower.is_at_rest) and not self._is_fitting:
            self._fit(settings, self._log)

    def _on_heading(self, data: bytes) -> None:
        try:
            sample = heading_of(by_rclpy(data, Imu))
        except Unreadable as error:
            sample = str(error)
        if isinstance(sample, str):
            self._odd = sample
            return
        self._heard, self.is_heard = (time.monotonic(), sample), True
        if self.collected is not None:
            self.collected.append(sample)
        self._check.add(sample.stamp, sample.yaw)
        settings, view = self._settled(), self._frames.view
        shift = _shift(settings)
        self._odd = NO_DECLINATION if shift is None else ""
        if self._check.fault or shift is None or view is None:
            return
        x, y, z = view.pose[0].tolist()
        yaw = self._fused.yaw
        heading = sample.stamp, sample.yaw + shift, sample.sigma**2, (x, y, z)
        missed = None if yaw is None else yaw.take_heading(*heading)
        if yaw is not None and missed is not None:
            is_beyond = missed > FUSION.heading_gate
            self._missed = self._missed + 1 if is_beyond else 0
            self._gap = yaw.last_heading_gap

    def _fit(self, settings: Settings, log: HeadingLog) -> None:
        self._is_fitting = True
        standings = log.take()

        def work() -> tuple[Outcome, str]:
            from magcal_ros.core.session.antenna import fit_log

            return self._worker.run(fit_log, standings, settings.knowledge)

        self._fits.run(work, lambda found: self._note(*found, log), self._lost)

    def _lost(self, error: Exception) -> None:
        self._is_fitting = False
        if not isinstance(error, Stopped):
            self._answer = f"the fit failed: {error}"

    def _note(self, outcome: Outcome, north: str, log: HeadingLog) -> None:
        self._worker.stop()
        self._is_fitting = False
        if log is not self._log:
            return
        self._answer, self._north = outcome.verdict.summary, north
        found, before = outcome.calibration, self._magnetometer.keeper.calibration
        if self._settled().self_calibration == Mode.OFF.value:
            return
        if found is None or not outcome.verdict.accepted or not _is_better(found, before):
            return
        self._say(f"{self.topic} calibrates the compass: {self._answer}")
        is_another = before is None or before.evidence.method != METHOD
        self._magnetometer.use(found, lambda done: self._say(done.message), is_another)


def _shift(settings: Settings) -> float | None:
    """Return what is added to the heading for magnetic north, radians; None while unknown."""
    return settings.knowledge.reference.declination if settings.heading_is_true else 0.0


def _is_better(found: Calibration, before: Calibration | None) -> bool:
    """Return whether a calibration replaces the one in force: one of a turn stays."""
    if before is None:
        return calibration_sigma(found) < ENOUGH
    if before.evidence.method != METHOD:
        return False
    return calibration_sigma(found) < calibration_sigma(before)


ENOUGH = math.radians(5.0)
"""Heading sigma, one at which a calibration is no longer called rough."""
