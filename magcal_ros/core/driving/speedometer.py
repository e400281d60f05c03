"""The vehicle's speed at any stamp, from the best source that is available."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from magcal_ros.core.driving.driving_tuning import SPEED, SpeedSource
from magcal_ros.core.geometry.arrays import FloatArray
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
    """Return by how much a speed may change meanwhile, m/s; beyond it is a jump."""
    return SPEED.largest_acceleration * seconds + SPEED.step


def is_jump(before: tuple[float, float], after: tuple[float, float]) -> bool:
    """Whether a speed changes from one stamp to another as no vehicle's can."""
    return abs(after[1] - before[1]) > largest_change(after[0] - before[0])


@dataclass(frozen=True, eq=False)
class SpeedRecord:
    """What one source has measured, frozen."""

    kept: FloatArray
    """Stamps and speeds of some minutes, thinned. Shape (n, 2)."""
    wild_share: float  # share of the newest samples to which the speed jumps as no vehicle can
    delay: float
    gap: float
    """Seconds by which the stamps are late, and that are interpolated over."""
    is_signed: bool  # whether backwards is negative

    def along(self, stamps: FloatArray, delay: float) -> FloatArray:
        """Return the speed at many stamps (n,), NaN where there is none, for a latency."""
        if len(self.kept) < 2:
            return np.full(len(stamps), math.nan)
        time, speed = self.kept.T
        moments = stamps + delay
        after = np.clip(np.searchsorted(time, moments), 1, len(time) - 1)
        span, change = np.diff(time), np.diff(speed)
        broken = (span > self.gap) | (np.abs(change) > largest_change(span))
        found = np.interp(moments, time, speed, left=math.nan, right=math.nan)
        found[broken[after - 1]] = math.nan
        return np.asarray(found)


class SpeedTrack:
    """What one source has measured lately.

    `delay` are the seconds by which its stamps are late, and `is_signed` is whether backwards is
    negative.
    """

    def __init__(self, source: SpeedSource) -> None:
        own = source is SpeedSource.ODOMETRY
        self.source = source
        self.delay = 0.0 if own else SPEED.receiver_delay
        self.is_signed = own
        self._stamps = StampGuard()
        self._doubted: tuple[float, float] | None = None
        self._wild: deque[bool] = deque(maxlen=SPEED.newest)
        self._recent: deque[tuple[float, float]] = deque(maxlen=SPEED.newest)
        self._kept: deque[tuple[float, float]] = deque(maxlen=SPEED.remembered)

    @property
    def newest(self) -> float:
        """Stamp of the newest sample that is believed, seconds; minus infinity before the first."""
        return self._recent[-1][0] if self._recent else -math.inf

    @property
    def last(self) -> float:
        """The newest speed, m/s; NaN before the first."""
        return self._recent[-1][1] if self._recent else math.nan

    def wants(self, stamp: float) -> bool:
        """Whether a sample is of use, and not one of more a second than are read."""
        return not 0.0 < stamp - self.newest < SPEED.shortest

    def add(self, stamp: float, speed: float) -> bool:
        """Take a speed; returns whether it was usable."""
        if not self.wants(stamp):
            return True
        if not abs(speed) <= SPEED.largest or self._stamps.check(stamp) is not None:
            return False
        if stamp < self.newest:
            self._recent.clear()
            self._kept.clear()
        self._weigh((stamp, speed))
        return True

    def _weigh(self, sample: tuple[float, float]) -> None:
        """Accept a sample; one to which the speed jumps only if the next one stays there."""
        doubted, self._doubted = self._doubted, None
        is_wild = bool(self._recent) and is_jump(self._recent[-1], sample)
        self._wild.append(is_wild)
        if is_wild and (doubted is None or is_jump(doubted, sample)):
            self._doubted = sample
            return
        self._recent.append(sample)
        if not self._kept or sample[0] - self._kept[-1][0] >= 2.0 * SPEED.shortest:
            self._kept.append(sample)

    @property
    def is_slow(self) -> bool:
        """Whether these are wheels with as few messages as a receiver."""
        if self.source is not SpeedSource.ODOMETRY or len(self._recent) < 4:
            return False
        return self._recent[-1][0] - self._recent[-4][0] > 3.0 * SPEED.seldom

    @property
    def gap(self) -> float:
        """Seconds between two samples that are interpolated between."""
        is_quick = self.source is SpeedSource.ODOMETRY and not self.is_slow
        return 2.0 * SPEED.seldom if is_quick else SPEED.receiver_gap

    def at(self, stamp: float) -> float | None:
        """Return the speed at a stamp of the IMU's clock; None unless two near samples enclose it.

        m/s.
        """
        stamp += self.delay
        found = enclosing(self._recent, stamp)
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
        """Whether waiting longer can bring no sample before a stamp of the IMU's clock."""
        return self.newest >= stamp + self.delay

    def record(self) -> SpeedRecord:
        """Return what is remembered, for work in another thread."""
        kept = np.array(self._kept).reshape(-1, 2)
        count = len(self._wild)
        wild = sum(self._wild) / count if count >= SPEED.fewest else 0.0
        return SpeedRecord(kept, wild, self.delay, self.gap, self.is_signed)


class Speedometer:
    """Listens to wheels and receiver."""

    def __init__(self) -> None:
        self.tracks = {source: SpeedTrack(source) for source in SpeedSource}
        self.distrusted: set[SpeedSource] = set()
        self._fix: PositionSample | None = None

    def add(self, sample: TravelSample) -> bool:
        """Take what wheels or a receiver say, m/s and metres; returns whether it was usable.

        The speed of a fix is that since the fix before.
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
        way = math.hypot(sample.east - before.east, sample.north - before.north)
        return self.tracks[SpeedSource.FIXES].add(0.5 * (sample.stamp + before.stamp), way / span)

    @property
    def track(self) -> SpeedTrack | None:
        """The best source that is available and trusted; None without one."""
        newest = max([track.newest for track in self.tracks.values()])
        for source, track in self.tracks.items():
            is_here = newest - track.newest < SPEED.silent
            if is_here and source not in self.distrusted:
                return track
        return None
