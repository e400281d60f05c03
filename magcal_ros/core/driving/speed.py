"""The vehicle's speed from the best source, and its acceleration, with the speed's latency."""

from __future__ import annotations

import cmath
import copy
import math
from collections import deque
from typing import NamedTuple, TypeVar

import numpy as np

from magcal_ros.core.driving.chords import GyroFrame, Tick
from magcal_ros.core.driving.driving_tuning import ACCELERATION, SPEED, SpeedSource
from magcal_ros.core.geometry.arrays import FloatArray
from magcal_ros.core.geometry.vec3 import Triple, minus
from magcal_ros.core.knowledge import CLEAR
from magcal_ros.core.samples.streams import (
    PositionSample,
    SpeedSample,
    StampGuard,
    TravelSample,
    VelocitySample,
    enclosing,
)

Span = TypeVar("Span", float, FloatArray)


def largest_change(seconds: Span) -> Span:
    """Return the largest possible change of a speed over some seconds, m/s."""
    return SPEED.largest_acceleration * seconds + SPEED.step


def is_jump(before: tuple[float, float], after: tuple[float, float]) -> bool:
    """Whether a speed changes by more than a vehicle's can, from (stamp, speed) to another."""
    return abs(after[1] - before[1]) > largest_change(after[0] - before[0])


class SpeedTrack:
    """The recent measurements of one source.

    `delay` is the latency of its stamps, seconds, and `is_signed` is whether backwards is negative.
    `outlier_share` is the fraction of the newest samples with impossible jumps.
    """

    def __init__(self, source: SpeedSource) -> None:
        own = source is SpeedSource.ODOMETRY
        self.source = source
        self.delay = 0.0 if own else SPEED.receiver_delay
        self.is_signed = own
        self._stamps = StampGuard()
        self._doubted: tuple[float, float] | None = None
        self.outlier_share = 0.0
        self._kept: deque[tuple[float, float]] = deque(maxlen=SPEED.remembered)

    @property
    def newest(self) -> float:
        """Stamp of the newest accepted sample, seconds; minus infinity before the first."""
        return self._kept[-1][0] if self._kept else -math.inf

    @property
    def last(self) -> float:
        """The newest speed, m/s; NaN before the first."""
        return self._kept[-1][1] if self._kept else math.nan

    def wants(self, stamp: float) -> bool:
        """Whether a sample at a stamp is used; of a fast source, some are skipped."""
        return not 0.0 < stamp - self.newest < SPEED.shortest

    def add(self, stamp: float, speed: float) -> bool:
        """Add a speed; return whether it was usable."""
        if not self.wants(stamp):
            return True
        if not abs(speed) <= SPEED.largest or self._stamps.check(stamp) is not None:
            return False
        if stamp < self.newest:
            self._kept.clear()
        self._accept((stamp, speed))
        return True

    def _accept(self, sample: tuple[float, float]) -> None:
        """Accept a sample; after a jump only if the next sample confirms it."""
        doubted, self._doubted = self._doubted, None
        is_wild = bool(self._kept) and is_jump(self._kept[-1], sample)
        self.outlier_share += (is_wild - self.outlier_share) / SPEED.counted
        if is_wild and (doubted is None or is_jump(doubted, sample)):
            self._doubted = sample
            return
        self._kept.append(sample)

    @property
    def is_slow(self) -> bool:
        """Whether these are wheels with a message rate as low as a receiver's."""
        if self.source is not SpeedSource.ODOMETRY or len(self._kept) < 4:
            return False
        return self._kept[-1][0] - self._kept[-4][0] > 3.0 * SPEED.seldom

    @property
    def gap(self) -> float:
        """Longest gap that is interpolated, seconds."""
        is_quick = self.source is SpeedSource.ODOMETRY and not self.is_slow
        return 2.0 * SPEED.seldom if is_quick else SPEED.receiver_gap

    def at(self, stamp: float) -> float | None:
        """Return the speed, m/s, at a stamp of the IMU; None unless samples enclose the stamp."""
        stamp += self.delay
        found = enclosing(self._kept, stamp)
        if found is None:
            return None
        sample, later = found
        if later is None:
            return sample[1] if sample[0] == stamp else None
        span = later[0] - sample[0]
        if span > self.gap or is_jump(sample, later):
            return None
        return sample[1] + (later[1] - sample[1]) * (stamp - sample[0]) / span

    def has_passed(self, stamp: float) -> bool:
        """Whether no further sample before a stamp of the IMU can come."""
        return self.newest >= stamp + self.delay

    def along(self, stamps: FloatArray, delay: float | FloatArray) -> FloatArray:
        """Return the speed at stamps (n,) of the IMU for another latency, NaN if unknown.

        For several latencies, shape (d, 1), the result has the shape (d, n).
        """
        moments = stamps + delay
        if len(self._kept) < 2:
            return np.full(moments.shape, math.nan)
        time, speed = np.array(self._kept).T
        after = np.clip(np.searchsorted(time, moments), 1, len(time) - 1)
        span, change = np.diff(time), np.diff(speed)
        broken = (span > self.gap) | (np.abs(change) > largest_change(span))
        found = np.interp(moments, time, speed, left=math.nan, right=math.nan)
        found[broken[after - 1]] = math.nan
        return np.asarray(found)

    def copy(self) -> SpeedTrack:
        """Return a copy of the measurements, for another thread."""
        other = copy.copy(self)
        other._kept = self._kept.copy()
        return other


