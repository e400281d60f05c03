"""Whether a vehicle goes where it looks: boats and hovering things do not."""

from __future__ import annotations

import math
from collections import deque

import numpy as np

from magcal_ros.core.driving.chords import Chord
from magcal_ros.core.driving.driving_tuning import CourseTuning


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

    def __init__(self, tuning: CourseTuning | None = None) -> None:
        self._tuning = tuning or CourseTuning()
        self._seen: deque[tuple[float, float, float]] = deque(maxlen=120)
        self.scatter = 0.0
        self.judged = self.drifted = 0

    def add(self, chord: Chord) -> bool:
        """Take a chord; returns whether the vehicle goes where it looks, as far as is known."""
        seen = self._seen
        gap = chord.gyro_gap
        if seen:
            gap = seen[-1][1] + math.remainder(gap - seen[-1][1], math.tau)
        seen.append((chord.stamp, gap, chord.sigma))
        while chord.stamp - seen[0][0] > self._tuning.drifting_span:
            seen.popleft()
        if len(seen) < self._tuning.drifting_chords:
            return not self.is_drifting
        time, gaps, sigmas = np.array(seen).T
        line = np.polynomial.polynomial.polyfit(time - time[0], gaps, 1)
        left = gaps - np.polynomial.polynomial.polyval(time - time[0], line)
        # What the receiver's own noise scatters is no drift.
        square = (1.4826 * float(np.median(np.abs(left)))) ** 2 - float(np.median(sigmas)) ** 2
        self.scatter = math.sqrt(max(0.0, square))
        self.judged += 1
        self.drifted += self.scatter > self._tuning.drifting
        return not self.is_drifting

    @property
    def is_drifting(self) -> bool:
        """Whether the course is not the heading for a good part of the way."""
        return self.drifted > 3 and self.drifted > 0.2 * self.judged

    def restart(self) -> None:
        """Forget the newest chords: the gyro's zero is another one."""
        self._seen.clear()
