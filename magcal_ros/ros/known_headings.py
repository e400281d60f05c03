"""Known headings: given by the user for a robot at rest, or by a device such as two antennas."""

from __future__ import annotations

import math
import time
from typing import TYPE_CHECKING, Any

from sensor_msgs.msg import Imu

from magcal_ros.core.errors import Reason, in_words
from magcal_ros.core.heading.heading_tuning import FUSION
from magcal_ros.core.samples.streams import FieldSample, HeadingSample, Pair, Pairer
from magcal_ros.core.self_calibration.jobs import Mode
from magcal_ros.core.session import external_heading
from magcal_ros.core.session.external_heading import (
    VALID_FOR,
    ExternalHeading,
    GyroTurn,
    wrong_clock,
)
from magcal_ros.core.session.session_tuning import KNOWN, SESSION
from magcal_ros.core.session.turn_machine import Conclusion, TurnState
from magcal_ros.ros.calibration_store import Tell
from magcal_ros.ros.magnetometer import Magnetometer
from magcal_ros.ros.magnetometers import Magnetometers
from magcal_ros.ros.parameters import Settings
from magcal_ros.ros.wire import Unreadable, read_heading
from magcal_ros.ros.worker_process import WorkerProcess

if TYPE_CHECKING:
    from magcal_ros.core.calibrate import Outcome
    from magcal_ros.core.session.at_known_heading import HeadingCollector, HeadingResult
    from magcal_ros.core.smoother.headings import KnownHeadingMeasurement

TOPIC = "heading"
REPORTED_MISSES = 10  # successive disagreements with the fused yaw from which there is a warning
NO_DECLINATION = (
    "the heading refers to true north, and the declination here is not known: give "
    "reference.latitude_deg and longitude_deg, or wait for gps/fix"
)


