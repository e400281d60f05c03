"""Which headings of a turn have been seen, and where the largest gap is."""

from __future__ import annotations

import math
from bisect import bisect_right
from dataclasses import dataclass

import numpy as np

from magcal_ros.core.errors import Refusal
from magcal_ros.core.geometry.arrays import BoolArray, FloatArray, IntArray, integral
from magcal_ros.core.geometry.attitude import unit, wrap_angle
from magcal_ros.core.geometry.shapes import fit_circle_in_space
from magcal_ros.core.samples.samples_tuning import COVERAGE

BINS, THINNED = 36, 180  # bins of the circle, to display a turn and to thin it


@dataclass(frozen=True, eq=False)
class Coverage:
    """Which headings of the turn were seen."""

    filled: BoolArray  # bins of yaw relative to the first sample, counter-clockwise. Shape (36,).
    arc: float
    """Radians seen: the full turn minus the largest gap, if that exceeds a few sample spacings."""
    gap: float  # radians of the largest gap
    gap_centre: float
    """Radians from the start to the middle of the largest gap, positive to the left."""
    turned: float  # radians turned in all, positive counter-clockwise

    @classmethod
    def nothing(cls) -> Coverage:
        """Return the coverage before the robot has moved."""
        return cls(np.zeros(BINS, dtype=np.bool_), 0.0, 2.0 * math.pi, math.pi, 0.0)

    @classmethod
    def of(cls, progress: FloatArray) -> Coverage:
        """Return the coverage of unwrapped yaw (n,), radians from the start, left positive."""
        if len(progress) < 2:
            return cls.nothing()
        around = np.sort(np.mod(progress, 2.0 * math.pi))
        gaps = np.diff(np.append(around, around[0] + 2.0 * math.pi))
        widest = int(np.argmax(gaps))
        gap = float(gaps[widest])
        filled = np.zeros(BINS, dtype=np.bool_)
        filled[np.minimum((around * (BINS / (2.0 * math.pi))).astype(int), BINS - 1)] = True
        centre = float(wrap_angle(around[widest] + 0.5 * gap))
        turned = float(progress[-1] - progress[0])
        arc = 2.0 * math.pi - gap
        spacing = arc / max(int(np.count_nonzero(gaps)) - 1, 1)
        is_full = gap < min(COVERAGE.spacings * spacing, COVERAGE.largest_gap)
        return cls(filled, 2.0 * math.pi if is_full else arc, gap, centre, turned)

    @property
    def is_complete(self) -> bool:
        """Whether every heading was seen, up to small gaps."""
        return self.gap <= COVERAGE.largest_gap

    @property
    def has_turned(self) -> bool:
        """Whether the robot has turned by more than noise at rest."""
        return self.arc >= math.radians(5.0)

    @property
    def hole_in_words(self) -> str:
        """The largest gap in words; empty when the turn is complete."""
        if self.is_complete:
            return ""
        size = math.degrees(self.gap)
        if not self.has_turned:
            return "the robot has not turned yet"
        away = math.degrees(self.gap_centre)
        side = "left" if away >= 0.0 else "right"
        if abs(away) > 175.0:
            return f"missing: {size:.0f}° opposite the start"
        return f"missing: {size:.0f}°, centred {abs(away):.0f}° to the {side} of the start"

    @property
    def advice(self) -> str:
        """Which way to turn from here to close the largest gap; empty when nothing is missing."""
        if self.is_complete:
            return ""
        away = float(wrap_angle(self.gap_centre - self.turned))
        side = "left" if away >= 0.0 else "right"
        return f"turn {side}, {math.degrees(self.gap):.0f}° missing"


def yaw_progress(
    time: FloatArray, field: FloatArray, force: FloatArray, rate: FloatArray | None
) -> FloatArray | None:
    """Return how far the robot has turned since the first sample.

    It is the field's phase on its circle. The gyro is used while no circle is visible, also where
    the field is too steep for one.

    `field` (n, 3) is in nominal body axes, with hard iron, tesla, `force` (n, 3) in m/s², and
    `rate` (n, 3) in rad/s. Returns unwrapped radians (n,), counter-clockwise positive; None while
    neither sensor shows a turn.
    """
    if len(time) < 5:
        return None
    up = unit(force.mean(axis=0))
    by_gyro = None if rate is None else integral(time, rate @ up)
    if by_gyro is None or np.ptp(by_gyro) >= COVERAGE.gyro_leads_until:
        by_field = _magnetic_progress(field, up)
        if by_field is not None or by_gyro is None:
            return by_field
    drift = COVERAGE.largest_gyro_bias * float(time[-1] - time[0])
    return by_gyro if np.ptp(by_gyro) > COVERAGE.smallest_turn + drift else None


def _magnetic_progress(field: FloatArray, up: FloatArray) -> FloatArray | None:
    """Return minus the field's phase on its circle about `up`, unwrapped from the first sample."""
    spread = float(np.linalg.eigvalsh(np.cov(field.T))[-1])
    # Third differences contain little of the turn, up to half a radian from sample to sample.
    steps = np.diff(field, 3, axis=0)
    noise = math.sqrt(float(np.median(np.sum(steps**2, axis=1))) / 60.0)
    if math.sqrt(max(spread, 0.0)) < COVERAGE.spread_over_noise * noise:
        return None
    try:
        circle = fit_circle_in_space(field, up)
    except Refusal:
        return None
    if circle.radius < COVERAGE.smallest_radius:
        return None
    phase = np.unwrap(circle.phase(field))
    return np.asarray(phase[0] - phase)


def thin_to_equal_angles(progress: FloatArray, most: int | None = None) -> IntArray:
    """Choose samples so that pauses have no extra weight.

    A bin of headings keeps at most twice the median number of samples of a filled bin, evenly
    spread over the time in the bin; fewer if the total would exceed `most`.

    `progress` (n,) is the yaw of each sample, radians. At least one sample of each filled bin is
    kept. Returns increasing row numbers.
    """
    where = (np.mod(progress, math.tau) * (THINNED / math.tau)).astype(np.int64) % THINNED
    counts = np.bincount(where, minlength=THINNED)
    limit = max(2, int(2 * np.median(counts[counts > 0])))
    if most is not None:
        fewer = range(1, limit + 1)
        limit = max(1, bisect_right(fewer, most, key=lambda n: np.minimum(counts, n).sum()))
    order = np.argsort(where, kind="stable")
    kept = []
    for rows in np.split(order, np.cumsum(counts)[:-1]):
        if len(rows) > limit:
            rows = rows[np.linspace(0, len(rows) - 1, limit).astype(np.int64)]
        kept.append(rows)
    return np.sort(np.concatenate(kept))
