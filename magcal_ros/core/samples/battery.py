"""The current of a battery while a robot turns."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np

from magcal_ros.core.geometry.arrays import FloatArray, freeze
from magcal_ros.core.samples.samples_tuning import STREAMS

Messages: TypeAlias = Sequence[tuple[float, float]]
"""Stamps, seconds, and currents, amperes."""
SILENT = 1.5  # seconds without a message after which a current counts as unknown
LEAST = 0.05
"""Fraction of the messages whose current may be below the reference: braking motors may return
current, which then passes through zero."""


@dataclass(frozen=True, eq=False)
class Battery:
    """The current of a battery over time.

    A calibration refers to the robot at the current `reference`, the least current of the turn. It
    is usually that of the electronics without motors, whose constant field is part of the hard
    iron. Motors that hold the robot at rest add the field of the current beyond the reference.
    """

    time: FloatArray  # stamps, seconds, increasing. Shape (k,).
    current: FloatArray  # amperes of a constant sign convention. Shape (k,).
    reference: float  # amperes

    def __post_init__(self) -> None:
        freeze(self, time=(-1,), current=(len(self.time),))

    @property
    def largest(self) -> float:
        """The largest current, A, without its sign."""
        return float(np.abs(self.current).max())


def usable_current(current: float) -> float:
    """Return a current, amperes; NaN if no battery has it, such as a driver's largest number."""
    return current if abs(current) <= STREAMS.largest_current else math.nan


def newest_at(messages: Messages, stamp: float) -> float:
    """Return the newest value at a stamp, by messages in their order; NaN if none is recent."""
    row = bisect_right(messages, (stamp, math.inf))
    received, value = messages[row - 1] if row else (-math.inf, math.nan)
    return value if stamp - received < SILENT else math.nan


def battery_of(messages: Messages, begin: float, end: float) -> Battery | None:
    """Return the current between two moments, from messages.

    None if it was not measured throughout, or if it is constant: some drivers publish a constant.
    """
    known = {stamp: usable_current(current) for stamp, current in messages}
    known = {each: current for each, current in known.items() if math.isfinite(each + current)}
    rows = np.array(sorted(known.items())).reshape(-1, 2)
    rows = rows[(rows[:, 0] > begin - SILENT) & (rows[:, 0] < end + SILENT)]
    gaps = np.diff(np.concatenate([[begin], rows[:, 0], [end]]))
    if gaps.max() > SILENT or not np.ptp(rows[:, 1]):
        return None
    by_size = rows[np.argsort(np.abs(rows[:, 1])), 1]
    reference = float(by_size[int(LEAST * len(rows))])
    return Battery(rows[:, 0], rows[:, 1], reference)


def with_one_reference(batteries: Sequence[Battery | None]) -> list[Battery | None]:
    """Return the currents of several turns beyond the same reference, the least of all.

    All are None if one turn has no current: its field of the motors would have no explanation.
    """
    known = [each for each in batteries if each is not None]
    if len(known) < len(batteries):
        return [None] * len(batteries)
    least = min((each.reference for each in known), key=abs)
    return [replace(each, reference=least) for each in known]
