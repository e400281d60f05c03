"""Straight chords of the path, and the compass against their course.

    r_i = o + a1 cos psi + b1 sin psi + a2 cos 2psi + b2 sin 2psi + g(p_i) + n_i

r is the yaw of the compass minus the course psi, o the offset, and g the local disturbance at the
place p_i with covariance s² exp(-|p_i - p_j|/30 m). The fit is generalised least squares with
Student weights, in which all chords of a place are one observation. The sigma includes a fraction
of the swing.
"""

from __future__ import annotations

import cmath
import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from magcal_ros.core.driving.driving_tuning import COURSE, MOUNTING, SPEED
from magcal_ros.core.driving.gyro_frame import Tick
from magcal_ros.core.geometry.attitude import wrap_angle
from magcal_ros.core.geometry.slope import Slope
from magcal_ros.core.knowledge import CLEAR, STREET_LENGTH
from magcal_ros.core.samples.streams import PositionSample, VelocitySample

SECTORS = 8


class Chord(NamedTuple):
    """A straight piece of the path."""

    stamp: float  # of the end, on the clock of the fixes, seconds
    east: float
    north: float
    """Its end, metres."""
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
        self._looked: deque[tuple[Tick, complex]] = deque(maxlen=64)
        self._waiting: deque[PositionSample | VelocitySample] = deque(maxlen=64)
        self._sum = 0j
        self._place = self._path = 0j  # the newest place, and the sum of the velocities, metres
        self._placed_at = -math.inf
        self.restart()

    def restart(self) -> None:
        """Forget all yaws: the gyro's frame has changed."""
        self._looked.clear()
        self._waiting.clear()
        self._start: tuple[float, complex] | None = None
        self._velocity: VelocitySample | None = None

    def add_yaw(self, yaw: float) -> None:
        """Add a yaw of the compass, radians, to the present tick."""
        self._sum += cmath.exp(1j * yaw)

    def add_tick(self, tick: Tick) -> list[Chord]:
        """Add a complete tick; return the chords that can be made now."""
        self._looked.append((tick, self._sum))
        self._sum = 0j
        made: list[Chord | None] = []
        while self._waiting and self._waiting[0].stamp - self.delay <= tick.stamp:
            made.append(self._take(self._waiting.popleft()))
        return [chord for chord in made if chord is not None]

    def add_fix(self, fix: PositionSample | VelocitySample) -> None:
        """Add a fix or a velocity, if it is finite."""
        if all(math.isfinite(value) for value in fix):
            self._waiting.append(fix)

    def _take(self, fix: PositionSample | VelocitySample) -> Chord | None:
        at, velocity = complex(fix.east, fix.north), self._velocity
        if isinstance(fix, PositionSample):
            self._place, self._placed_at = at, fix.stamp
            if velocity is not None and abs(fix.stamp - velocity.stamp) <= COURSE.longest:
                return None
            return self._to(fix.stamp, at, COURSE.relative_sigma)
        seconds = math.inf if velocity is None else fix.stamp - velocity.stamp
        self._velocity = fix
        if not 0.0 < seconds <= COURSE.longest:
            self._start = None
            return None
        self._path += seconds * at
        if fix.stamp - self._placed_at > COURSE.longest:
            self._place += seconds * at
        return self._to(fix.stamp, self._path, fix.sigma * seconds)

    def _to(self, stamp: float, place: complex, error: float) -> Chord | None:
        """Return the chord to a place with a relative error, metres.

        The path must be straight, and have a yaw of the compass in each tick.
        """
        start = self._start
        if start is None or not 0.0 < stamp - start[0] <= COURSE.longest:
            self._start = (stamp, place)
            return None
        shift = place - start[1]
        if abs(shift) < COURSE.shortest:
            return None
        self._start = (stamp, place)
        sigma = math.sqrt(2.0) * error / abs(shift)
        first, last = start[0] - self.delay, stamp - self.delay
        among = [
            (tick, compass)
            for tick, compass in self._looked
            if tick.stamp > first and tick.stamp - tick.seconds < last
        ]
        is_whole = bool(among) and (
            among[0][0].stamp - among[0][0].seconds <= first + 0.3
            and among[-1][0].stamp >= last - 0.3
        )
        turned = sum(abs(tick.turn_rate) * tick.seconds for tick, _ in among)
        is_straight = turned <= COURSE.largest_turn and all(compass for _, compass in among)
        if sigma > COURSE.largest_sigma or not is_whole or not is_straight:
            return None
        course = cmath.phase(shift)
        compass_yaw = cmath.phase(sum(compass / abs(compass) for _, compass in among))
        gyro_yaw = cmath.phase(sum(cmath.exp(1j * tick.yaw) for tick, _ in among))
        gaps = [math.remainder(yaw - course, math.tau) for yaw in (compass_yaw, gyro_yaw)]
        return Chord(
            stamp, self._place.real, self._place.imag, course, gaps[0], gaps[1], sigma, abs(shift)
        )


