"""A moving vehicle, live or replayed: compares IMU, speed, fixes and compass with one another."""

from __future__ import annotations

import cmath
import heapq
import math
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from typing import Any

from magcal_ros.core.driving.chords import Chord, Chords, CourseOffset, fit_course_offset, is_hull
from magcal_ros.core.driving.driving_tuning import (
    ACCELERATION,
    COURSE,
    MOUNTING,
    SPEED,
    SpeedSource,
)
from magcal_ros.core.driving.gyro_frame import GyroFrame, Tick
from magcal_ros.core.driving.mounting_yaw import MountingYaw, MountingYawEstimator
from magcal_ros.core.driving.speed import Speedometer
from magcal_ros.core.driving.vehicle_acceleration import VehicleAcceleration
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
from magcal_ros.core.up.propagation import LinearAcceleration

Run = Callable[[Callable[[], Any], Callable[[Any], None]], None]
PENDING = 64  # chords that may wait for the direction of travel


class TravelEstimator:
    """Follows a drive with bounded memory; without speed and fixes it does nothing.

    `run` calls a function of some tens of milliseconds, and another one with its result, by default
    at once; a node uses another thread. `course` is the newest fit of compass against course, for
    the yaw to *magnetic* north; None before a fit. `has_samples` is whether any speed or fix
    has come.
    """

    def __init__(self, run: Run = lambda work, then: then(work())) -> None:
        self._run, self._is_running = run, False
        self.speedometer = Speedometer()
        self.mounting = MountingYawEstimator(self.speedometer)
        self.chords: deque[Chord] = deque(maxlen=COURSE.most)
        self.course: CourseOffset | None = None
        self.metres = 0.0
        self._ahead = 0.0  # metres forwards minus metres backwards, while no source shows the sign
        self.acceleration = VehicleAcceleration()
        self._frame = GyroFrame()
        self._paths = Chords()
        self._pending: deque[Chord] = deque(maxlen=PENDING)
        self.has_samples = False
        self._restarts = 0

    @property
    def drifts(self) -> bool:
        """Whether course and heading differ, as a hull's in a current."""
        return len(self.chords) > 1 and is_hull(self.chords)

    @property
    def known_mounting(self) -> MountingYaw | None:
        """The yaw of the IMU in the vehicle; None until the drive determines it."""
        found = self.mounting.found
        # The first trip may be a short one backwards.
        is_forwards = self._ahead > ACCELERATION.backwards
        return found if found is not None and found.is_known and is_forwards else None

    @property
    def source(self) -> SpeedSource | None:
        """The source of the speed in use."""
        track = self.speedometer.track
        return None if track is None else track.source

    def speed_near(self, stamp: float) -> float:
        """Return the newest speed, m/s; NaN without a measurement near a stamp, seconds."""
        track = self.speedometer.track
        return math.nan if track is None else track.last_near(stamp, SPEED.receiver_gap)

    @property
    def has_wheels(self) -> bool:
        """Whether the speed of wheels is frequent enough to time starts and stops."""
        track = self.speedometer.track
        return track is not None and track.is_quick and math.isfinite(track.newest)

    def wheel_speed(self, stamp: float) -> float:
        """Return the speed of wheels, m/s; NaN without a measurement near a stamp, seconds."""
        track = self.speedometer.tracks[SpeedSource.ODOMETRY]
        return track.last_near(stamp, track.gap) if self.has_wheels else math.nan

    def use_mounting_yaw(self, yaw: float, sigma: float) -> None:
        """Use a yaw of the IMU in the vehicle from elsewhere, radians, until a fit is known."""
        if sigma < MOUNTING.usable and self.known_mounting is None:
            self._use_yaw(yaw, sigma, 1.0)
            self._ahead = math.inf

    def add_imu(self, sample: ImuSample, gyro_bias: Triple) -> LinearAcceleration | None:
        """Add an IMU sample; return the vehicle's acceleration, None if it is not known."""
        if not self.has_samples:
            return None
        tick = self._frame.add(sample, gyro_bias)
        if self._frame.restarts != self._restarts:
            self._restarts = self._frame.restarts
            for each in (self.acceleration, self._paths, self.mounting):
                each.restart()
        if tick is not None:
            self._on_tick(tick)
        return self.acceleration.linear(sample.stamp, sample.force, self._frame)

    def wants_speed(self, stamp: float) -> bool:
        """Whether a speed of wheels at a stamp is used; other messages need not be decoded."""
        return self.speedometer.tracks[SpeedSource.ODOMETRY].wants(stamp)

    def add_travel(self, sample: TravelSample) -> None:
        """Add a sample of wheels or receiver."""
        is_usable = self.speedometer.add(sample)
        self.has_samples = is_usable or self.has_samples
        if isinstance(sample, PositionSample) or (is_usable and isinstance(sample, VelocitySample)):
            self._paths.add_fix(sample)

    def add_yaw(self, yaw: float) -> None:
        """Add the yaw of the IMU's x to magnetic north by the compass, radians."""
        if self.has_samples:
            self._paths.add_yaw(yaw)

    def forget_compass(self) -> None:
        """Forget the comparison of compass and course: another calibration is in use."""
        self.chords.clear()
        self.course = None
        self._pending.clear()

    def fit_course(self) -> CourseOffset | None:
        """Fit the offset of the compass against course to the whole drive."""
        self.course = fit_course_offset(self.chords)
        return self.course

    def give_up_fit(self) -> None:
        """Forget a failed fit, so that the next one may start."""
        self._is_running = False

    def _on_tick(self, tick: Tick) -> None:
        track = self.speedometer.track
        is_due = False
        for met, speed in self.acceleration.add(tick, track):
            is_due = self.mounting.add(met, speed) or is_due
            if track is not None and math.isfinite(speed):
                self.metres += abs(speed) * met.seconds
                self._ahead += math.inf if track.is_signed else speed * met.seconds
        if is_due and not self._is_running:
            self._fit(tick.stamp)
        for receiver in (SpeedSource.FIXES, SpeedSource.VELOCITY):
            if math.isfinite(self.speedometer.tracks[receiver].newest):
                self._paths.delay = self.speedometer.tracks[receiver].delay
        self._pending.extend(self._paths.add_tick(tick))
        self._settle()

    def _fit(self, stamp: float) -> None:
        """Start the fits of the mounting yaw and of the course."""
        if self._ahead < 0.0:
            # A vehicle goes backwards for the smaller part of its way.
            self._ahead, self.acceleration.turn = -self._ahead, -self.acceleration.turn
        turn = self.acceleration.turn if self.acceleration.is_yaw_known else None
        checks, chords = self.mounting.begin_fit(stamp, turn), list(self.chords)
        self._is_running = True

        def then(found: tuple[Any, CourseOffset | None]) -> None:
            self._is_running = False
            self.mounting.take(found[0])
            self.course = found[1]
            mounting = self.mounting.found
            if mounting is not None and mounting.is_known:
                error = math.hypot(mounting.sigma, mounting.scale - 1.0)
                self._use_yaw(mounting.yaw, error, min(1.0, mounting.scale))
                self.acceleration.noise = mounting.noise
                self.acceleration.density = mounting.density

        self._run(lambda: (checks(), fit_course_offset(chords)), then)

    def _use_yaw(self, yaw: float, error: float, scale: float) -> None:
        self.acceleration.turn = cmath.rect(scale, -yaw)
        self.acceleration.error, self.acceleration.is_yaw_known = error, True

    def _settle(self) -> None:
        """Use chords once it is known whether the vehicle drove forwards."""
        track = self.speedometer.track
        while self._pending:
            moment = self._pending[0].stamp - self._paths.delay
            trip = self.acceleration.trip_at(moment)
            sign = trip.sign
            if track is not None and track.is_signed:
                speed = track.at(moment)
                sign = speed if abs(speed) > 0.0 else sign
            elif self.acceleration.is_open(trip) and len(self._pending) < PENDING:
                return
            chord = self._pending.popleft()
            self.chords.append(chord if sign > 0.0 else chord.backwards)


