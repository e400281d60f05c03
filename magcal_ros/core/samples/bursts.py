"""Stamps that come in bursts, because samples are stamped when a buffer is read."""

from __future__ import annotations

import numpy as np

from magcal_ros.core.geometry.arrays import FloatArray
from magcal_ros.core.samples.samples_tuning import BURSTS


def long_gaps(time: FloatArray) -> FloatArray:
    """Return the gaps between bursts, seconds; empty if stamps (n,) do not come in bursts.

    A few long gaps are pauses of a recording. Thinning the pauses of a turn leaves gaps of all
    lengths. Neither are bursts.
    """
    gaps = np.diff(time)
    if len(gaps) < BURSTS.fewest:
        return gaps[:0]
    # The stamps of one buffer may be equal except for rounding: the median gap is then near zero.
    long = gaps[gaps > max(BURSTS.longer * float(np.median(gaps)), float(np.mean(gaps)))]
    if len(long) < BURSTS.fewest or long.sum() <= BURSTS.share * float(time[-1] - time[0]):
        return gaps[:0]
    usual = float(np.median(long))
    apart = float(np.median(np.abs(long - usual)))
    return long if apart < BURSTS.apart * usual else gaps[:0]


def bursts_in_words(time: FloatArray, shortest: float = 0.0) -> str:
    """Return a warning that stamps (n,) come in bursts, with a remedy; empty if they do not.

    Bursts less than `shortest` seconds apart are harmless.
    """
    long = long_gaps(time)
    if not len(long) or (apart := float(np.median(long))) <= shortest:
        return ""
    return (
        f"the stamps come in bursts, {apart:.2f} s apart: stamp each sample when it is measured, "
        "not when a buffer is read"
    )


def spread_bursts(time: FloatArray) -> FloatArray | None:
    """Return the stamps of a sensor with a constant rate, from stamps that come in bursts.

    No sample was measured after its stamp, and the newest of a buffer was measured just before the
    buffer was read. `time` (n,) are the stamps of a whole recording, in order of arrival, seconds.
    None if there are no bursts, samples are missing, or time was set back.
    """
    long = long_gaps(time)
    if not len(long) or len(time) < BURSTS.each * len(long):
        return None
    rank = np.arange(len(time), dtype=np.float64)
    even = np.polyval(np.polyfit(rank, time - time[0], 1), rank)
    late = time - time[0] - even
    if np.ptp(late) > BURSTS.straight * float(np.median(long)):
        return None
    return np.asarray(time[0] + even + late.min())


def spread_each(time: FloatArray) -> FloatArray:
    """Return stamps (n,) that come in bursts, each burst spread over the time before it was read.

    For a recording with missing samples, whose stamps do not lie on a line. A buffer with more
    samples than usual overlaps the previous one.
    """
    gaps = np.diff(time)
    first = np.append(0, np.flatnonzero(gaps >= long_gaps(time).min()) + 1)
    counts = np.diff(np.append(first, len(time)))
    # There is no gap before the first burst; where bursts are missing, a gap is too long.
    period = float(np.median(gaps[first[1:] - 1] / counts[1:]))
    last = np.repeat(first + counts - 1, counts)
    return np.asarray(time[last] - period * (last - np.arange(len(time))))
