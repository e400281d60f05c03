"""The gyro's level frame, straight chords of the path, and the compass against their course.

    r_i = o + a1 cos psi + b1 sin psi + a2 cos 2psi + b2 sin 2psi + g(p_i) + n_i

r is the yaw of the compass minus the course psi, o the offset, and g the local disturbance at the
place p_i with covariance s² exp(-|p_i - p_j|/30 m). The fit is generalised least squares with
Student weights. The sigma is clustered by street: both directions of a street are one observation.
It includes a fraction of the swing.
"""

from __future__ import annotations

import cmath
import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from magcal_ros.core.driving.driving_tuning import ACCELERATION, COURSE, MOUNTING, SPEED
from magcal_ros.core.geometry.arrays import FloatArray
from magcal_ros.core.geometry.attitude import wrap_angle
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
from magcal_ros.core.knowledge import STREET_LENGTH
from magcal_ros.core.samples.streams import STREAMS, ImuSample, PositionSample, VelocitySample

Axes = tuple[Triple, Triple, Triple]
SECTORS = 8


class Tick(NamedTuple):
    """A quarter of a second of the IMU."""

    stamp: float
    seconds: float
    """End and duration, seconds."""
    force: Triple  # mean specific force in the frame, m/s²
    yaw: float  # of the body's x in the frame at its end, radians
    turn_rate: float  # mean about the frame's up, rad/s

    @property
    def level_force(self) -> complex:
        """The force across up, first and second axis of the frame, m/s²."""
        return complex(self.force[0], self.force[1])


class GyroFrame:
    """Stabilises a level frame by the gyro, and averages the force in it.

    `axes` are the frame's axes in body axes; the third is up, except for short accelerations.
    `restarts` counts the restarts of the frame, after a gap or a step back in time.
    """

    def __init__(self) -> None:
        self._last: ImuSample | None = None
        self.axes: Axes | None = None
        self.restarts = 0
        self._levelled = self._turned = self._seconds = 0.0
        self._force: Triple = (0.0, 0.0, 0.0)

    def add(self, sample: ImuSample, bias: Triple) -> Tick | None:
        """Add an IMU sample and the gyro's bias (rad/s); return a tick when it is complete."""
        stamp, (fx, fy, fz), (p, q, r) = sample[:3]
        if not 0.0 < fx * fx + fy * fy + fz * fz < math.inf or not math.isfinite(p + q + r):
            return None
        last, self._last = self._last, sample
        seconds = math.inf if last is None else stamp - last.stamp
        if last is None or self.axes is None or not 0.0 < seconds <= STREAMS.longest_gyro_step:
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
        if abs(forward) < ACCELERATION.steepest:
            return None
        return Tick(stamp, seconds, (x, y, z), cmath.phase(forward), turned / seconds)

    def _level(self, force: Triple, seconds: float) -> None:
        """Tilt the frame slightly towards the force, whose long-term mean is up."""
        self._levelled = min(self._levelled + seconds, ACCELERATION.levelling)
        size = length(force)
        if size <= 0.0:
            return
        share = seconds / self._levelled / size
        # The frame's up turns towards the force about up x force, in body axes.
        lean = self.to_body((-force[1] * share, force[0] * share, 0.0))
        back = scaled(lean, -1.0)
        assert self.axes is not None
        first, second, _ = (unit_triple(propagated(axis, back)) for axis in self.axes)
        self.axes = (first, second, cross(first, second))


class Chord(NamedTuple):
    """A straight piece of the path."""

    stamp: float  # of the end, on the clock of the fixes, seconds
    east: float
    north: float
    """Middle, metres."""
    course: float  # direction of travel, ENU, radians
    gap: float  # yaw of the compass minus course, radians, not unwrapped
    gyro_gap: float  # the same for the gyro's yaw, with an arbitrary zero
    sigma: float  # of the course, radians
    metres: float  # length

    @property
    def backwards(self) -> Chord:
        """The same chord of a reversing vehicle."""
        angles = self.course, self.gap, self.gyro_gap
        course, gap, gyro_gap = (math.remainder(each + math.pi, math.tau) for each in angles)
        return self._replace(course=course, gap=gap, gyro_gap=gyro_gap)


