"""Stamps of a buffer that is read now and then, in place of those of the measurements."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np

from magcal_ros.core.geometry.arrays import FloatArray


@dataclass(frozen=True)
class BurstTuning:
    """When stamps come in bursts."""

    share: float = 0.5  # of the time that passes in gaps
    longer: float = 5.0  # how many usual gaps such a one lasts
    fewest: int = 10  # gaps from which they are more than pauses
    alike: float = 0.4
    apart: float = 0.05
    """Share of them that are no further than this off the usual one, relative: a buffer is read by
    the clock."""
    each: float = 3.0
    """Samples that a burst has at least; pairs are rather messages that come twice."""
    straight: float = 1.5
    """How many usual gaps the stamps may be off an even rate, from the earliest to the latest;
    whole bursts are missing beyond."""
    harmful: float = 0.1  # seconds between bursts from which a running robot's user is told
    memory: float = 100.0  # gaps over which the usual one is averaged while samples come


BURSTS = BurstTuning()


def long_gaps(time: FloatArray) -> FloatArray:
    """Return the gaps between bursts, seconds; empty where most of the time passes otherwise.

    A few long gaps are pauses of a recording, and no bursts.

    `time` (n,) holds at least two stamps in their order.
    """
    gaps = np.diff(time)
    # Stamps of one buffer may be equal but for rounding: then the median alone parts nothing.
    long = gaps[gaps > max(BURSTS.longer * float(np.median(gaps)), float(np.mean(gaps)))]
    often = len(long) >= BURSTS.fewest
    return long if often and long.sum() > BURSTS.share * float(time[-1] - time[0]) else long[:0]


def bursts_in_words(long: FloatArray) -> str:
    """Say what is wrong with stamps that leave such gaps, and what to do about it."""
    return (
        f"the stamps come in bursts, {float(np.median(long)):.2f} s apart: stamp each sample when "
        "it is measured, not when a buffer is read"
    )


def bursts_of_a_turn(time: FloatArray) -> str:
    """Say that the stamps of a turn come in bursts; empty where they do not.

    Pauses are thinned out of a turn before it is fitted, which leaves gaps of all lengths.

    `time` (n,) holds the stamps in their order.
    """
    long = long_gaps(time) if len(time) > BURSTS.fewest else time[:0]
    if not len(long):
        return ""
    usual = float(np.median(long))
    alike = float(np.mean(np.abs(long - usual) < BURSTS.apart * usual))
    return bursts_in_words(long) if alike > BURSTS.alike else ""


def evenly(time: FloatArray) -> FloatArray:
    """Return stamps (n,) spread evenly in the order in which they came, by a line through them."""
    rank = np.arange(len(time), dtype=np.float64)
    return np.asarray(np.polyval(np.polyfit(rank, time, 1), rank))


def spread_bursts(time: FloatArray) -> FloatArray | None:
    """Return stamps that came in bursts as they would have been; None where that is not known.

    The sensor is taken to have measured at one rate all along. No sample was measured after its
    stamp, and the newest of a buffer just before it was read.

    `time` (n,) are the stamps of a whole recording, in the order in which they came, seconds. None
    as well if samples are missing, or time was set back.
    """
    long = long_gaps(time) if len(time) > BURSTS.fewest else time[:0]
    if not len(long) or len(time) < BURSTS.each * len(long):
        return None
    even = evenly(time - time[0])
    late = time - time[0] - even
    if np.ptp(late) > BURSTS.straight * float(np.median(long)):
        return None
    return np.asarray(time[0] + even + late.min())


class BurstWatch:
    """Watches whether stamps come in bursts, gap after gap."""

    def __init__(self) -> None:
        self._now = self._usual = 0.0
        self._count = 0
        self._long: deque[tuple[float, float]] = deque(maxlen=BURSTS.fewest)

    def add(self, gap: float) -> None:
        """Take the seconds from the stamp before."""
        self._count += 1
        self._now += gap
        bound = BURSTS.longer * self._usual
        if self._count > 1 and gap > bound:
            self._long.append((self._now, gap))
            gap = bound
        self._usual += (gap - self._usual) / min(self._count, BURSTS.memory)

    @property
    def words(self) -> str:
        """Say that they do, and what to do about it; empty where it does no harm."""
        if len(self._long) < BURSTS.fewest:
            return ""
        long = np.array([gap for _, gap in self._long])
        since, first = self._long[0]
        passed = self._now - since + first
        is_harmful = float(np.median(long)) > BURSTS.harmful
        return bursts_in_words(long) if is_harmful and long.sum() > BURSTS.share * passed else ""