class Speedometer:
    """The speeds of wheels and receiver."""

    def __init__(self) -> None:
        self.tracks = {source: SpeedTrack(source) for source in SpeedSource}
        self.distrusted: set[SpeedSource] = set()
        self._fix: PositionSample | None = None

    def add(self, sample: TravelSample) -> bool:
        """Add a sample of wheels or receiver; return whether it was usable.

        The speed of a fix is the mean since the previous fix.
        """
        if isinstance(sample, SpeedSample):
            wheels = self.tracks[SpeedSource.ODOMETRY]
            wheels.is_signed = sample.is_signed
            return wheels.add(sample.stamp, sample.speed)
        if isinstance(sample, VelocitySample):
            speed = math.hypot(sample.east, sample.north)
            return self.tracks[SpeedSource.VELOCITY].add(sample.stamp, speed)
        if not math.isfinite(sample.stamp + sample.east + sample.north):
            return False
        before, self._fix = self._fix, sample
        if before is None or not 0.05 < sample.stamp - before.stamp <= SPEED.receiver_gap:
            return False
        span = sample.stamp - before.stamp
        distance = math.hypot(sample.east - before.east, sample.north - before.north)
        return self.tracks[SpeedSource.FIXES].add(
            0.5 * (sample.stamp + before.stamp), distance / span
        )

    @property
    def track(self) -> SpeedTrack | None:
        """The best source that is available and trusted; None without one."""
        newest = max([track.newest for track in self.tracks.values()])
        for source, track in self.tracks.items():
            is_here = newest - track.newest < SPEED.receiver_gap
            if is_here and source not in self.distrusted:
                return track
        return None


class _Trip(NamedTuple):
    """End and direction of a trip, and whether the force has determined the direction."""

    end: float = -math.inf
    sign: float = 1.0
    is_clear: bool = False