def is_hull(chords: Sequence[Chord]) -> bool:
    """Whether the course does not follow the turns of the gyro: a hull is likelier than wheels."""
    stamp, course, gyro_gap = np.array([(c.stamp, c.course, c.gyro_gap) for c in chords]).T
    near = np.diff(stamp) <= COURSE.longest
    turned = wrap_angle(np.diff(gyro_gap + course)[near])
    # Modulo half a turn, because the sign of the speed may be wrong for a while.
    missed = 0.5 * wrap_angle(2.0 * np.diff(gyro_gap)[near])
    share = Slope(math.inf)
    share.add(
        float(turned @ missed), float(turned @ turned), float(missed @ missed), count=len(missed)
    )
    # A prior without drift: a few chords may agree by chance.
    weight = COURSE.prior_weight
    share.add(0.0, 0.0, weight * COURSE.largest_turn**2, count=weight)
    return share.log_odds > CLEAR


@dataclass(frozen=True, eq=False)
class CourseOffset:
    """Offset of the compass against course."""

    offset: float
    sigma: float
    """Constant part of the yaw of the compass minus course, and its sigma, radians."""
    metres: float  # length of all chords
    sectors: int  # sectors of course with chords, of eight


def fit_course_offset(chords: Sequence[Chord]) -> CourseOffset | None:
    """Fit the offset to chords; None until there are enough, and for a drifting hull."""
    if len(chords) < COURSE.fewest or is_hull(chords):
        return None
    _, east, north, psi, gaps, _, sigma, metres = np.array(chords).T
    # The centre of most gaps: of them, the one with the smallest sum of logarithmic distances.
    far = (wrap_angle(gaps[:, None] - gaps) / COURSE.street) ** 2
    start = float(gaps[np.argmin(np.log1p(far).sum(axis=1))])
    gap = wrap_angle(gaps - start)
    # Repeated passes of a place add no independent information: together they are one observation.
    squares = np.floor(np.column_stack([east, north]) / STREET_LENGTH)
    _, first, cell = np.unique(squares, axis=0, return_index=True, return_inverse=True)
    cell = cell.ravel()
    waves = (np.cos(psi), np.sin(psi), np.cos(2.0 * psi), np.sin(2.0 * psi))
    share = 1.0 / (1.0 + (gap / COURSE.street) ** 2)
    share /= np.bincount(cell, share)[cell]
    columns = (east, north, sigma**2 + COURSE.noise**2, gap, np.ones(len(gap)), *waves)
    means = np.array([np.bincount(cell, share * column) for column in columns])
    east, north, noise, gap, design = *means[:4], means[4:].T
    distance = np.hypot(east[:, None] - east, north[:, None] - north)
    alike = np.exp(-distance / STREET_LENGTH)
    prior = np.diag([1e-3, *4 * [1.0 / COURSE.wave_sigma]]) ** 2
    weight, street, count = np.ones(len(gap)), COURSE.street, len(gap)
    for _ in range(MOUNTING.rounds):
        # A place with a low weight has a larger local disturbance.
        root = np.sqrt(weight)
        spread = (street**2 * alike + np.diag(noise)) / np.outer(root, root)
        solved = np.linalg.solve(spread, np.column_stack([design, gap]))
        covariance = np.linalg.inv(design.T @ solved[:, :5] + prior)
        values = covariance @ (design.T @ solved[:, 5])
        left = gap - design @ values
        weight = (COURSE.freedom + 1.0) / (COURSE.freedom + left**2 / (street**2 + noise))
        own = np.sqrt(weight) * left
        square = float(own @ np.linalg.solve(alike + np.diag(noise / street**2), own))
        pseudo = COURSE.prior_weight
        street = math.sqrt((pseudo * COURSE.street**2 + square) / (pseudo + count))
    # So do passes in another direction.
    once = np.column_stack([np.ones(len(psi)), *waves])[first]
    information = once.T @ np.linalg.solve(spread, once) + prior
    covariance[0, 0] = max(covariance[0, 0], np.linalg.inv(information)[0, 0])
    # Iron that is present for a part of the drive causes a swing, and an error of the offset that
    # the scatter of streets does not show.
    swing = float(np.sum(values[1:] ** 2) - np.trace(covariance[1:, 1:]))
    covariance[0, 0] += COURSE.swing_share**2 * max(0.0, swing)
    return CourseOffset(
        float(wrap_angle(start + values[0])),
        math.sqrt(covariance[0, 0]),
        float(np.sum(metres)),
        len(np.unique(np.round(psi / math.tau * SECTORS) % SECTORS)),
    )
