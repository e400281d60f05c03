"""A frame that the gyro keeps still: in it gravity stays where it is, and velocities are summed."""

from __future__ import annotations

import cmath
import math
from typing import NamedTuple

from magcal_ros.core.driving.driving_tuning import TickTuning
from magcal_ros.core.geometry.vec3 import Triple, cross, dot, length, propagated, unit_triple
from magcal_ros.core.samples.streams import STREAMS, ImuSample

Axes = tuple[Triple, Triple, Triple]


class Tick(NamedTuple):
    """A quarter of a second of the IMU."""

    stamp: float
    seconds: float
    """Its end, and how long it took."""
    force: Triple
    """Mean specific force in the frame, m/s²."""
    yaw: float
    """Of the body's x in the frame at its end, radians."""
    turn_rate: float
    """Mean about the frame's up, rad/s."""

    @property
    def level_force(self) -> complex:
        """The force across up, first and second axis of the frame, m/s²."""
        return complex(self.force[0], self.force[1])


class GyroFrame:
    """Keeps a level frame by the gyro and sums the force in it.

    Attributes
    ----------
    axes : tuple of tuples
        The frame's axes in body axes; the third is up but for seconds' worth of accelerations.
    restarts : int
        How often the frame began anew, after a gap or a step back in time.
    """

    def __init__(self, tuning: TickTuning | None = None) -> None:
        self._tuning = tuning or TickTuning()
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
        (a, b, c), (x, y, z) = last.rate, bias
        turn = (
            (0.5 * (a + p) - x) * seconds,
            (0.5 * (b + q) - y) * seconds,
            (0.5 * (c + r) - z) * seconds,
        )
        first, second, _ = self.axes
        first, second = propagated(first, turn), propagated(second, turn)
        third = cross(first, second)
        self.axes = (first, second, third)
        force, (sx, sy, sz) = sample.force, self._force
        self._force = (
            sx + dot(first, force) * seconds,
            sy + dot(second, force) * seconds,
            sz + dot(third, force) * seconds,
        )
        self._turned += dot(third, turn)
        self._seconds += seconds
        return self._end(stamp) if self._seconds >= self._tuning.seconds - 1e-6 else None

    def to_body(self, vector: Triple) -> Triple:
        """Turn a vector from the frame's axes into body axes."""
        assert self.axes is not None
        (a, b, c), (p, q, r), (x, y, z) = self.axes
        u, v, w = vector
        return (u * a + v * p + w * x, u * b + v * q + w * y, u * c + v * r + w * z)

    def _begin(self, force: Triple) -> None:
        self.restarts += 1
        up = unit_triple(force)
        start = (1.0, 0.0, 0.0) if abs(up[0]) < 0.9 else (0.0, 1.0, 0.0)
        second = unit_triple(cross(up, start))
        self.axes = (cross(second, up), second, up)
        self._levelled = 0.0
        self._anew()

    def _anew(self) -> None:
        self._force = (0.0, 0.0, 0.0)
        self._turned = self._seconds = 0.0

    def _end(self, stamp: float) -> Tick | None:
        assert self.axes is not None
        x, y, z = (value / self._seconds for value in self._force)
        forward = complex(self.axes[0][0], self.axes[1][0])
        seconds, turned = self._seconds, self._turned
        self._anew()
        self._level((x, y, z), seconds)
        if abs(forward) < self._tuning.steepest:
            return None
        return Tick(stamp, seconds, (x, y, z), cmath.phase(forward), turned / seconds)

    def _level(self, force: Triple, seconds: float) -> None:
        """Lean the frame towards the force, by little: its up is right in the long run."""
        self._levelled = min(self._levelled + seconds, self._tuning.levelling)
        size = length(force)
        if size <= 0.0:
            return
        share = seconds / self._levelled / size
        # The frame's up is to turn towards the force: about up x force, in body axes.
        lean = self.to_body((-force[1] * share, force[0] * share, 0.0))
        back = (-lean[0], -lean[1], -lean[2])
        assert self.axes is not None
        first, second, _ = (unit_triple(propagated(axis, back)) for axis in self.axes)
        self.axes = (first, second, cross(first, second))
