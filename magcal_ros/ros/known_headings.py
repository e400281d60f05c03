"""Known headings: typed in where a robot stands, or told by a topic."""

from __future__ import annotations

import math
import time
from typing import TYPE_CHECKING, Any

from rclpy.callback_groups import CallbackGroup
from rclpy.clock import Clock, ClockType
from rclpy.node import Node

from magcal_ros.core.errors import in_words
from magcal_ros.core.samples.streams import FieldSample, Pair, Pairer
from magcal_ros.core.session.external_heading import TUNING, ExternalHeading, TurnSince
from magcal_ros.core.session.turn_events import Conclusion, TurnState
from magcal_ros.ros.antenna import Antenna
from magcal_ros.ros.background_thread import BackgroundThread
from magcal_ros.ros.heading_pipeline import HeadingPipeline
from magcal_ros.ros.keeper import Tell
from magcal_ros.ros.magnetometer import Magnetometer
from magcal_ros.ros.parameters import Settings
from magcal_ros.ros.services import Turns
from magcal_ros.ros.worker_process import Stopped, WorkerProcess

if TYPE_CHECKING:
    from magcal_ros.core.session.at_known_heading import HeadingResult
    from magcal_ros.core.smoother.standings import Standing

TICK = 0.2
"""Seconds between looks while samples are collected."""
NO_HEADING = (
    "no known heading: set known_heading.yaw_deg (ENU: 0 to the east, 90 to the north, positive to "
    "the left) and known_heading.north (true_north or magnetic_north), or publish a "
    "sensor_msgs/Imu with an orientation on "
)
NO_NORTH = (
    "say which north known_heading.yaw_deg is to: set known_heading.north to true_north (maps, "
    "walls in plans, two antennas) or magnetic_north (a compass)"
)