class HeadingTopic:
    """Uses the topic `heading` for the fused yaw and for calibration in a drive."""

    def __init__(self, magnetometer: Magnetometer, worker: WorkerProcess) -> None:
        pipeline = self._pipeline = magnetometer.pipeline
        self._magnetometer, self._worker, node = magnetometer, worker, pipeline.node
        self._say = node.get_logger().info
        self.topic = node.resolve_topic_name(TOPIC)
        self.is_received = False
        self.collected: list[HeadingSample] | None = None  # headings during a collection
        self._received_at = -math.inf
        self._collector: HeadingCollector | None = None
        self._missed, self._gap = 0, 0.0
        self._fault = self._answer = self._doubt = ""
        pipeline.sensor_group.subscribe(node, Imu, TOPIC, self._on_heading)

    def forget(self) -> None:
        """Discard the collected headings and all findings."""
        if self._collector is not None:
            self._collector.forget()
        self._answer, self._doubt, self._missed = "", "", 0

    @property
    def silence(self) -> str:
        """The topic, and why it has no current heading; empty if it has one."""
        if time.monotonic() - self._received_at < VALID_FOR:
            return ""
        if self._fault:
            return f"{self.topic} (there are messages, but {self._fault})"
        return f"{self.topic}{' (its last heading is too old)' * bool(self._collector)}"

    @property
    def complaints(self) -> list[str]:
        """The faults of the headings, in words."""
        words = [self._fault]
        if self.is_received and self._collector is not None:
            words += [self._collector.check.fault, self._doubt]
        if self.is_received and self._missed >= REPORTED_MISSES:
            words.append(
                f"the heading differs from the fused yaw by {math.degrees(self._gap):.0f}°, far "
                "more than both variances allow, and is not used. Check which north it refers to "
                "(known_heading.topic_north), that zero is east, and that the yaw of the antennas "
                "in the vehicle is included. If the heading is right, the calibration is out of "
                "date: call ~/reset"
            )
        return [f"{self.topic}: {each}" for each in words if each]

    def facts(self) -> dict[str, Any] | None:
        """Return the part of `~/status` on the topic; None before the first heading."""
        if self._collector is None:
            return None
        facts: dict[str, Any] = {"topic": self.topic, "speaks": self.is_received}
        return {**facts, "kept": sum(map(len, self._collector.kept)), "found": self._answer}

    def on_imu(self, stamp: float) -> None:
        """Integrate the gyro up to an IMU message that the up follower has received already."""
        if self._collector is not None:
            self._collector.on_imu(stamp)

    def on_field(self, sample: FieldSample) -> None:
        """Take a field sample while headings arrive."""
        collector, view = self._collector, self._pipeline.frames.view
        if collector is None or sample.stamp - collector.newest.stamp > VALID_FOR:
            self.is_received = False
            return
        if view is None:
            return
        settings = self._pipeline.current_settings()
        north = settings.heading_is_true, settings.knowledge.reference
        gap = self._magnetometer.inputs.streams.max_gap
        if collector.on_field(sample, view.pose[0], *north, gap):
            self._fit(settings, collector)

    def _on_heading(self, data: bytes) -> None:
        try:
            sample = read_heading(data)
        except Unreadable as error:
            sample = str(error)
        self._fault = sample if isinstance(sample, str) else self._wrong_clock(sample.stamp)
        if isinstance(sample, str) or self._fault:
            return
        if self._collector is None:
            # Modules that only headings need are imported with the first heading.
            from magcal_ros.core.session.at_known_heading import HeadingCollector

            self._collector = HeadingCollector(self._pipeline.up)
        was_faulty = bool(self._collector.check.fault)
        self._collector.on_heading(sample)
        if self._collector.check.fault and not was_faulty:
            # The headings were wrong before the gyro showed it: nothing that used them is kept.
            self.forget()
            self._pipeline.fused.forget()
        self._received_at, self.is_received = time.monotonic(), True
        if self.collected is not None:
            self.collected.append(sample)
        settings, view = self._pipeline.current_settings(), self._pipeline.frames.view
        shift = settings.knowledge.reference.to_magnetic(settings.heading_is_true)
        self._fault = NO_DECLINATION if shift is None else ""
        yaw = self._pipeline.fused.yaw
        if self._collector.check.fault or shift is None or view is None or yaw is None:
            return
        x, y, z = view.pose[0].tolist()
        missed = yaw.take_heading(sample.stamp, sample.yaw + shift, sample.sigma**2, (x, y, z))
        if missed is not None:
            self._missed = self._missed + 1 if missed > FUSION.heading_gate else 0
            self._gap = yaw.last_heading_gap

    def _wrong_clock(self, stamp: float) -> str:
        """Say by how much a heading's stamp is not that of the IMU; empty if it is."""
        imu = self._magnetometer.inputs.imu
        return wrong_clock(self._pipeline.up.newest_stamp - stamp, imu.topic, imu.age())

    def _fit(self, settings: Settings, collector: HeadingCollector) -> None:
        # Loaded already, by the collector.
        from magcal_ros.core.session.at_known_heading import fit_log

        measurements, kept = collector.measurements, collector.kept
        self._pipeline.fits.run(
            lambda: self._worker.run_once(fit_log, measurements, settings.knowledge),
            lambda found: self._note(*found, kept),
            self._lost,
        )

    def _lost(self, error: Exception) -> None:
        self._answer = f"the fit failed: {error}"

    def _note(self, outcome: Outcome, north: str, kept: object) -> None:
        if self._collector is None or kept is not self._collector.kept:
            return
        self._answer, self._doubt = outcome.verdict.summary, north
        if outcome.reason is Reason.HEADING_CONTRADICTED:
            self._doubt = self._answer
        found, before = outcome.calibration, self._magnetometer.store.calibration
        is_wanted = self._pipeline.settings.self_calibration is not Mode.OFF
        if found is None or not (is_wanted and outcome.verdict.accepted):
            return
        if not external_heading.replaces(found, before):
            return
        self._say(f"{self.topic} calibrates the compass: {self._answer}")
        is_another = before is None or not external_heading.is_by_headings(before)
        self._magnetometer.use(found, lambda done: self._say(done.message), is_another)


NO_HEADING = (
    "no known heading: set known_heading.yaw_deg (ENU: 0 to the east, 90 to the north, positive to "
    "the left) and known_heading.north (true_north or magnetic_north), or publish a "
    "sensor_msgs/Imu with an orientation on "
)
NO_NORTH = (
    "the north of known_heading.yaw_deg is not given: set known_heading.north to true_north "
    "(maps, walls in plans, two antennas) or magnetic_north (a compass)"
)
NO_POSE = (
    "the pose of the IMU in base_frame is not known, so its heading does not give the IMU's: "
    "publish robot_description, or leave base_frame empty and give the IMU's heading"
)


