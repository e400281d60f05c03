"""A level frame that the gyro stabilises, and the force in it."""

from __future__ import annotations

import cmath
import math
from typing import NamedTuple

from magcal_ros.core.driving.driving_tuning import ACCELERATION
from magcal_ros.core.geometry.vec3 import (
    Triple,
    cross,
    dot,
    interpolate,
    length,
    minus,
    plus,
    propagated,
    scaled,
    unit_triple,
)
from magcal_ros.core.samples.samples_tuning import STREAMS
from magcal_ros.core.samples.streams import ImuSample

Axes = tuple[Triple, Triple, Triple]


class Tick(NamedTuple):
    """A quarter of a second of the IMU."""

    stamp: float
    seconds: float
    """End and duration, seconds."""
    force: Triple  # mean specific force in the frame, m/s²
    yaw: float  # of the body's x in the frame at its end, radians
    turn_rate: float  # mean about the frame's up, rad/s
    level_force: complex
    """The force across up by the gyro alone, m/s²: without the levelling of the frame, which would
    follow a long acceleration."""


class GyroFrame:
    """Stabilises a level frame by the gyro, and averages the force in it.

    `axes` are the frame's axes in body axes; the third is up, except for short accelerations.
    `restarts` counts the restarts of the frame, after a gap or a step back in time.
    """

    def __init__(self) -> None:
        self._last: ImuSample | None = None
        self.axes: Axes = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)
        self.restarts = 0
        self._levelled = self._turned = self._seconds = 0.0
        self._force: Triple = (0.0, 0.0, 0.0)
        self._levelled_off = 0j

    def add(self, sample: ImuSample, bias: Triple) -> Tick | None:
        """Add an IMU sample and the gyro's bias (rad/s); return a tick when it is complete."""
        stamp, (fx, fy, fz), (p, q, r) = sample[:3]
        if not 0.0 < fx * fx + fy * fy + fz * fz < math.inf or not math.isfinite(p + q + r):
            return None
        last, self._last = self._last, sample
        seconds = math.inf if last is None else stamp - last.stamp
        if last is None or not 0.0 < seconds <= STREAMS.longest_gyro_step:
            self._begin(sample.force)
            return None
        turn = scaled(minus(interpolate(last.rate, sample.rate, 0.5), bias), seconds)
        first, second, _ = self.axes
        first, second = propagated(first, turn), propagated(second, turn)
        third = cross(first, second)
        self.axes = (first, second, third)
        force = (dot(first, sample.force), dot(second, sample.force), dot(third, sample.force))
        self._force = plus(self._force, scaled(force, seconds))
        self._turned += dot(third, turn)
        self._seconds += seconds
        return self._end(stamp) if self._seconds >= ACCELERATION.seconds - 1e-6 else None

    def to_body(self, vector: Triple) -> Triple:
        """Turn a vector from the frame's axes into body axes."""
        first, second, third = (scaled(a, x) for a, x in zip(self.axes, vector, strict=True))
        return plus(plus(first, second), third)

    def _begin(self, force: Triple) -> None:
        self.restarts += 1
        up = unit_triple(force)
        start = (1.0, 0.0, 0.0) if abs(up[0]) < 0.9 else (0.0, 1.0, 0.0)
        second = unit_triple(cross(up, start))
        self.axes = (cross(second, up), second, up)
        self._force, self._levelled_off = (0.0, 0.0, 0.0), 0j
        self._levelled = self._turned = self._seconds = 0.0

    def _end(self, stamp: float) -> Tick | None:
        x, y, z = (value / self._seconds for value in self._force)
        forward = complex(self.axes[0][0], self.axes[1][0])
        seconds, turned = self._seconds, self._turned
        self._force = (0.0, 0.0, 0.0)
        self._turned = self._seconds = 0.0
        level_force = complex(x, y) + self._levelled_off
        self._level((x, y, z), seconds)
        if abs(forward) < ACCELERATION.steepest:
            return None
        return Tick(stamp, seconds, (x, y, z), cmath.phase(forward), turned / seconds, level_force)

    def _level(self, force: Triple, seconds: float) -> None:
        """Tilt the frame slightly towards the force, whose long-term mean is up."""
        self._levelled = min(self._levelled + seconds, ACCELERATION.levelling)
        size = length(force)
        if size <= 0.0:
            return
        share = seconds / self._levelled / size
        self._levelled_off += size * share * complex(force[0], force[1])
        # The frame's up turns towards the force about up x force, so the body turns about minus it.
        back = self.to_body((force[1] * share, -force[0] * share, 0.0))
        first, second, _ = (unit_triple(propagated(axis, back)) for axis in self.axes)
        self.axes = (first, second, cross(first, second))
