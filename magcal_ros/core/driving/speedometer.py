"""The vehicle's speed at any stamp, from the best source that speaks."""

from __future__ import annotations

import math
from collections import Counter, deque
from dataclasses import dataclass

import numpy as np

from magcal_ros.core.driving.driving_tuning import SpeedSource, SpeedTuning
from magcal_ros.core.geometry.arrays import BoolArray, FloatArray
from magcal_ros.core.samples.streams import Drop, StampGuard
from magcal_ros.core.samples.travel_samples import PositionSample, SpeedSample, VelocitySample


@dataclass(frozen=True, eq=False)
class SpeedRecord:
    """What one source said, frozen.

    Parameters
    ----------
    kept, recent : ndarray, shape (n, 2)
        Stamps and speeds of some minutes, thinned, and the newest as they were read.
    delay, gap : float
        Seconds by which the stamps are late, and that are interpolated over.
    is_signed : bool
        Whether backwards is negative.
    tuning : SpeedTuning
        What is taken for granted.
    """

    kept: FloatArray
    recent: FloatArray
    delay: float
    gap: float
    is_signed: bool
    tuning: SpeedTuning

    def along(self, stamps: FloatArray, delay: float) -> FloatArray:
        """Return the speed at many stamps (n,), NaN where there is none, for a latency."""
        if len(self.kept) < 2:
            return np.full(len(stamps), math.nan)
        time, speed = self.kept.T
        moments = stamps + delay
        after = np.clip(np.searchsorted(time, moments), 1, len(time) - 1)
        span, change = np.diff(time), np.diff(speed)
        broken = (span > self.gap) | self._is_wild(span, change)
        found = np.interp(moments, time, speed, left=math.nan, right=math.nan)
        found[broken[after - 1]] = math.nan
        return np.asarray(found)

    @property
    def wild_share(self) -> float:
        """Share of the newest samples between which the speed jumps as no vehicle can."""
        if len(self.recent) < 20:
            return 0.0
        span, change = np.diff(self.recent, axis=0).T
        return float(np.mean(self._is_wild(span, change)))

    def _is_wild(self, span: FloatArray, change: FloatArray) -> BoolArray:
        return np.asarray(np.abs(change) > self.tuning.largest_acceleration * span + 0.5)


class SpeedTrack:
    """What one source said lately.

    Parameters
    ----------
    tuning : SpeedTuning
        What is taken for granted.
    source : SpeedSource
        Who it is.

    Attributes
    ----------
    delay : float
        Seconds by which its stamps are late.
    is_signed : bool
        Whether backwards is negative.
    newest : float
        Stamp of the newest sample, seconds; minus infinity before the first.
    last : float
        The newest speed, m/s; NaN before the first.
    drops : Counter of Drop
        What was not used.
    """

    def __init__(self, tuning: SpeedTuning, source: SpeedSource) -> None:
        own = source is SpeedSource.ODOMETRY
        self.source = source
        self.delay = 0.0 if own else tuning.receiver_delay
        self.gap = tuning.odometry_gap if own else tuning.receiver_gap
        self.is_signed = own
        self.newest, self.last = -math.inf, math.nan
        self.drops: Counter[Drop] = Counter()
        self._tuning = tuning
        self._stamps = StampGuard()
        self._recent: deque[tuple[float, float]] = deque(maxlen=512)
        self._kept: deque[tuple[float, float]] = deque(maxlen=tuning.remembered)

    def wants(self, stamp: float) -> bool:
        """Whether a sample is of use, and not one of more a second than are read."""
        return not 0.0 < stamp - self.newest < self._tuning.shortest

    def add(self, stamp: float, speed: float) -> bool:
        """Take a speed; returns whether it was usable."""
        if not self.wants(stamp):
            return True
        if not math.isfinite(speed):
            reason: Drop | None = Drop.NOT_FINITE
        elif abs(speed) > self._tuning.largest:
            reason = Drop.TOO_LARGE
        else:
            reason = self._stamps.check(stamp)
        if reason is not None:
            self.drops[reason] += 1
            return False
        if stamp < self.newest:
            self._recent.clear()
            self._kept.clear()
        self.newest, self.last = stamp, speed
        self._recent.append((stamp, speed))
        if not self._kept or stamp - self._kept[-1][0] >= self._tuning.spacing:
            self._kept.append((stamp, speed))
        return True

    def at(self, stamp: float) -> float | None:
        """Return the speed at a stamp of the IMU's clock; None unless two near samples enclose it.

        m/s.
        """
        stamp += self.delay
        later: tuple[float, float] | None = None
        for sample in reversed(self._recent):
            if sample[0] <= stamp:
                if later is None:
                    return sample[1] if sample[0] == stamp else None
                span = later[0] - sample[0]
                change = later[1] - sample[1]
                if span > self.gap or abs(change) > self._tuning.largest_acceleration * span + 0.5:
                    return None
                return sample[1] + change * (stamp - sample[0]) / span
            later = sample
        return None

    def has_passed(self, stamp: float) -> bool:
        """Whether waiting longer can bring no sample before a stamp of the IMU's clock."""
        return self.newest >= stamp + self.delay

    def record(self) -> SpeedRecord:
        """Return what is remembered, for work in another thread."""
        kept = np.array(self._kept).reshape(-1, 2)
        recent = np.array(self._recent).reshape(-1, 2)
        return SpeedRecord(kept, recent, self.delay, self.gap, self.is_signed, self._tuning)


class Speedometer:
    """Listens to wheels and receiver.

    Parameters
    ----------
    tuning : SpeedTuning, optional
        What is taken for granted.
    """

    def __init__(self, tuning: SpeedTuning | None = None) -> None:
        self._tuning = tuning or SpeedTuning()
        self.tracks = {source: SpeedTrack(self._tuning, source) for source in SpeedSource}
        self.distrusted: set[SpeedSource] = set()
        self._in_order = tuple(self.tracks.values())
        self._fix: PositionSample | None = None

    def add_speed(self, sample: SpeedSample) -> bool:
        """Take what wheels say; returns whether it was usable."""
        track = self.tracks[SpeedSource.ODOMETRY]
        track.is_signed = sample.is_signed
        return track.add(sample.stamp, sample.speed)

    def add_velocity(self, sample: VelocitySample) -> bool:
        """Take a receiver's velocity; returns whether it was usable."""
        speed = math.hypot(sample.east, sample.north)
        return self.tracks[SpeedSource.VELOCITY].add(sample.stamp, speed)

    def add_position(self, sample: PositionSample) -> bool:
        """Take a fix: the speed is that since the fix before; returns whether it was usable."""
        before = self._fix
        if not math.isfinite(sample.stamp + sample.east + sample.north):
            return False
        self._fix = sample
        if before is None or not 0.05 < sample.stamp - before.stamp <= self._tuning.receiver_gap:
            return False
        span = sample.stamp - before.stamp
        way = math.hypot(sample.east - before.east, sample.north - before.north)
        return self.tracks[SpeedSource.FIXES].add(0.5 * (sample.stamp + before.stamp), way / span)

    @property
    def track(self) -> SpeedTrack | None:
        """The best source that speaks and is trusted; None if none does."""
        wheels, velocity, fixes = self._in_order
        newest = max(wheels.newest, velocity.newest, fixes.newest)
        for track in self._in_order:
            is_here = newest - track.newest < self._tuning.silent
            if is_here and track.source not in self.distrusted:
                return track
        return None
