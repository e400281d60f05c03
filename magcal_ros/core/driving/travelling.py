"""A moving vehicle, live or replayed: compares IMU, speed, fixes and compass with one another."""

from __future__ import annotations

import heapq
import math
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from typing import Any

import numpy as np

from magcal_ros.core.driving.chords import (
    Chord,
    Chords,
    CourseCells,
    CourseOffset,
    GyroFrame,
    Tick,
    fit_course_offset,
)
from magcal_ros.core.driving.driving_tuning import COURSE, MOUNTING, OWN, SpeedSource
from magcal_ros.core.driving.mounting_yaw import Judged, MountingWatch, MountingYaw
from magcal_ros.core.driving.speed import OwnAcceleration, Speedometer
from magcal_ros.core.geometry.vec3 import Triple
from magcal_ros.core.samples.streams import (
    FieldSample,
    ImuSample,
    PositionSample,
    Streams,
    TravelSample,
    VelocitySample,
)
from magcal_ros.core.up.follower import UpFollower
from magcal_ros.core.up.stillness import ZERO


class DriftWatch:
    """Compares course and gyro over a minute of straight driving."""

    def __init__(self) -> None:
        self._seen: deque[Chord] = deque(maxlen=120)
        self.judged = self.drifted = 0

    def add(self, chord: Chord) -> bool:
        """Take a chord; returns whether the vehicle goes where it looks, as far as is known."""
        seen = self._seen
        seen.append(chord)
        while chord.stamp - seen[0].stamp > COURSE.span:
            seen.popleft()
        if len(seen) >= COURSE.chords:
            self.judged += 1
            self.drifted += self._drifts()
        return not self.is_drifting

    def _drifts(self) -> bool:
        """Whether the newest chords are those of a hull that goes where it does not look."""
        time, _, _, courses, compass_gaps, gaps, sigmas, _ = np.array(self._seen).T
        # By how much the gyro leads the compass, and its yaw; radians that go on beyond a turn.
        leads, headings = np.unwrap(gaps - compass_gaps), np.unwrap(gaps + courses)
        gaps, since = np.unwrap(gaps), time - time.mean()
        slope, lead = (float(since @ each / (since @ since)) for each in (gaps, leads))
        # The gyro leads the compass by its bias, and not by what a hull turns.
        least, most = min(lead, 0.0) - COURSE.bias, max(lead, 0.0) + COURSE.bias
        bias = since * min(max(slope, least), most)
        left, turned = gaps - bias, headings - bias
        left -= np.median(left)
        turned -= turned.mean()
        # What the receiver's own noise scatters is no drift.
        square = (1.4826 * float(np.median(np.abs(left)))) ** 2 - float(np.median(sigmas)) ** 2
        if square > COURSE.scatter**2:
            return True
        # A receiver's noise knows nothing of the hull's turns; a course that stays leaves them out.
        by_turns = float(turned @ turned)
        has_turned = by_turns >= len(turned) * COURSE.turned**2
        return has_turned and float(turned @ left) > COURSE.share * by_turns

    @property
    def is_drifting(self) -> bool:
        """Whether the course is not the heading for a good part of the way."""
        return self.drifted > 3 and self.drifted > 0.2 * self.judged

    def restart(self) -> None:
        """Forget the newest chords: the gyro's zero is another one."""
        self._seen.clear()


Run = Callable[[Callable[[], Any], Callable[[Any], None]], None]


def at_once(work: Callable[[], Any], then: Callable[[Any], None]) -> None:
    """Do some work and go on with its result."""
    then(work())


