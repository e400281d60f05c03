"""Straight stretches of road: the yaw of the compass against the course."""

from __future__ import annotations

import cmath
import math
from collections import deque
from typing import NamedTuple

from magcal_ros.core.driving.course_tuning import ChordTuning
from magcal_ros.core.driving.gyro_frame import Tick
from magcal_ros.core.samples.streams import PositionSample, VelocitySample


class Chord(NamedTuple):
    """A straight piece of way."""

    stamp: float
    """Its end, on the clock of the fixes, seconds."""
    east: float
    north: float
    """Its middle, metres."""
    course: float
    """ENU, radians, where the vehicle went."""
    gap: float
    """Yaw of the compass less course, radians, unwrapped by nobody."""
    gyro_gap: float
    """The same of the gyro's yaw, whose zero is anywhere."""
    sigma: float
    """Of the course, radians."""
    metres: float
    """Its length."""

    @property
    def backwards(self) -> Chord:
        """The same for a vehicle that backed up."""
        course = math.remainder(self.course + math.pi, math.tau)
        return self._replace(
            course=course,
            gap=math.remainder(self.gap - math.pi, math.tau),
            gyro_gap=math.remainder(self.gyro_gap - math.pi, math.tau),
        )


class _Looked(NamedTuple):
    """Where the vehicle looked in a tick: yaws at its end, as unit complex numbers."""

    begin: float
    end: float
    gyro: complex
    compass: complex
    turn_rate: float


class Chords:
    """Makes chords of fixes and yaws.

    Attributes
    ----------
    delay : float
        Seconds by which the receiver's stamps are late.
    """

    def __init__(self, tuning: ChordTuning | None = None, delay: float = 0.5) -> None:
        self._tuning = tuning or ChordTuning()
        self.delay = delay
        self._looked: deque[_Looked] = deque(maxlen=self._tuning.remembered)
        self._sum, self._count = 0.0 + 0.0j, 0
        self._anchor: PositionSample | None = None
        self._waiting: deque[PositionSample | VelocitySample] = deque(maxlen=64)
        self._place = (0.0, 0.0)
        self._velocity: VelocitySample | None = None
        self._placed_at = -math.inf

    def add_yaw(self, yaw: float) -> None:
        """Take a yaw of the compass, radians, of the tick under way."""
        self._sum += cmath.exp(1j * yaw)
        self._count += 1

    def add_tick(self, tick: Tick) -> list[Chord]:
        """Take the end of a tick; returns the chords that can be made now."""
        compass = self._sum / self._count if self._count else 0.0
        gyro = cmath.exp(1j * tick.yaw)
        begin = tick.stamp - tick.seconds
        self._looked.append(_Looked(begin, tick.stamp, gyro, compass, tick.turn_rate))
        self._sum, self._count = 0.0 + 0.0j, 0
        made: list[Chord] = []
        while self._waiting and self._waiting[0].stamp - self.delay <= tick.stamp:
            fix = self._waiting.popleft()
            isfix = isinstance(fix, PositionSample)
            chord = self._by_position(fix) if isinstance(fix, PositionSample) else None
            chord = chord if isfix else self._by_velocity(fix)  # type: ignore[arg-type]
            if chord is not None:
                made.append(chord)
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
        tuning = self._tuning
        self._place, self._placed_at = (fix.east, fix.north), fix.stamp
        if self._has_good_velocity(fix.stamp):
            self._anchor = None
            return None
        start = self._anchor
        if start is None or not 0.0 < fix.stamp - start.stamp <= tuning.longest:
            self._anchor = fix
            return None
        east, north = fix.east - start.east, fix.north - start.north
        metres, seconds = math.hypot(east, north), fix.stamp - start.stamp
        if metres < tuning.shortest:
            return None
        looked = self._straight(start.stamp, fix.stamp)
        if looked is None or metres / seconds < tuning.slowest:
            self._anchor = fix
            return None
        # The next chord begins with another fix: an error of this one shows once.
        self._anchor = None
        middle = (0.5 * (fix.east + start.east), 0.5 * (fix.north + start.north))
        sigma = math.sqrt(2.0) * tuning.relative_sigma / metres
        return self._chord(fix.stamp, middle, math.atan2(north, east), looked, sigma, metres)

    def _by_velocity(self, fix: VelocitySample) -> Chord | None:
        tuning, before, self._velocity = self._tuning, self._velocity, fix
        speed = math.hypot(fix.east, fix.north)
        seconds = math.inf if before is None else fix.stamp - before.stamp
        if not 0.0 < seconds <= tuning.longest:
            return None
        if fix.stamp - self._placed_at > tuning.longest:
            x, y = self._place
            self._place = (x + fix.east * seconds, y + fix.north * seconds)
        is_good = fix.sigma <= tuning.good_velocity
        if speed < (tuning.slowest_velocity if is_good else tuning.slowest):
            return None
        looked = self._straight(fix.stamp - 0.5, fix.stamp + 0.1)
        if looked is None:
            return None
        course = math.atan2(fix.north, fix.east)
        return self._chord(
            fix.stamp, self._place, course, looked, fix.sigma / speed, speed * seconds
        )

    def _has_good_velocity(self, stamp: float) -> bool:
        return self._velocity is not None and abs(stamp - self._velocity.stamp) < 2.0

    def _chord(
        self,
        stamp: float,
        place: tuple[float, float],
        course: float,
        looked: tuple[float, float],
        sigma: float,
        metres: float,
    ) -> Chord:
        compass, gyro = looked
        return Chord(
            stamp,
            *place,
            course,
            math.remainder(compass - course, math.tau),
            math.remainder(gyro - course, math.tau),
            math.hypot(sigma, self._tuning.course_sigma),
            metres,
        )

    def _straight(self, begin: float, end: float) -> tuple[float, float] | None:
        """Return the mean yaws of compass and gyro between two stamps of fixes.

        None unless the vehicle went straight on, with a compass, all the time.
        """
        begin, end = begin - self.delay, end - self.delay
        among = [each for each in self._looked if each.end > begin and each.begin < end]
        if not among or among[0].begin > begin + 0.3 or among[-1].end < end - 0.3:
            return None
        if any(abs(each.turn_rate) > self._tuning.largest_rate for each in among):
            return None
        if not all(each.compass for each in among):
            return None
        turned = abs(cmath.phase(among[-1].gyro / among[0].gyro))
        if turned > self._tuning.largest_turn:
            return None
        compass = sum(each.compass / abs(each.compass) for each in among)
        gyro = sum(each.gyro for each in among)
        return cmath.phase(compass), cmath.phase(gyro)