class TravelReplay:
    """Merges travel samples into a recording's readings, and follows up and speed along it."""

    def __init__(self, travel: Iterable[TravelSample], streams: Streams | None = None) -> None:
        self._travel, self._streams = list(travel), streams
        self.estimator, self.up = TravelEstimator(), UpFollower()

    def readings(
        self, readings: Iterable[ImuSample | FieldSample | None]
    ) -> Iterator[ImuSample | FieldSample | None]:
        """Yield the readings in their order; the attributes belong to the newest one."""
        newest = -math.inf

        def stamp_of(reading: ImuSample | FieldSample | TravelSample | None) -> float:
            # A reading without numbers keeps its place.
            return newest if reading is None else reading.stamp

        for reading in heapq.merge(readings, self._travel, key=stamp_of):
            if isinstance(reading, ImuSample):
                newest = reading.stamp
                if self._streams is not None and not self._streams.add_imu(reading):
                    continue
                acceleration = self.estimator.add_imu(reading, self.up.gyro_bias.rate)
                self.up.add(reading, acceleration)
            elif isinstance(reading, FieldSample):
                if self._streams is not None and not self._streams.add_field(reading):
                    continue
                self.up.add_field(reading.stamp, reading.field)
            elif reading is not None:
                self.estimator.add_travel(reading)
                continue
            yield reading