class Travelling:
    """Follows a drive with bounded memory; without speed and fixes it does nothing.

    `run` takes some work and what is to be done with its result; by default it does both at once.
    A node has the work, of some tens of milliseconds, done beside its messages. `course` is the
    newest fit of compass against course, of the yaw to *magnetic* north; None before one.
    `is_heard` is whether any speed or fix has come.
    """

    def __init__(self, run: Run = at_once) -> None:
        self._run, self._is_running = run, False
        self.speedometer = Speedometer()
        self.mounting = MountingWatch(self.speedometer)
        self.cells = CourseCells()
        self.drift = DriftWatch()
        self.course: CourseOffset | None = None
        self.metres = 0.0
        self.own = OwnAcceleration()
        self._frame = GyroFrame()
        self._chords = Chords()
        self._pending: deque[Chord] = deque(maxlen=256)
        self.is_heard = False
        self._given: tuple[float, float] | None = None
        self._restarts = 0

    @property
    def known_mounting(self) -> MountingYaw | None:
        """The yaw of the IMU in the vehicle, where enough was seen to determine it."""
        found = self.mounting.found
        return found if found is not None and found.is_known else None

    @property
    def source(self) -> SpeedSource | None:
        """Whose speed is used."""
        track = self.speedometer.track
        return None if track is None else track.source

    @property
    def speed(self) -> float:
        """The newest speed, m/s; NaN without a source."""
        track = self.speedometer.track
        return math.nan if track is None else track.last

    @property
    def has_wheels(self) -> bool:
        """Whether the speed of wheels comes often enough to time starts and stops by it."""
        track = self.speedometer.track
        if track is None or track.source is not SpeedSource.ODOMETRY:
            return False
        return math.isfinite(track.newest) and not track.is_slow

    def wheel_speed(self, stamp: float) -> float:
        """Return what wheels say, m/s; NaN without a measurement near a stamp, seconds."""
        track = self.speedometer.tracks[SpeedSource.ODOMETRY]
        if abs(stamp + track.delay - track.newest) > track.gap or not self.has_wheels:
            return math.nan
        return track.last

    def believe(self, yaw: float, sigma: float) -> None:
        """Take a yaw of the IMU in the vehicle from elsewhere, radians, until more is seen."""
        self._given = (yaw, sigma)
        self._believe_fit()

    def add_imu(self, sample: ImuSample, gyro_bias: Triple) -> Triple | None:
        """Take an IMU sample; returns the vehicle's own acceleration, m/s², body axes.

        None where it is not known; then nothing is to be taken off.
        """
        if not self.is_heard:
            return None
        tick = self._frame.add(sample, gyro_bias)
        if self._frame.restarts != self._restarts:
            self._restarts = self._frame.restarts
            for each in (self.own, self._chords, self.mounting, self.drift):
                each.restart()
        if tick is not None:
            self._on_tick(tick)
        return self.own.linear(sample.stamp, sample.force, self._frame)

    def wants_speed(self, stamp: float) -> bool:
        """Whether what wheels say at a stamp is of use; a message that is not need not be read."""
        return self.speedometer.tracks[SpeedSource.ODOMETRY].wants(stamp)

    def add_travel(self, sample: TravelSample) -> None:
        """Take whatever wheels and receivers say."""
        is_usable = self.speedometer.add(sample)
        self.is_heard = is_usable or self.is_heard
        if isinstance(sample, PositionSample) or (is_usable and isinstance(sample, VelocitySample)):
            self._chords.add_fix(sample)

    def add_yaw(self, yaw: float) -> None:
        """Take a yaw of the compass to magnetic north, of the IMU's x, radians."""
        if self.is_heard:
            self._chords.add_yaw(yaw)

    def forget_compass(self) -> None:
        """Another calibration is in force: forget the comparison of the last one with course."""
        self.cells = CourseCells()
        self.course = None
        self._pending.clear()

    def fit_course(self) -> CourseOffset | None:
        """Fit the offset of the compass with all that was driven."""
        self.course = self._begin_course()()
        return self.course

    def _begin_course(self) -> Callable[[], CourseOffset | None]:
        """Return the work of fitting the course; up to a tenth of a second with many cells."""
        if self.drift.is_drifting:
            return lambda: None
        table = self.cells.table()
        return lambda: fit_course_offset(table)

    def give_up_fit(self) -> None:
        """Forget a fit that has failed: the next one may be tried."""
        self._is_running = False

    def _on_tick(self, tick: Tick) -> None:
        track = self.speedometer.track
        is_due = False
        for met, speed in self.own.add(tick, track):
            is_due = self.mounting.add(met, speed) or is_due
            if math.isfinite(speed):
                self.metres += abs(speed) * met.seconds
        if is_due and not self._is_running:
            self._fit(tick.stamp)
        for receiver in (SpeedSource.FIXES, SpeedSource.VELOCITY):
            if math.isfinite(self.speedometer.tracks[receiver].newest):
                self._chords.delay = self.speedometer.tracks[receiver].delay
        self._pending.extend(self._chords.add_tick(tick))
        self._settle()

    def _fit(self, stamp: float) -> None:
        """Have the drive fitted, and the course where there is new way."""
        mounting, course = self.mounting.begin_fit(stamp), self._begin_course()
        self._is_running = True

        def work() -> tuple[tuple[Judged, ...], CourseOffset | None]:
            return mounting(), course()

        def then(found: tuple[tuple[Judged, ...], CourseOffset | None]) -> None:
            self._is_running = False
            self.mounting.take(found[0])
            self.course = found[1]
            self._believe_fit()

        self._run(work, then)

    def _believe_fit(self) -> None:
        found, own, given = self.mounting.found, self.own, self._given
        if found is not None and found.is_usable:
            # What is subtracted is tested against the force all the time: a rough yaw does.
            own.yaw, own.noise = found.yaw, found.noise
            own.scale = min(1.0, found.scale)
            own.is_yaw_usable = True
            own.is_yaw_known = found.is_known
        elif given is not None and given[1] < MOUNTING.believed:
            own.yaw, own.is_yaw_usable, own.is_yaw_known = given[0], True, True

    def _settle(self) -> None:
        """Let chords count once it is known whether the vehicle went forwards."""
        track = self.speedometer.track
        while self._pending:
            chord = self._pending[0]
            moment = chord.stamp - self._chords.delay
            sign, is_clear, is_open = self.own.trip_at(moment)
            if track is not None and track.is_signed:
                speed = track.at(moment + track.delay)
                sign = sign if speed is None else math.copysign(1.0, speed)
            elif self.own.is_yaw_known and not is_clear and is_open:
                waits = self._pending[-1].stamp - chord.stamp
                if waits < OWN.longest:
                    return
            self._pending.popleft()
            chord = chord if sign > 0.0 else chord.backwards
            if self.drift.add(chord):
                self.cells.add(chord)


