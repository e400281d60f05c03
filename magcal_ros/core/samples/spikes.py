"""White noise of samples, and spikes: single samples that differ from their neighbours."""

from __future__ import annotations

import math

import numpy as np

from magcal_ros.core.geometry.arrays import BoolArray, FloatArray

NEIGHBOURS, SPIKE = 9, 4.5
"""Window of the median filter, samples, and deviation of a spike from the median, robust sigmas."""


def white_noise(values: FloatArray) -> FloatArray:
    """Return the noise of samples (n, 3) per axis, from fourth differences; zero if too few.

    Sway adds little to fourth differences.
    """
    bends = np.diff(values, 4, axis=0)
    if not len(bends):
        return np.zeros(values.shape[1])
    return np.asarray(np.median(np.abs(bends), axis=0) / 0.6745 / np.sqrt(70.0))


def without_spikes(values: FloatArray) -> BoolArray:
    """Return which rows (n, 3) agree with the median of their neighbours (a Hampel filter)."""
    return np.asarray((~_spikes(values)[0]).all(axis=1))


def spikes_replaced(values: FloatArray) -> FloatArray:
    """Return samples (n, 3) with each spike replaced by the median of its neighbours."""
    is_spike, median = _spikes(values)
    return np.where(is_spike, median, values)


def _spikes(values: FloatArray) -> tuple[BoolArray, FloatArray]:
    """Return which values (n, 3) are spikes, and the median of the neighbours of each."""
    reach = NEIGHBOURS // 2
    padded = np.pad(values, ((reach, reach), (0, 0)), mode="edge")
    stretches = np.lib.stride_tricks.sliding_window_view(padded, NEIGHBOURS, axis=0)
    median = np.median(stretches, axis=2)
    away = np.abs(values - median)
    # On a slope the median is the value in the middle. At a peak it is lower, by less than half of
    # its second difference over the reach.
    beside = np.pad(median, ((reach, reach), (0, 0)), mode="edge")
    bend = np.abs(beside[2 * reach :] - 2.0 * median + beside[: -2 * reach]) / 2.0
    steps = np.abs(np.diff(values, axis=0))
    coarse = np.min(np.where(steps > 0.0, steps, math.inf), axis=0, initial=math.inf)
    coarse = np.where(np.isfinite(coarse), coarse, 0.0)
    # Spikes affect the lower quartile of second differences less than the median of fourth ones.
    bends = np.abs(np.diff(values, 2, axis=0))
    quarter = np.quantile(bends, 0.25, axis=0) / 0.3186 / math.sqrt(6.0) if len(bends) else math.inf
    noise = np.minimum(white_noise(values), quarter)
    usual = np.maximum.reduce([1.4826 * np.median(away, axis=0), noise, coarse])
    return np.asarray(away >= SPIKE * usual + bend + 1e-12), median
