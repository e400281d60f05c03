"""The gyro's attitude between ticks, and straight stretches: compass yaw against course."""

from __future__ import annotations

import cmath
import math
from collections import deque
from typing import NamedTuple

from magcal_ros.core.driving.driving_tuning import COURSE, OWN, SPEED
from magcal_ros.core.geometry.vec3 import (
    Triple,
    between,
    cross,
    dot,
    length,
    minus,
    plus,
    propagated,
    scaled,
    unit_triple,
)
from magcal_ros.core.samples.streams import STREAMS, ImuSample, PositionSample, VelocitySample

Axes = tuple[Triple, Triple, Triple]


class Tick(NamedTuple):
    """A quarter of a second of the IMU."""

    stamp: float
    seconds: float
    """Its end, and how long it took."""
    force: Triple  # mean specific force in the frame, m/s²
    yaw: float  # of the body's x in the frame at its end, radians
    turn_rate: float  # mean about the frame's up, rad/s

    @property
    def level_force(self) -> complex:
        """The force across up, first and second axis of the frame, m/s²."""
        return complex(self.force[0], self.force[1])


class GyroFrame:
    """Keeps a level frame by the gyro and sums the force in it.

    `axes` are the frame's in body axes; the third is up but for seconds' worth of accelerations.
    `restarts` counts how often the frame began anew, after a gap or a step back in time.
    """

    def __init__(self) -> None:
        self._last: ImuSample | None = None
        self.axes: Axes | None = None
        self.restarts = 0
        self._levelled = self._turned = self._seconds = 0.0
        self._force: Triple = (0.0, 0.0, 0.0)

    def add(self, sample: ImuSample, bias: Triple) -> Tick | None:
        """Take an IMU sample and the gyro's bias (rad/s); returns a tick whenever one is full."""
        stamp, (fx, fy, fz), (p, q, r), _ = sample
        if not 0.0 < fx * fx + fy * fy + fz * fz < math.inf or not math.isfinite(p + q + r):
            return None
        last, self._last = self._last, sample
        seconds = math.inf if last is None else stamp - last.stamp
        if last is None or self.axes is None or not 0.0 < seconds <= STREAMS.longest_gyro_step:
            self._begin(sample.force)
            return None
        turn = scaled(minus(between(last.rate, sample.rate, 0.5), bias), seconds)
        first, second, _ = self.axes
        first, second = propagated(first, turn), propagated(second, turn)
        third = cross(first, second)
        self.axes = (first, second, third)
        force = (dot(first, sample.force), dot(second, sample.force), dot(third, sample.force))
        self._force = plus(self._force, scaled(force, seconds))
        self._turned += dot(third, turn)
        self._seconds += seconds
        return self._end(stamp) if self._seconds >= OWN.seconds - 1e-6 else None

    def to_body(self, vector: Triple) -> Triple:
        """Turn a vector from the frame's axes into body axes."""
        assert self.axes is not None
        first, second, third = (scaled(a, x) for a, x in zip(self.axes, vector, strict=True))
        return plus(plus(first, second), third)

    def _begin(self, force: Triple) -> None:
        self.restarts += 1
        up = unit_triple(force)
        start = (1.0, 0.0, 0.0) if abs(up[0]) < 0.9 else (0.0, 1.0, 0.0)
        second = unit_triple(cross(up, start))
        self.axes = (cross(second, up), second, up)
        self._force = (0.0, 0.0, 0.0)
        self._levelled = self._turned = self._seconds = 0.0

    def _end(self, stamp: float) -> Tick | None:
        assert self.axes is not None
        x, y, z = (value / self._seconds for value in self._force)
        forward = complex(self.axes[0][0], self.axes[1][0])
        seconds, turned = self._seconds, self._turned
        self._force = (0.0, 0.0, 0.0)
        self._turned = self._seconds = 0.0
        self._level((x, y, z), seconds)
        if abs(forward) < OWN.steepest:
            return None
        return Tick(stamp, seconds, (x, y, z), cmath.phase(forward), turned / seconds)

    def _level(self, force: Triple, seconds: float) -> None:
        """Lean the frame towards the force, by little: its up is right in the long run."""
        self._levelled = min(self._levelled + seconds, OWN.levelling)
        size = length(force)
        if size <= 0.0:
            return
        share = seconds / self._levelled / size
        # The frame's up is to turn towards the force: about up x force, in body axes.
        lean = self.to_body((-force[1] * share, force[0] * share, 0.0))
        back = scaled(lean, -1.0)
        assert self.axes is not None
        first, second, _ = (unit_triple(propagated(axis, back)) for axis in self.axes)
        self.axes = (first, second, cross(first, second))


class Chord(NamedTuple):
    """A straight piece of way."""

    stamp: float  # its end, on the clock of the fixes, seconds
    east: float
    north: float
    """Its middle, metres."""
    course: float  # ENU, radians, where the vehicle went
    gap: float  # yaw of the compass less course, radians, not unwrapped
    gyro_gap: float  # the same of the gyro's yaw, whose zero is anywhere
    sigma: float  # of the course, radians
    metres: float  # its length

    @property
    def backwards(self) -> Chord:
        """The same for a vehicle that backed up."""
        angles = self.course, self.gap, self.gyro_gap
        course, gap, gyro_gap = (math.remainder(each + math.pi, math.tau) for each in angles)
        return self._replace(course=course, gap=gap, gyro_gap=gyro_gap)


