"""The vehicle's speed from the best of several sources."""

from __future__ import annotations

import copy
import math
from collections import deque
from typing import TypeVar

import numpy as np

from magcal_ros.core.driving.driving_tuning import ACCELERATION, SPEED, SpeedSource
from magcal_ros.core.geometry.arrays import FloatArray
from magcal_ros.core.samples.streams import (
    PositionSample,
    SpeedSample,
    StampGuard,
    TravelSample,
    VelocitySample,
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
        self._kept: deque[tuple[float, float]] = deque(
            maxlen=int(ACCELERATION.remembered / SPEED.shortest)
        )

    @property
    def newest(self) -> float:
        """Stamp of the newest accepted sample, seconds; minus infinity before the first."""
        return self._kept[-1][0] if self._kept else -math.inf

    @property
    def last(self) -> float:
        """The newest speed, m/s; NaN before the first."""
        return self._kept[-1][1] if self._kept else math.nan

    def last_near(self, stamp: float, gap: float) -> float:
        """Return the newest speed, m/s; NaN if it is further than `gap` seconds from a stamp."""
        return math.nan if abs(stamp + self.delay - self.newest) > gap else self.last

    def wants(self, stamp: float) -> bool:
        """Whether a sample at a stamp is used; of a fast source, some are skipped."""
        return not 0.0 < stamp - self.newest < SPEED.shortest

    def add(self, stamp: float, speed: float) -> bool:
        """Add a speed; return whether it was usable.

        After a jump it is accepted only if the next one confirms it.
        """
        if not self.wants(stamp):
            return True
        if not abs(speed) <= SPEED.largest or self._stamps.check(stamp) is not None:
            return False
        if stamp < self.newest:
            self._kept.clear()
        sample = stamp, speed
        doubted, self._doubted = self._doubted, None
        is_wild = bool(self._kept) and is_jump(self._kept[-1], sample)
        # A running mean over the number of samples of which ten may be outliers.
        self.outlier_share += (is_wild - self.outlier_share) * 0.1 * SPEED.outliers
        if is_wild and (doubted is None or is_jump(doubted, sample)):
            self._doubted = sample
        else:
            self._kept.append(sample)
        return True

    @property
    def is_quick(self) -> bool:
        """Whether these are wheels that are measured more often than by a receiver."""
        if self.source is not SpeedSource.ODOMETRY:
            return False
        return len(self._kept) < 4 or self._kept[-1][0] - self._kept[-4][0] <= 3.0 * SPEED.seldom

    @property
    def gap(self) -> float:
        """Longest gap that is interpolated, seconds."""
        return 2.0 * SPEED.seldom if self.is_quick else SPEED.receiver_gap

    def at(self, stamp: float) -> float:
        """Return the speed, m/s, at a stamp of the IMU; NaN unless samples enclose the stamp."""
        return float(self.along(np.array([stamp]), self.delay)[0])

    def has_passed(self, stamp: float) -> bool:
        """Whether no further sample before a stamp of the IMU can come."""
        return self.newest >= stamp + self.delay

    def along(self, stamps: FloatArray, delay: float | FloatArray) -> FloatArray:
        """Return the speed at stamps (n,) of the IMU for another latency, NaN if unknown.

        It is unknown outside of the samples, and from a sample before a gap or a jump until the
        next. For several latencies, shape (d, 1), the result has the shape (d, n).
        """
        moments, needed = stamps + delay, list[tuple[float, float]]()
        first = float(moments.min(initial=math.inf))
        for sample in reversed(self._kept):
            needed.append(sample)
            if sample[0] < first:
                break
        if not needed:
            return np.full(moments.shape, math.nan)
        time, speed = np.array(needed[::-1]).T
        span, change = np.diff(time), np.diff(speed)
        broken = (span > self.gap) | (np.abs(change) > largest_change(span))
        found = np.interp(moments, time, speed, left=math.nan, right=math.nan)
        # From the newest sample on, there is no span that may be broken.
        span_of = np.searchsorted(time, moments, side="right") - 1
        found[np.append(broken, False)[span_of]] = math.nan
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