class KnownHeadings:
    """Calibrates where the robot stands at a known heading.

    Attributes
    ----------
    antenna : Antenna
        Listens to the topic.
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
        self._streams = pipeline.streams
        self.antenna = Antenna(node, magnetometer, pipeline, fits, group)
        self._worker = WorkerProcess()
        self._standings: tuple[Standing, ...] = ()
        self._epoch = 0
        self._sensors = ""
        self._since: TurnSince | None = None
        self._pairs: list[Pair] = []
        self._pairer = Pairer(self._streams)
        self._given: ExternalHeading | None = None
        self._tell: Tell | None = None
        self._deadline = math.inf
        self._is_collecting = False
        self._answer = ""
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self._timer = node.create_timer(TICK, self._on_tick, clock=steady)
        self._timer.cancel()

    @property
    def follows(self) -> bool:
        """Whether it wants each IMU sample."""
        return self._since is not None or self.antenna.is_heard

    def end(self) -> None:
        """End the processes that fit for good."""
        self._worker.end()
        self.antenna.end()

    def forget(self) -> None:
        """Begin anew with the next heading."""
        self._standings, self._since = (), None
        self._epoch += 1
        self._answer = ""
        self.antenna.forget()

    def note_sensors(self, sensors: str) -> None:
        """Take note of which sensors are heard: where others stood says nothing of these."""
        if self._sensors and sensors != self._sensors:
            self.forget()
        self._sensors = sensors

    def calibrate(self, turns: Turns, tell: Tell) -> None:
        """Collect where the robot stands now, and tell what its heading shows."""
        if turns.state is not TurnState.IDLE:
            tell(Conclusion(False, "a turn is under way: wait for its verdict first"))
            return
        if self._tell is not None:
            tell(Conclusion(False, "already collecting at a known heading: wait for its answer"))
            return
        settings = self._settled()
        given = settings.known_heading
        if settings.north_is_missing:
            tell(Conclusion(False, NO_NORTH))
        elif given is None and not self.antenna.is_fresh:
            words = f"{NO_HEADING}{self.antenna.topic}{self.antenna.silence}"
            tell(Conclusion(False, words))
        elif self._frames.view is None:
            tell(
                Conclusion(
                    False,
                    "the pose of the IMU in base_frame is not known, so that a heading of that "
                    "frame says nothing of the IMU's: publish robot_description, or leave "
                    "base_frame empty and give the IMU's heading",
                )
            )
        else:
            self._tell, self._given = tell, given
            self._pairs, self.antenna.collected = [], []
            self._pairer = Pairer(self._streams)
            self._deadline = time.monotonic() + TUNING.patience
            self._is_collecting = True
            self._timer.reset()

    def on_field(self, sample: FieldSample) -> None:
        """Take a field sample."""
        if self.antenna.is_heard:
            self.antenna.on_field(sample)
        if not self._is_collecting:
            return
        self._pairer.offer(sample)
        self._pairs += self._pairer.take()
        pairs = self._pairs
        if pairs and pairs[-1].field.stamp - pairs[0].field.stamp >= TUNING.seconds:
            self._fit()

    def on_imu(self, stamp: float) -> None:
        """Go on to an IMU message, of which up knows already, since the last standing."""
        if self.antenna.is_heard:
            self.antenna.on_imu(stamp)
        up, since, follower = self._follower.newest, self._since, self._follower
        if since is None or up is None:
            return
        if not follower.is_propagated:
            # What turned meanwhile nobody knows.
            self._since = None
            return
        since.add(stamp, up, follower.mean_rate, follower.gyro_bias.variance)

    @property
    def complaints(self) -> list[str]:
        """What is wrong with the topic's headings, in words."""
        return self.antenna.complaints

    def facts(self) -> dict[str, Any] | None:
        """Return what `~/status` tells; None where there is no known heading."""
        topic = self.antenna.facts()
        if not self._standings and topic is None and not self._answer:
            return None
        return {
            "collecting": self._is_collecting,
            "headings": [each.in_words for each in self._standings],
            "answer": self._answer,
            "topic": topic,
        }

    def _on_tick(self) -> None:
        if not self._is_collecting:
            self._timer.cancel()
        elif time.monotonic() > self._deadline:
            self._fit()

    def _fit(self) -> None:
        # The timer ends itself: cancelled by another thread it may be on its way already.
        self._is_collecting = False
        settings = self._settled()
        given = self._given or self._given_by_topic(settings)
        view = self._frames.view
        if given is None or view is None:
            self._conclude(Conclusion(False, f"{self.antenna.topic} fell silent meanwhile"))
            return
        follower, forward = self._follower, view.pose[0]
        bias = follower.gyro_bias.rate if follower.is_propagated else (0.0, 0.0, 0.0)
        pairs, since, knowledge = tuple(self._pairs), self._since, settings.knowledge
        before, epoch = self._standings, self._epoch
        in_force = self._magnetometer.keeper.calibration
        self._pairs = []

        def work() -> HeadingResult:
            # What only a fit needs is loaded when one is made, beside the messages.
            from magcal_ros.core.session.at_known_heading import (
                CollectedSamples,
                calibrate_standing,
            )

            collected = CollectedSamples(pairs, given, knowledge, forward, since, bias)
            return self._worker.run(calibrate_standing, before, collected, in_force)

        self._fits.run(work, lambda result: self._note(result, epoch), self._lost)

    def _given_by_topic(self, settings: Settings) -> ExternalHeading | None:
        """Return the mean of the topic's headings while the robot stood."""
        heard, self.antenna.collected = self.antenna.collected, None
        if not heard:
            return None
        east = sum(math.cos(each.yaw) for each in heard)
        north = sum(math.sin(each.yaw) for each in heard)
        # What is wrong in one message of a receiver is wrong in the next, too.
        sigma = max(each.sigma for each in heard)
        return ExternalHeading(math.atan2(north, east), sigma, settings.heading_is_true)

    def _lost(self, error: Exception) -> None:
        words = "the node ends" if isinstance(error, Stopped) else in_words(error)
        self._conclude(Conclusion(False, f"nothing was found: {words}"))

    def _note(self, result: HeadingResult, epoch: int) -> None:
        self._worker.stop()
        if epoch != self._epoch:
            words = "~/reset was called, or another sensor met, meanwhile: call again"
            self._conclude(Conclusion(False, words))
            return
        calibration = result.outcome.calibration
        if calibration is not None:
            self._standings, self._since = result.standings, TurnSince()
        if not result.applies or calibration is None:
            # A heading that agrees with a better calibration is no failure.
            self._conclude(Conclusion(result.outcome.verdict.accepted, result.words))
            return
        self._magnetometer.use(
            calibration,
            lambda done: self._conclude(Conclusion(done.success, f"{result.words} {done.message}")),
        )

    def _conclude(self, conclusion: Conclusion) -> None:
        tell, self._tell = self._tell, None
        self._given, self._answer = None, conclusion.message
        if tell is not None:
            tell(conclusion)
