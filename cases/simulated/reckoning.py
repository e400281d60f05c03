"""The samples of a vehicle's wheels and satellite receiver, with their faults."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from magcal_ros.core.geometry.arrays import BoolArray, FloatArray, interpolated
from magcal_ros.core.samples.streams import PositionSample, SpeedSample, VelocitySample
from simulated.travel import Travel, exponential_noise


@dataclass(frozen=True)
class Wheels:
    """Odometry.

    Parameters
    ----------
    rate : float
        Messages a second.
    scale : float
        Of the speed it says; 3.6 for km/h.
    delay : float
        Seconds by which it is late.
    noise, step : float
        m/s: noise, and the step of an encoder that counts.
    is_signed : bool
        Whether backwards is negative.
    frozen_from : float
        Seconds from the start from which it repeats what it said last.
    jumps : float
        Share of the messages that say anything.
    """

    rate: float = 20.0
    scale: float = 1.0
    delay: float = 0.05
    noise: float = 0.02
    step: float = 0.02
    is_signed: bool = True
    frozen_from: float = math.inf
    jumps: float = 0.0

    def speeds(self, truth: Travel, rng: np.random.Generator) -> tuple[SpeedSample, ...]:
        """Return its samples of a drive."""
        stamps = np.arange(truth.time[0], truth.time[-1], 1.0 / self.rate)
        moments = np.minimum(stamps, truth.time[0] + self.frozen_from) - self.delay
        speed = np.interp(moments, truth.time, truth.speed)
        moving = np.abs(speed) > 0.02
        speed = self.scale * (speed + self.noise * moving * rng.standard_normal(len(speed)))
        if self.step > 0.0:
            speed = self.step * np.round(speed / self.step)
        is_frozen = stamps - truth.time[0] > self.frozen_from
        speed[is_frozen] = speed[~is_frozen][-1] if not is_frozen.all() else 0.0
        wild = rng.random(len(speed)) < self.jumps
        speed[wild] = rng.uniform(-50.0, 50.0, int(wild.sum()))
        if not self.is_signed:
            speed = np.abs(speed)
        pairs = zip(stamps.tolist(), speed.tolist(), strict=True)
        return tuple(SpeedSample(stamp, value, self.is_signed) for stamp, value in pairs)


@dataclass(frozen=True)
class Receiver:
    """A satellite receiver.

    Parameters
    ----------
    rate : float
        Fixes a second.
    delay : float
        Seconds by which its stamps are late.
    drift, drift_lasts : float
        Metres and seconds: standard deviation per axis of a slow error, and how long it lasts.
    noise : float
        Metres per axis that differ from fix to fix.
    speed_noise : float
        m/s per axis of its velocity; zero for a receiver that reports none.
    multipath : float
        Chance per second that houses bend its fixes by metres, for some seconds.
    bend : float
        Metres, standard deviation per axis of such a bend.
    outages : tuple of pairs
        Seconds from the start between which there is no fix.
    """

    rate: float = 1.0
    delay: float = 0.5
    drift: float = 1.5
    drift_lasts: float = 100.0
    noise: float = 0.1
    speed_noise: float = 0.0
    multipath: float = 0.0
    bend: float = 6.0
    outages: tuple[tuple[float, float], ...] = ()

    def received(
        self, truth: Travel, rng: np.random.Generator
    ) -> tuple[tuple[PositionSample, ...], tuple[VelocitySample, ...]]:
        """Return the fixes of a drive, and the velocities where it reports them."""
        stamps = np.arange(truth.time[0] + 0.37, truth.time[-1], 1.0 / self.rate)
        moments = stamps - self.delay
        place = interpolated(moments, truth.time, truth.position)
        bent, is_bent = self._bends(len(stamps), rng)
        drift = exponential_noise(rng, len(stamps), 1.0 / self.rate, self.drift_lasts)
        place = place + self.drift * drift + bent
        place = place + self.noise * rng.standard_normal(place.shape)
        velocity = interpolated(
            moments, truth.time, np.gradient(truth.position, truth.period, axis=0)
        )
        size = self.speed_noise * np.where(is_bent, 5.0, 1.0)[:, None]
        velocity = velocity + size * rng.standard_normal(velocity.shape)
        since = stamps - truth.time[0]
        kept = np.ones(len(stamps), dtype=bool)
        for begin, end in self.outages:
            kept &= (since < begin) | (since >= end)
        at = stamps[kept].tolist()
        positions = tuple(
            PositionSample(t, east, north)
            for t, (east, north) in zip(at, place[kept].tolist(), strict=True)
        )
        velocities = tuple(
            VelocitySample(t, east, north, self.speed_noise)
            for t, (east, north) in zip(at, velocity[kept].tolist(), strict=True)
        )
        return positions, velocities if self.speed_noise > 0.0 else ()

    def _bends(self, count: int, rng: np.random.Generator) -> tuple[FloatArray, BoolArray]:
        """Return the errors of the fixes by houses, metres, and which fixes have them."""
        bent, is_bent = np.zeros((count, 2)), np.zeros(count, dtype=bool)
        for first in np.flatnonzero(rng.random(count) < self.multipath / self.rate):
            rows = slice(first, first + int(rng.uniform(2.0, 8.0) * self.rate) + 1)
            bent[rows] = self.bend * rng.standard_normal(2)
            is_bent[rows] = True
        return bent, is_bent
