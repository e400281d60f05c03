"""Detection of rests: quiet nodes with a constant field."""

from __future__ import annotations

import numpy as np

from magcal_ros.core.geometry.arrays import BoolArray, FloatArray

STILL_FIELD = 0.3
"""Change of the mean field between nodes of a robot at rest, in addition to noise, µT."""


def rests(
    mean_field: FloatArray,
    count: FloatArray,
    field: FloatArray,
    shaking: FloatArray,
    rocking: FloatArray,
) -> BoolArray:
    """Return in which nodes the robot may be at rest, by field, force and rate, shape (n,).

    Each node has a mean field (n, 3) in µT, a number of samples (n,), and standard deviations (n,)
    of field (µT), force (m/s²) and rate (rad/s).
    """
    quiet = _as_at_rest(shaking, 0.01) & _as_at_rest(rocking, 0.002)
    return quiet & _field_stays(mean_field, field, count)


def _as_at_rest(spread: FloatArray, least: float) -> BoolArray:
    """Return which nodes (n,) vary little more than the quietest tenth (ten nodes at most)."""
    return np.asarray(spread < 1.6 * _most_quiet(spread) + least)


def _most_quiet(spread: FloatArray) -> float:
    return float(np.quantile(spread, min(0.1, 10.0 / len(spread))))


def _field_stays(mean: FloatArray, spread: FloatArray, count: FloatArray) -> BoolArray:
    """Return which nodes (n,) have the same field as a neighbour, within the noise at rest."""
    noise = _most_quiet(spread) / np.sqrt(count)
    limit = STILL_FIELD + 3.0 * np.hypot(noise[1:], noise[:-1])
    stays = np.abs(np.diff(mean, axis=0)).max(axis=1) < limit
    return np.asarray(np.append(stays, False) | np.insert(stays, 0, False))