class Chords:
    """Makes chords from fixes and yaws; `delay` is the latency of the fixes, seconds."""

    def __init__(self) -> None:
        self.delay = SPEED.receiver_delay
        self._looked: deque[tuple[Tick, complex]] = deque(maxlen=COURSE.remembered)
        self._sum = 0j
        self._anchor: PositionSample | None = None
        self._waiting: deque[PositionSample | VelocitySample] = deque(maxlen=64)
        self._place = (0.0, 0.0)
        self._velocity: VelocitySample | None = None
        self._driven = 0.0  # metres since the last chord by velocity
        self._placed_at = -math.inf

    def add_yaw(self, yaw: float) -> None:
        """Add a yaw of the compass, radians, to the present tick."""
        self._sum += cmath.exp(1j * yaw)

    def add_tick(self, tick: Tick) -> list[Chord]:
        """Add a complete tick; return the chords that can be made now."""
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
        """Add a fix or a velocity, if it is finite."""
        if all(math.isfinite(value) for value in fix):
            self._waiting.append(fix)

    def restart(self) -> None:
        """Forget all yaws: the gyro's frame has changed."""
        self._looked.clear()
        self._waiting.clear()
        self._anchor = self._velocity = None
        self._driven = 0.0
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
        # The next chord starts at another fix, so that an error of this fix counts once.
        self._anchor = fix if chord is None else None
        return chord

    def _by_velocity(self, fix: VelocitySample) -> Chord | None:
        before, self._velocity = self._velocity, fix
        speed = math.hypot(fix.east, fix.north)
        seconds = math.inf if before is None else fix.stamp - before.stamp
        if not 0.0 < seconds <= COURSE.longest or speed <= 0.0:
            return None
        shift = seconds * complex(fix.east, fix.north)
        if fix.stamp - self._placed_at > COURSE.longest:
            x, y = self._place
            self._place = (x + shift.real, y + shift.imag)
        self._driven += abs(shift)
        if self._driven < COURSE.shortest:
            return None
        ahead = shift / abs(shift) * self._driven
        self._driven = 0.0
        span = fix.stamp - 0.5, fix.stamp + 0.1
        return self._chord(span, self._place, ahead, fix.sigma / speed)

    def _chord(
        self, span: tuple[float, float], place: tuple[float, float], shift: complex, sigma: float
    ) -> Chord | None:
        """Return the chord of a displacement, metres, if the path is straight with a compass."""
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
        course = cmath.phase(shift)
        compass_yaw = cmath.phase(sum(compass / abs(compass) for _, compass in among))
        gyro_yaw = cmath.phase(sum(cmath.exp(1j * tick.yaw) for tick, _ in among))
        return Chord(
            span[1],
            *place,
            course,
            math.remainder(compass_yaw - course, math.tau),
            math.remainder(gyro_yaw - course, math.tau),
            sigma,
            abs(shift),
        )


@dataclass(frozen=True, eq=False)
class CourseOffset:
    """Offset of the compass against course."""

    offset: float
    sigma: float
    """Constant part of the yaw of the compass minus course, and its sigma, radians."""
    metres: float  # length of all chords
    sectors: int  # sectors of course with chords, of eight


def fit_course_offset(chords: Sequence[Chord]) -> CourseOffset | None:
    """Fit the offset to chords in the order of their stamps; None until there are enough."""
    count = len(chords)
    if count < COURSE.fewest:
        return None
    _, east, north, psi, gaps, _, sigma, metres = np.array(chords).T
    start = _cluster(gaps)
    gap = wrap_angle(gaps - start)
    waves = (np.cos(psi), np.sin(psi), np.cos(2.0 * psi), np.sin(2.0 * psi))
    design = np.column_stack([np.ones(count), *waves])
    prior = np.diag([1e-3, *4 * [1.0 / COURSE.wave_sigma]]) ** 2
    distance = np.hypot(east[:, None] - east, north[:, None] - north)
    alike = np.exp(-distance / STREET_LENGTH)
    noise = sigma**2 + COURSE.noise**2
    # Observations are counted by place: repeated passes add no independent information.
    squares = np.floor(np.column_stack([east, north]) / STREET_LENGTH)
    places = len(np.unique(squares, axis=0))
    weight, street = np.ones(count), COURSE.street
    for _ in range(MOUNTING.rounds):
        # A chord with a low weight has a larger local disturbance.
        root = np.sqrt(weight)
        spread = (street**2 * alike + np.diag(noise)) / np.outer(root, root)
        solved = np.linalg.solve(spread, np.column_stack([design, gap]))
        covariance = np.linalg.inv(design.T @ solved[:, :5] + prior)
        values = covariance @ (design.T @ solved[:, 5])
        left = gap - design @ values
        weight = (COURSE.freedom + 1.0) / (COURSE.freedom + left**2 / (street**2 + noise))
        own = np.sqrt(weight) * left
        square = float(own @ np.linalg.solve(alike + np.diag(noise / street**2), own)) / count
        pseudo = COURSE.prior_weight
        street = math.sqrt((pseudo * COURSE.street**2 + places * square) / (pseudo + places))
    # Passes of a street are not independent: each place counts once, with its first chord.
    first: list[int] = []
    for each in range(count):
        if not first or distance[each, first].min() > 0.5 * STREET_LENGTH:
            first.append(each)
    own_spread = spread[np.ix_(first, first)]
    information = design[first].T @ np.linalg.solve(own_spread, design[first]) + prior
    # Iron that is present for a part of the drive causes a swing, and an error of the offset that
    # the scatter of streets does not show.
    swing = float(np.sum(values[1:] ** 2) - np.trace(covariance[1:, 1:]))
    covariance[0, 0] = max(covariance[0, 0], np.linalg.inv(information)[0, 0])
    covariance[0, 0] += COURSE.swing_share**2 * max(0.0, swing)
    return CourseOffset(
        float(wrap_angle(start + values[0])),
        math.sqrt(covariance[0, 0]),
        float(np.sum(metres)),
        len(np.unique(np.round(psi / math.tau * SECTORS) % SECTORS)),
    )


def _cluster(gaps: FloatArray) -> float:
    """Return the centre of most gaps: a reweighted mean, from the densest value."""
    grid = np.linspace(-math.pi, math.pi, 72, endpoint=False)
    near = np.exp(-((wrap_angle(gaps - grid[:, None]) / math.radians(15.0)) ** 2))
    centre = float(grid[np.argmax(near.sum(axis=1))])
    for _ in range(10):
        gap = wrap_angle(gaps - centre)
        weight = 1.0 / (1.0 + (gap / COURSE.street) ** 2)
        centre += float(weight @ gap / np.sum(weight))
    return centre