class KnownHeadings:
    """Calibrates a robot at rest at known headings; `antenna` uses the topic."""

    def __init__(self, magnetometer: Magnetometer) -> None:
        self._magnetometer, self._pipeline = magnetometer, magnetometer.pipeline
        self.worker = WorkerProcess()
        """For fits of known headings, which run in the thread of all fits, one at a time."""
        self.antenna = HeadingTopic(magnetometer, self.worker)
        self._measurements: tuple[KnownHeadingMeasurement, ...] = ()
        self._epoch = 0
        self._answer = ""
        self._turn: GyroTurn | None = None
        """The turn by the gyro since the last measurement; None before the first one."""
        self._pairs: list[Pair] = []
        self._pairer = Pairer(magnetometer.inputs.streams)
        self._given: ExternalHeading | None = None
        self._tell: Tell | None = None
        self._deadline = math.inf  # of the collection, by the clock of `monotonic`

    def forget(self) -> None:
        """Discard all known headings."""
        self._measurements, self._turn, self._answer = (), None, ""
        self._epoch += 1
        self.antenna.forget()

    def calibrate(self, turns: Magnetometers, tell: Tell) -> None:
        """Collect samples of the robot at rest, calibrate, and answer with the result."""
        settings = self._pipeline.current_settings()
        refusal = self._why_not(turns, settings)
        if refusal:
            tell(Conclusion(False, refusal))
            return
        self._tell, self._given = tell, settings.known_heading
        self._pairs, self.antenna.collected = [], []
        self._pairer = Pairer(self._magnetometer.inputs.streams)
        self._deadline = time.monotonic() + KNOWN.patience

    def _why_not(self, turns: Magnetometers, settings: Settings) -> str:
        if turns.state is not TurnState.IDLE:
            return "a turn is under way: wait for its verdict first"
        if self._tell is not None:
            return "another call is already collecting at a known heading: wait for its answer"
        if settings.north_is_missing:
            return NO_NORTH
        if settings.known_heading is None and self.antenna.silence:
            return f"{NO_HEADING}{self.antenna.silence}"
        return NO_POSE if self._pipeline.frames.view is None else ""

    def on_field(self, sample: FieldSample) -> None:
        """Take a field sample."""
        if self.antenna.is_received:
            self.antenna.on_field(sample)
        if self._deadline == math.inf:
            return
        self._pairer.offer(sample)
        self._pairs += self._pairer.take()
        pairs = self._pairs
        if pairs and pairs[-1].field.stamp - pairs[0].field.stamp >= SESSION.rest:
            self._fit()

    def on_imu(self, stamp: float) -> None:
        """Integrate the gyro up to an IMU message that the up follower has received already."""
        if self.antenna.is_received:
            self.antenna.on_imu(stamp)
        if self._turn is not None:
            self._turn = self._turn.followed(stamp, self._pipeline.up)

    def facts(self) -> dict[str, Any] | None:
        """Return the part of `~/status` on known headings; None if there are none."""
        topic = self.antenna.facts()
        if not self._measurements and topic is None and not self._answer:
            return None
        return {
            "collecting": self._deadline < math.inf,
            "headings": [each.in_words for each in self._measurements],
            "answer": self._answer,
            "topic": topic,
        }

    def look(self) -> None:
        """Fit the samples so far if the time is over; to be called about once a second."""
        if time.monotonic() > self._deadline:
            self._fit()

    def _fit(self) -> None:
        self._deadline = math.inf
        settings, follower = self._pipeline.current_settings(), self._pipeline.up
        headings, self.antenna.collected = self.antenna.collected or [], None
        given = self._given or external_heading.mean_heading(headings, settings.heading_is_true)
        view = self._pipeline.frames.view
        if given is None or view is None:
            self._conclude(False, f"the headings on {self.antenna.topic} stopped during the call")
            return
        bias = follower.gyro_bias.rate if follower.is_propagated else (0.0, 0.0, 0.0)
        turn = self._turn or GyroTurn()
        known = given, settings.knowledge, view.pose[0], turn, bias
        pairs, self._pairs = tuple(self._pairs), []
        before, epoch = self._measurements, self._epoch
        in_force = self._magnetometer.store.calibration

        def work() -> HeadingResult:
            # Modules that only a fit needs are imported here, in the background thread.
            from magcal_ros.core.session.at_known_heading import (
                CollectedSamples,
                calibrate_at_known_heading,
            )

            collected = CollectedSamples(pairs, *known)
            return self.worker.run_once(calibrate_at_known_heading, before, collected, in_force)

        self._pipeline.fits.run(work, lambda result: self._note(result, epoch), self._lost)

    def _lost(self, error: Exception) -> None:
        self._conclude(False, f"the fit failed: {in_words(error)}")

    def _note(self, result: HeadingResult, epoch: int) -> None:
        if epoch != self._epoch:
            words = "~/reset was called or the sensor changed: call this service again"
            self._conclude(False, words)
            return
        calibration, verdict = result.outcome.calibration, result.outcome.verdict
        if calibration is not None:
            self._measurements, self._turn = result.measurements, GyroTurn()
        if not result.applies or calibration is None:
            # It is a success if the heading agrees with a better calibration in force.
            self._conclude(verdict.accepted, verdict.summary)
            return
        self._magnetometer.use(
            calibration,
            lambda done: self._conclude(done.success, f"{verdict.summary} {done.message}"),
        )

    def _conclude(self, success: bool, message: str) -> None:
        tell, self._tell = self._tell, None
        self._given, self._answer = None, message
        if tell is not None:
            tell(Conclusion(success, message))