class VehicleAcceleration:
    """Subtracts the vehicle's acceleration from the force.

    Over the last half second with a known speed, the mean force minus the change of velocity is
    gravity, in the frame stabilised by the gyro. It is rotated into the present body axes, so that
    a speed with latency or at 1 Hz can be used.

    `yaw` is the yaw of the IMU in the vehicle, radians, zero until it is known. `scale` is the
    force over the change of speed, which noise reduces, and `noise` the residual of the force,
    m/s². `is_used` is whether the speed explains the force of the last seconds. `is_yaw_usable` and
    `is_yaw_known` are whether the yaw is known roughly, and well; until the latter, a vehicle is
    assumed to drive forwards. `sign` is minus one while a vehicle with an unsigned speed reverses,
    and `is_clear` is whether the force has determined the sign since the last stop.
    """

    def __init__(self) -> None:
        self.yaw, self.is_yaw_usable, self.is_yaw_known = 0.0, False, False
        self.scale, self.noise = 1.0, 0.3
        self._waiting: deque[Tick] = deque(maxlen=64)
        self._matched: deque[tuple[Tick, complex]] = deque(
            maxlen=max(ACCELERATION.spans.values()) + 1
        )
        # Force, change of velocity in the direction of travel, and of speed, m/s².
        self._seen: deque[tuple[complex, complex, float]] = deque(maxlen=ACCELERATION.watched)
        self._is_rough, self._slow = False, ACCELERATION.slow[SpeedSource.ODOMETRY]
        self._is_signed, self._span = True, ACCELERATION.spans[SpeedSource.ODOMETRY]
        self._track_key: tuple[SpeedSource, float] | None = None
        self.restart()

    def restart(self) -> None:
        """Forget all ticks: the gyro's frame has changed."""
        self._waiting.clear()
        self._gives, self._pauses_until = False, -math.inf
        self._before, self._is_under_way, self._speed = _Trip(), True, 0.0
        self.sign, self.is_clear = 1.0, False
        self._slope, self._explained, self._energy, self._in_trip = 0j, 0.0, 0.0, 0
        self._try_anew()

    def _try_anew(self) -> None:
        self._matched.clear()
        self._seen.clear()
        self._gravity: tuple[float, Triple] | None = None
        self.is_used = False

    def trip_at(self, stamp: float) -> tuple[float, bool, bool]:
        """Return the sign of the trip at a stamp (plus or minus one).

        Also whether the force has determined the sign, and whether it may still do so.
        """
        if stamp > self._before.end:
            return self.sign, self.is_clear, True
        return self._before.sign, self._before.is_clear, False

    def add(self, tick: Tick, track: SpeedTrack | None) -> list[tuple[Tick, float]]:
        """Add a tick; return the ticks that were matched with a speed (m/s, NaN if unknown)."""
        self._waiting.append(tick)
        key = None if track is None else (track.source, track.delay)
        if key != self._track_key:
            # After a change of source or latency, differences of velocity are not valid.
            self._track_key = key
            self._try_anew()
        if track is not None:
            self._is_signed = track.is_signed
            self._slow = ACCELERATION.slow[track.source]
            self._is_rough = track.source is SpeedSource.FIXES
            self._span = ACCELERATION.spans[SpeedSource.VELOCITY if track.is_slow else track.source]
        met: list[tuple[Tick, float]] = []
        while self._waiting:
            first = self._waiting[0]
            is_late = tick.stamp - first.stamp > ACCELERATION.oldest
            if track is not None and not track.has_passed(first.stamp) and not is_late:
                break
            self._waiting.popleft()
            speed = None if track is None else track.at(first.stamp)
            self._meet(first, speed)
            met.append((first, math.nan if speed is None else speed * self.sign))
        return met

    def linear(self, stamp: float, force: Triple, frame: GyroFrame) -> Triple | None:
        """Return what to subtract from a specific force, m/s², body axes; None if it is not known.

        After a gap it pauses for some seconds: brief corrections would mislead the filter of up.
        """
        since, gravity = self._gravity or (math.inf, force)
        is_known = self.is_used and 0.0 <= stamp - since <= ACCELERATION.oldest
        if not is_known or frame.axes is None or stamp < self._pauses_until:
            if self._gives:
                self._pauses_until = stamp + ACCELERATION.oldest
            self._gives = False
            return None
        self._gives = True
        return minus(force, frame.to_body(gravity))

    @property
    def _turn(self) -> complex:
        """Factor from the change of velocity, for an IMU that faces ahead, to the force."""
        return self.scale * cmath.exp(-1j * self.yaw)

    def _begin_trip(self, stamp: float, sign: float, is_clear: bool) -> None:
        self._before = _Trip(stamp, self.sign, self.is_clear)
        self.sign, self.is_clear = sign, is_clear
        left = [force - self._turn * change for force, change, _ in self._seen]
        self._slope = sum(left) / max(len(left), 1)
        self._explained, self._energy, self._in_trip = 0.0, 0.0, 0

    def _meet(self, tick: Tick, speed: float | None) -> None:
        if speed is None:
            self._matched.clear()
            self._gravity = None
            return
        is_slow = abs(speed) < ACCELERATION.speed_at_rest
        if is_slow and self._is_under_way:
            self._begin_trip(tick.stamp, 1.0, False)
        elif (
            not is_slow and self._span > 2 and abs(speed) < min(ACCELERATION.crawling, self._speed)
        ):
            # A speed at 1 Hz may miss a stop, and fixes smear a stop over seconds.
            self._begin_trip(tick.stamp, self.sign, self.is_clear and not self._is_rough)
        self._is_under_way, self._speed = not is_slow, abs(speed)
        self._matched.append((tick, speed * cmath.exp(1j * tick.yaw)))
        if len(self._matched) > self._span:
            self._subtract()

    def _subtract(self) -> None:
        """Subtract the change of velocity over the span from the mean force."""
        (begin, old), *others = list(self._matched)[-self._span - 1 :]
        end, new = others[-1]
        seconds = sum(tick.seconds for tick, _ in others)
        if not 0.5 * seconds < end.stamp - begin.stamp < 1.5 * seconds:
            return
        x, y, z = (
            sum(tick.force[axis] * tick.seconds for tick, _ in others) / seconds
            for axis in range(3)
        )
        # The speed of a receiver at rest drifts.
        stands = max(abs(new), abs(old)) < self._slow
        change = 0j if stands else (new - old) / seconds
        along = (abs(new) - abs(old)) / seconds
        self._seen.append((complex(x, y), self.sign * change, along))
        self._in_trip += 1
        if not self._is_signed and self._is_under_way:
            self._decide(complex(x, y), change * self._turn)
        self._judge()
        own = self.sign * change * self._turn
        self._gravity = (end.stamp, (x - own.real, y - own.imag, z))

    def _judge(self) -> None:
        """Test whether the speed explains the force of the last seconds."""
        force, change, along = np.array(self._seen).T
        without, quiet = float(np.var(force)), ACCELERATION.quiet**2
        limit = ACCELERATION.gain * without if without > quiet else quiet
        is_explained = float(np.var(force - self._turn * change)) <= limit
        # In a steady circle the gyro is enough: the speed from fixes would only add noise.
        changes, starts = (float(np.sum(np.abs(each) ** 2)) for each in (change, along))
        is_tested = not self._is_rough or (
            self.is_yaw_usable and starts >= ACCELERATION.along * changes > 0.0
        )
        self.is_used = len(force) >= ACCELERATION.fewest and is_explained and is_tested

    def _decide(self, shown: complex, forwards: complex) -> None:
        """Accumulate the evidence for the direction of travel since the last stop."""
        # `forwards` is the acceleration of a vehicle that drives forwards. The rest of the force is
        # that before the trip: during the trip it depends on the unknown sign.
        self._explained += ((shown - self._slope) * forwards.conjugate()).real
        self._energy += abs(forwards) ** 2
        if not self.is_yaw_known or self._energy <= 0.0:
            return
        sigmas = self._explained / (math.sqrt(ACCELERATION.correlated * self._energy) * self.noise)
        if sigmas * self.sign < -CLEAR:
            self.sign = -self.sign
            for row in range(max(0, len(self._seen) - self._in_trip), len(self._seen)):
                force, change, along = self._seen[row]
                self._seen[row] = force, -change, along
        self.is_clear = self.is_clear or sigmas * self.sign > CLEAR
