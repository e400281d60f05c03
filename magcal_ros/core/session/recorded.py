"""Calibration from a recording, with the same streams, pairs, session and verdict as live."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from typing import TypeAlias

import numpy as np

from magcal_ros.core.calibrate import (
    DRIVES,
    METHODS,
    Outcome,
    calibrate,
    calibrate_drive,
    calibrate_turns,
)
from magcal_ros.core.calibration.calibration import Calibration
from magcal_ros.core.doctor.sensor_report import refusal_by_sensors
from magcal_ros.core.driving.travel_estimator import TravelReplay
from magcal_ros.core.errors import Reason, Refusal
from magcal_ros.core.heading.compass import Compass, CompassReader
from magcal_ros.core.knowledge import Knowledge, Mounting, ReferenceField
from magcal_ros.core.multi_turn.result import TurnResult
from magcal_ros.core.samples.battery import Messages, newest_at
from magcal_ros.core.samples.drive_log import DriveRecorder
from magcal_ros.core.samples.samples_tuning import STREAMS
from magcal_ros.core.samples.streams import (
    DropReason,
    FieldSample,
    HeadingSample,
    ImuSample,
    Pair,
    Pairer,
    SpeedSample,
    Streams,
    TravelSample,
)
from magcal_ros.core.samples.units import InputCounts, complaints, slow_field_words
from magcal_ros.core.samples.window import Window
from magcal_ros.core.session.at_known_heading import (
    CollectedSamples,
    HeadingCollector,
    HeadingResult,
    calibrate_at_known_heading,
    fit_log,
)
from magcal_ros.core.session.external_heading import ExternalHeading
from magcal_ros.core.session.session import Limits, Progress, Session

Reading: TypeAlias = ImuSample | FieldSample | None
"""One sample; None is an Imu message that marks its acceleration as absent."""


LONGEST_DRIVE = 7200.0  # seconds of movement that are kept, the newest ones of a longer drive
LONGER = 20  # buffer of a recording in multiples of that of a turn: two hours at 50 Hz

LITTLE_DATA = (Reason.TOO_FEW_SAMPLES, Reason.NO_MOTION, Reason.ARC_TOO_SHORT)
"""Refusals that a longer recording could avoid."""
IN_PARTS = (
    "the time was set back, or ahead by more than an hour: of a turn, only the part with the "
    "largest arc is used"
)
NEVER_TOGETHER = "their stamps have no time in common: `magcal doctor` shows how far apart they are"


class SampleCollector:
    """Collects a whole recording in one session, which does not end automatically.

    Memory is bounded, because the session thins its samples. The topics are the names that messages
    use.
    """

    def __init__(
        self, mounting: Mounting, imu_topic: str = "the IMU", field_topic: str = "the field"
    ) -> None:
        self.mounting = mounting
        self.streams = Streams(STREAMS.max_gap)
        self._session = Session(Limits(), mounting, 0.0, longer=LONGER)
        self._best: Session | None = None  # the part with the largest arc, after a jump of time
        self._pairer = Pairer(self.streams)
        self._topics = (imu_topic, field_topic)
        self.received = [0, 0]
        """Number of messages of IMU and field."""
        self._drive = DriveRecorder(LONGEST_DRIVE)
        self._replay = TravelReplay(())
        self._currents: Messages = ()

    def take(
        self,
        readings: Iterable[Reading],
        travel: Sequence[TravelSample] = (),
        currents: Messages = (),
    ) -> None:
        """Take all readings in the order of recording, and travel in the order of stamps.

        `currents` are the battery's stamps (s) and currents (A), in the order of stamps.
        """
        streams, self._currents = self.streams, currents
        self._session.note_currents(*currents)
        if travel:
            self._replay = TravelReplay(travel)
            readings = self._replay.readings(readings)
        for reading in readings:
            self.received[isinstance(reading, FieldSample)] += 1
            if reading is None:
                streams.imu_drops[DropReason.ABSENT] += 1
            elif isinstance(reading, ImuSample):
                streams.add_imu(reading)
            elif streams.add_field(reading) and not streams.is_repeated:
                self._pairer.offer(reading)
                self._collect()
        self._collect()
        self._choose()

    @property
    def has_samples(self) -> bool:
        """Whether there is a pair of field and acceleration samples."""
        return self._session.has_samples

    def drive(self) -> Window:
        """Return the samples of the drive; empty without a gyro or if the field is too slow."""
        return DriveRecorder(LONGEST_DRIVE).log() if self.slow_field else self._drive.log()

    @property
    def slow_field(self) -> str:
        """Why the rate of the field is too low for a drive; empty if it is not."""
        gaps = np.diff(self._drive.log().time)
        words = slow_field_words(float(np.median(gaps))) if len(gaps) else ""
        return f"{self._topics[1]}: {words}" if words else ""

    def complaints(self) -> list[str]:
        """Return the faults of the messages in words."""
        drops = (self.streams.imu_drops, self.streams.field_drops)
        imu, field = map(InputCounts, self._topics, self.received, drops)
        found = complaints(self.streams, imu, field)
        return [f"{self._topics[1]}: {IN_PARTS}", *found] if self._best else found

    def progress(self) -> Progress:
        """Return how much of a turn was measured."""
        return self._session.progress(0.0)

    def window(self, reference: ReferenceField = ReferenceField()) -> Window:
        """Return the samples of the turn; raises Refusal if the turn is too short.

        The refusal names a fault of the sensors, if one is found by means of the reference field.
        """
        if not self._session.has_samples:
            words = "no pair of field and acceleration samples could be made"
            silent = [topic for topic, n in zip(self._topics, self.received, strict=True) if not n]
            lost = f"no message of {' and '.join(silent)} could be used in the span that was read"
            why = self.complaints() or [lost if silent else NEVER_TOGETHER]
            raise Refusal(Reason.TOO_FEW_SAMPLES, "; ".join([words, *why]))
        window = self._session.window()
        try:
            self.progress().require_arc(self._session.limits.smallest_arc)
        except Refusal as refusal:
            known = Knowledge(reference, self.mounting)
            raise refusal_by_sensors(refusal, window, known) from refusal
        return window

    def _collect(self) -> None:
        for pair in self._pairer.take():
            if self._session.jump(pair.field.stamp):
                self._choose()
                self._best = self._session
                self._session = Session(Limits(), self.mounting, 0.0, longer=LONGER)
                self._session.note_currents(*self._currents)
            estimator = self._replay.estimator
            self._session.add(pair, 0.0, estimator.wheel_speed(pair.field.stamp))
            if math.isfinite(sum(pair.imu.rate)):
                self._drive.add(pair, estimator.speed_near(pair.field.stamp))

    def _choose(self) -> None:
        """Go on with the part with the largest arc, if the time was set and there are two."""
        if self._best is not None:
            both = self._best, self._session
            self._session = max(both, key=lambda session: session.progress(0.0).coverage.arc)


def fit_collected(
    collector: SampleCollector,
    knowledge: Knowledge,
    method: str = METHODS[0],
    progress: Callable[[float], object] | None = None,
) -> Outcome:
    """Calibrate from a recording; bad data are a refused outcome, perhaps without a window.

    A slow fit calls `progress` with the fraction of the work that is done.
    """
    log = collector.drive()
    if method == DRIVES:
        return calibrate_drive(log, knowledge)
    is_default = method == METHODS[0]
    # Unlike a window, the log has the positions of the rests along the drive.
    drive = calibrate_drive(log, knowledge) if is_default and log.rolls else None
    if drive and drive.verdict.accepted:
        return drive
    window = _window_or_refusal(collector, knowledge)
    if isinstance(window, Window):
        outcome = calibrate(window, knowledge, method, progress)
        verdict, slow = outcome.verdict, collector.slow_field
        if slow and not verdict.accepted and outcome.reason is not Reason.TOO_SLOW:
            return outcome.saying(f"{verdict.summary} {slow}.")
        return outcome
    if drive is None and is_default:
        drive = calibrate_drive(log, knowledge)
    return drive if drive and drive.verdict.accepted else Outcome.refused(window)


def fault_of_drive(collector: SampleCollector, knowledge: Knowledge) -> str:
    """Return the likely fault of the sensors in a drive without a result; empty if none is found.

    Raises `Refusal` with the reason if there is no pair of field and acceleration samples.
    """
    newest, log = collector.streams.newest_imu, collector.drive()
    has_gyro = newest is not None and math.isfinite(newest.rate[0])
    if has_gyro and not collector.has_samples:
        # Raises the refusal, because there are no samples.
        collector.window(knowledge.reference)
    if not len(log):
        return ""
    nothing = Refusal(Reason.TOO_FEW_SAMPLES, "")
    return str(refusal_by_sensors(nothing, log, knowledge)).rstrip(".")


def fit_several(
    collectors: Sequence[SampleCollector],
    names: Sequence[str],
    knowledge: Knowledge,
    method: str = METHODS[0],
) -> tuple[Outcome, int]:
    """Join the turns of several recordings into one calibration.

    Returns the outcome, and the index of the recording that its window is from. A recording without
    a turn is left out, with the reason. Raises UsageError if the method cannot join turns.
    """
    looked = [_window_or_refusal(collector, knowledge) for collector in collectors]
    windows = {k: found for k, found in enumerate(looked) if isinstance(found, Window)}
    left_out = {k: found for k, found in enumerate(looked) if isinstance(found, Refusal)}
    if not windows:
        return Outcome.refused(left_out[len(collectors) - 1]), len(collectors) - 1
    used, turns = list(windows), list(windows.values())
    outcome = calibrate_turns(turns, knowledge, method, [names[index] for index in used])
    if outcome.multi_turn is None:
        return outcome, used[-1]
    newest = used[outcome.multi_turn.newest]
    results = dict(zip(used, outcome.multi_turn.turns, strict=True))
    results |= {k: TurnResult(names[k], str(why).rstrip(".")) for k, why in left_out.items()}
    ordered = tuple(results[index] for index in sorted(results))
    return replace(outcome, multi_turn=replace(outcome.multi_turn, turns=ordered)), newest


def _window_or_refusal(collector: SampleCollector, knowledge: Knowledge) -> Window | Refusal:
    try:
        return collector.window(knowledge.reference)
    except Refusal as refusal:
        return refusal


def without_motors(
    readings: Iterable[Reading],
    calibration: Calibration,
    travel: Iterable[TravelSample],
    currents: Messages,
) -> Iterator[Reading]:
    """Yield the readings with the field of the motors subtracted from the raw field.

    Wheel speeds in `travel` and battery `currents` (stamp in s, A) are in the order of stamps.
    """
    if calibration.motors is None:
        yield from readings
        return
    compass, replay = Compass(calibration), TravelReplay(())
    speeds = [(each.stamp, each.speed) for each in travel if isinstance(each, SpeedSample)]
    reader = CompassReader(
        replay.up, lambda stamp: (newest_at(speeds, stamp), newest_at(currents, stamp))
    )
    for reading in replay.readings(readings):
        if isinstance(reading, FieldSample):
            field = reader.read(compass, reading).measured
            x, y, z = calibration.correction.undo(np.array(field)).tolist()
            yield FieldSample(reading.stamp, (x, y, z))
        else:
            yield reading


FORWARD = np.array([1.0, 0.0, 0.0])  # direction to which the headings refer: the IMU's x axis


def pairs_at_rest(readings: Iterable[Reading]) -> tuple[Pair, ...]:
    """Return the field samples of a recording, each with the IMU sample at its stamp."""
    streams = Streams(STREAMS.max_gap)
    pairer, found = Pairer(streams), list[Pair]()
    for reading in TravelReplay((), streams).readings(readings):
        if isinstance(reading, FieldSample):
            pairer.offer(reading)
        found += pairer.take()
    return tuple(found)


def fit_at_headings(
    recordings: Sequence[tuple[Pair, ...]], given: Sequence[ExternalHeading], knowledge: Knowledge
) -> Outcome:
    """Calibrate from recordings of a robot at rest."""
    nothing = Refusal(Reason.TOO_FEW_SAMPLES, "no heading was given")
    result = HeadingResult((), Outcome.refused(nothing))
    for pairs, heading in zip(recordings, given, strict=True):
        collected = CollectedSamples(pairs, heading, knowledge, FORWARD)
        result = calibrate_at_known_heading(result.measurements, collected)
        if result.outcome.calibration is None:
            break
    return result.outcome


def fit_heading_topic(
    readings: Iterable[Reading],
    headings: Sequence[HeadingSample],
    is_true: bool,
    knowledge: Knowledge,
) -> Outcome:
    """Calibrate from a recording in which another device measures the heading."""
    reference = knowledge.reference
    if reference.to_magnetic(is_true) is None:
        words = (
            "the headings refer to true north, and the declination is not known: give latitude "
            "and longitude"
        )
        return Outcome.refused(Refusal(Reason.NO_SOLUTION, words))
    replay, waiting = TravelReplay(()), iter(headings)
    collector, following = HeadingCollector(replay.up), next(waiting, None)
    for reading in replay.readings(readings):
        if isinstance(reading, ImuSample):
            collector.on_imu(reading.stamp)
        elif isinstance(reading, FieldSample):
            while following is not None and following.stamp <= reading.stamp:
                collector.on_heading(following)
                following = next(waiting, None)
            collector.on_field(reading, FORWARD, is_true, reference, STREAMS.max_gap)
        if collector.check.fault:
            refusal = Refusal(Reason.HEADING_CONTRADICTED, collector.check.fault)
            return Outcome.refused(refusal)
    if not collector.measurements:
        words = "no field sample with a gyro came within half a second of a heading"
        return Outcome.refused(Refusal(Reason.TOO_FEW_SAMPLES, words))
    outcome, north = fit_log(collector.measurements, knowledge)
    return outcome.saying(f"{outcome.verdict.summary} But {north}.") if north else outcome
