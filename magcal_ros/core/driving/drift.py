"""Whether a vehicle goes where it looks: boats and hovering things do not."""

from __future__ import annotations

import math
from collections import deque
from typing import NamedTuple

import numpy as np

from magcal_ros.core.driving.chords import Chord
from magcal_ros.core.driving.course_tuning import DriftTuning


class _Seen(NamedTuple):
    """A chord: seconds, and radians that go on beyond a whole turn.

    `heading` is the gyro's yaw, `gap` what it is off course, `lead` what it is off the compass.
    """

    stamp: float
    gap: float
    lead: float
    heading: float
    sigma: float


class DriftWatch:
    """Compares course and gyro over a minute of straight driving.

    Parameters
    ----------
    tuning : CourseTuning, optional
        What is taken for granted.

    Attributes
    ----------
    scatter : float
        Radians, of course less the gyro's yaw about a steady drift of the gyro; zero until known.
    """

    def __init__(self, tuning: DriftTuning | None = None) -> None:
        self._tuning = tuning or DriftTuning()
        self._seen: deque[_Seen] = deque(maxlen=120)
        self.scatter = 0.0
        self.judged = self.drifted = 0

    def add(self, chord: Chord) -> bool:
        """Take a chord; returns whether the vehicle goes where it looks, as far as is known."""
        seen, gap = self._seen, chord.gyro_gap
        angles = gap, gap - chord.gap, gap + chord.course
        if seen:
            angles = _going_on(seen[-1], angles)
        seen.append(_Seen(chord.stamp, *angles, chord.sigma))
        while chord.stamp - seen[0].stamp > self._tuning.span:
            seen.popleft()
        if len(seen) >= self._tuning.chords:
            self.judged += 1
            self.drifted += self._drifts()
        return not self.is_drifting

    def _drifts(self) -> bool:
        """Whether the newest chords are those of a hull that goes where it does not look."""
        time, gaps, leads, headings, sigmas = np.array(self._seen).T
        since = time - time.mean()
        slope, lead = (float(since @ each / (since @ since)) for each in (gaps, leads))
        # The gyro leads the compass by its bias, and not by what a hull turns.
        margin = self._tuning.bias
        bias = since * min(max(slope, min(lead, 0.0) - margin), max(lead, 0.0) + margin)
        left = gaps - bias
        left -= np.median(left)
        # What the receiver's own noise scatters is no drift.
        square = (1.4826 * float(np.median(np.abs(left)))) ** 2 - float(np.median(sigmas)) ** 2
        self.scatter = math.sqrt(max(0.0, square))
        if self.scatter > self._tuning.scatter:
            return True
        turned = headings - bias
        turned -= turned.mean()
        square = float(turned @ turned)
        if math.sqrt(square / len(turned)) < self._tuning.turned:
            return False
        # A receiver's noise knows nothing of the hull's turns; a course that stays leaves them out.
        return float(turned @ left) / square > self._tuning.share

    @property
    def is_drifting(self) -> bool:
        """Whether the course is not the heading for a good part of the way."""
        return self.drifted > 3 and self.drifted > 0.2 * self.judged

    def restart(self) -> None:
        """Forget the newest chords: the gyro's zero is another one."""
        self._seen.clear()


def _going_on(last: _Seen, angles: tuple[float, float, float]) -> tuple[float, float, float]:
    """Return angles as the nearest to those before."""
    gap, lead, heading = (
        before + math.remainder(angle - before, math.tau)
        for before, angle in zip((last.gap, last.lead, last.heading), angles, strict=True)
    )
    return gap, lead, heading