class TravelReplay:
    """Merges travel samples into a recording's readings, and follows up and speed along it.

    `own` is the vehicle's own acceleration at the newest IMU sample, m/s², body axes; zero where it
    is not known.
    """

    def __init__(self, travel: Iterable[TravelSample], streams: Streams | None = None) -> None:
        self._travel, self._streams = list(travel), streams
        self.travelling, self.up = Travelling(), UpFollower()
        self.own: Triple = ZERO

    def readings(
        self, readings: Iterable[ImuSample | FieldSample | None]
    ) -> Iterator[ImuSample | FieldSample | None]:
        """Yield the readings in their order; the attributes belong to the newest one."""
        if not self._travel and self._streams is None:
            yield from readings
            return
        newest = -math.inf

        def stamp_of(reading: ImuSample | FieldSample | TravelSample | None) -> float:
            # A reading without numbers comes where it was recorded.
            return newest if reading is None else reading.stamp

        for reading in heapq.merge(readings, self._travel, key=stamp_of):
            if isinstance(reading, ImuSample):
                newest = reading.stamp
                if self._streams is not None and not self._streams.add_imu(reading):
                    continue
                own = self.travelling.add_imu(reading, self.up.gyro_bias.rate)
                self.up.add(reading, own)
                self.own = own or ZERO
            elif isinstance(reading, FieldSample):
                if self._streams is not None and not self._streams.add_field(reading):
                    continue
                self.up.add_field(reading.stamp, reading.field)
            elif reading is not None:
                self.travelling.add_travel(reading)
                continue
            yield reading