class Chords:
    """Makes chords of fixes and yaws; the receiver's stamps are late by `delay`, seconds."""

    def __init__(self) -> None:
        self.delay = SPEED.receiver_delay
        self._looked: deque[tuple[Tick, complex]] = deque(maxlen=COURSE.remembered)
        self._sum = 0j
        self._anchor: PositionSample | None = None
        self._waiting: deque[PositionSample | VelocitySample] = deque(maxlen=64)
        self._place = (0.0, 0.0)
        self._velocity: VelocitySample | None = None
        self._placed_at = -math.inf

    def add_yaw(self, yaw: float) -> None:
        """Take a yaw of the compass, radians, of the tick under way."""
        self._sum += cmath.exp(1j * yaw)

    def add_tick(self, tick: Tick) -> list[Chord]:
        """Take the end of a tick; returns the chords that can be made now."""
        self._looked.append((tick, self._sum))
        self._sum = 0j
        made: list[Chord] = []
        while self._waiting and self._waiting[0].stamp - self.delay <= tick.stamp:
            fix = self._waiting.popleft()
            if isinstance(fix, PositionSample):
                chord = self._by_position(fix)
            else:
                chord = self._by_velocity(fix)
            made += [] if chord is None else [chord]
        return made

    def add_fix(self, fix: PositionSample | VelocitySample) -> None:
        """Take a fix or a velocity; what is not finite is left out."""
        if all(math.isfinite(value) for value in fix):
            self._waiting.append(fix)

    def restart(self) -> None:
        """Forget where the vehicle looked: the gyro's frame is another one."""
        self._looked.clear()
        self._waiting.clear()
        self._anchor = self._velocity = None
        self._placed_at = -math.inf

    def _by_position(self, fix: PositionSample) -> Chord | None:
        self._place, self._placed_at = (fix.east, fix.north), fix.stamp
        velocity, start = self._velocity, self._anchor
        if velocity is not None and abs(fix.stamp - velocity.stamp) < 2.0:
            self._anchor = None
            return None
        if start is None or not 0.0 < fix.stamp - start.stamp <= COURSE.longest:
            self._anchor = fix
            return None
        east, north = fix.east - start.east, fix.north - start.north
        metres = math.hypot(east, north)
        if metres < COURSE.shortest:
            return None
        sigma = math.sqrt(2.0) * COURSE.relative_sigma / metres
        middle = (0.5 * (fix.east + start.east), 0.5 * (fix.north + start.north))
        chord = self._chord((start.stamp, fix.stamp), middle, complex(east, north), sigma)
        # The next chord begins with another fix: an error of this one shows once.
        self._anchor = fix if chord is None else None
        return chord

    def _by_velocity(self, fix: VelocitySample) -> Chord | None:
        before, self._velocity = self._velocity, fix
        speed = math.hypot(fix.east, fix.north)
        seconds = math.inf if before is None else fix.stamp - before.stamp
        if not 0.0 < seconds <= COURSE.longest:
            return None
        way = seconds * complex(fix.east, fix.north)
        if fix.stamp - self._placed_at > COURSE.longest:
            x, y = self._place
            self._place = (x + way.real, y + way.imag)
        span = fix.stamp - 0.5, fix.stamp + 0.1
        return self._chord(span, self._place, way, fix.sigma / max(speed, 1e-9))

    def _chord(
        self, span: tuple[float, float], place: tuple[float, float], way: complex, sigma: float
    ) -> Chord | None:
        """Return the chord of a way, metres, if the vehicle went straight on and had a compass."""
        if sigma > COURSE.largest_sigma:
            return None
        begin, end = (stamp - self.delay for stamp in span)
        among = [
            (tick, compass)
            for tick, compass in self._looked
            if tick.stamp > begin and tick.stamp - tick.seconds < end
        ]
        straight = [c and abs(tick.turn_rate) <= COURSE.largest_rate for tick, c in among]
        if not among or not all(straight):
            return None
        (first, _), (last, _) = among[0], among[-1]
        is_whole = first.stamp - first.seconds <= begin + 0.3 and last.stamp >= end - 0.3
        turned = abs(math.remainder(last.yaw - first.yaw, math.tau))
        if not is_whole or turned > COURSE.largest_turn:
            return None
        course = cmath.phase(way)
        compass_yaw = cmath.phase(sum(compass / abs(compass) for _, compass in among))
        gyro_yaw = cmath.phase(sum(cmath.exp(1j * tick.yaw) for tick, _ in among))
        return Chord(
            span[1],
            *place,
            course,
            math.remainder(compass_yaw - course, math.tau),
            math.remainder(gyro_yaw - course, math.tau),
            sigma,
            abs(way),
        )
