"""Stamps that come in bursts, as where a buffer is read now and then."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np

from magcal_ros.core.geometry.arrays import FloatArray, accumulated


@dataclass(frozen=True)
class BurstTuning:
    """When stamps come in bursts."""

    share: float = 0.5  # of the time that passes in gaps
    longer: float = 5.0  # how many usual gaps such a one lasts
    fewest: int = 10  # gaps from which they are more than pauses
    alike: float = 0.4
    apart: float = 0.25
    """Share within this relative distance of the usual one: buffers are read by the clock."""
    each: float = 3.0
    """Samples that a burst has at least; pairs are rather messages that come twice."""
    straight: float = 1.5
    """How many usual gaps the stamps may be off an even rate, from the earliest to the latest;
    whole bursts are missing beyond."""
    harmful: float = 0.1  # seconds between bursts from which a running robot's user is told
    watched: int = 3000  # gaps that are looked at while samples come


BURSTS = BurstTuning()


def long_gaps(time: FloatArray) -> FloatArray:
    """Return the gaps between bursts, seconds; empty where most of the time passes otherwise.

    A few long gaps are pauses of a recording, and no bursts. Pauses are thinned out of a turn
    before it is fitted, which leaves gaps of all lengths. `time` (n,) holds the stamps in their
    order.
    """
    gaps = np.diff(time)
    if len(gaps) < BURSTS.fewest:
        return gaps[:0]
    # Stamps of one buffer may be equal but for rounding: then the median alone parts nothing.
    long = gaps[gaps > max(BURSTS.longer * float(np.median(gaps)), float(np.mean(gaps)))]
    if len(long) < BURSTS.fewest or long.sum() <= BURSTS.share * float(time[-1] - time[0]):
        return gaps[:0]
    usual = float(np.median(long))
    alike = float(np.mean(np.abs(long - usual) < BURSTS.apart * usual))
    return long if alike > BURSTS.alike else gaps[:0]


def bursts_in_words(time: FloatArray) -> str:
    """Say that stamps (n,) come in bursts, and what to do about it; empty where they do not."""
    long = long_gaps(time)
    if not len(long):
        return ""
    return (
        f"the stamps come in bursts, {float(np.median(long)):.2f} s apart: stamp each sample when "
        "it is measured, not when a buffer is read"
    )


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
    long = long_gaps(time)
    if not len(long) or len(time) < BURSTS.each * len(long):
        return None
    even = evenly(time - time[0])
    late = time - time[0] - even
    if np.ptp(late) > BURSTS.straight * float(np.median(long)):
        return None
    return np.asarray(time[0] + even + late.min())


def spread_each(time: FloatArray) -> FloatArray:
    """Return stamps (n,) that come in bursts, each burst spread over the time before it was read.

    For a recording in which samples are missing: a line through all stamps would be wrong by as
    much as is missing. A buffer that held more than usual overlaps the one before.
    """
    gaps = np.diff(time)
    first = np.append(0, np.flatnonzero(gaps >= long_gaps(time).min()) + 1)
    counts = np.diff(np.append(first, len(time)))
    # Before the first one no gap is known; where bursts are missing, a gap is too long.
    period = float(np.median(gaps[first[1:] - 1] / counts[1:]))
    last = np.repeat(first + counts - 1, counts)
    return np.asarray(time[last] - period * (last - np.arange(len(time))))


class BurstWatch:
    """Watches whether stamps come in bursts, gap after gap."""

    def __init__(self) -> None:
        self._gaps: deque[float] = deque(maxlen=BURSTS.watched)

    def add(self, gap: float) -> None:
        """Take the seconds from the stamp before."""
        self._gaps.append(gap)

    @property
    def words(self) -> str:
        """Say that they do, and what to do about it; empty where it does no harm."""
        time = accumulated(np.array(self._gaps))
        long = long_gaps(time)
        is_harmful = len(long) > 0 and float(np.median(long)) > BURSTS.harmful
        return bursts_in_words(time) if is_harmful else ""
