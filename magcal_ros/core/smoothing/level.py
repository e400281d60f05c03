"""Up all along a drive: the slow mean of the specific force in the axes that the gyro holds still.

Starts, stops and bends lean the accelerometer by ten degrees, but forth and back: over some tens of
seconds they cancel, and the gyro hardly drifts meanwhile. Without linear acceleration the mean is
short.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from magcal_ros.core.geometry.arrays import FloatArray
from magcal_ros.core.geometry.attitude import level_part, unit
from magcal_ros.core.samples.streams import STREAMS
from magcal_ros.core.smoothing.level_bias import ForceLog, Leans, gyro_bias
from magcal_ros.core.smoothing.nodes import LeanDoubt, levelled_axes
from magcal_ros.core.smoothing.tuning import TUNING, SmootherTuning
from magcal_ros.core.up import relative_attitudes, unseen_angles

SMALLEST_STEP = 1e-3
SMALL_BIAS = 1e-3
"""rad/s, for the difference that shows how up follows the bias."""


@dataclass(frozen=True, eq=False)
class Level:
    """Up along a drive."""

    up: FloatArray
    """Unit vectors in body axes. Shape (m, 3)."""
    stays: bool
    """Whether nothing pulls, as starts, stops and bends do: then nobody travels."""
    doubt: LeanDoubt
    """There is none for who stays."""
    wander: FloatArray | None = None
    """About what is wrong with how up varies; None for who stays. Shape (m, 3)."""


def level_of(
    time: FloatArray,
    force: FloatArray,
    rate: FloatArray,
    bias_sigma: float = math.inf,
    tuning: SmootherTuning = TUNING,
) -> Level:
    """Return up at each row.

    Parameters
    ----------
    time : ndarray, shape (m,)
        Seconds, increasing; over gaps the gyro was not heard.
    force : ndarray, shape (m, 3)
        m/s², body axes; the vehicle's own acceleration taken off where it is known.
    rate : ndarray, shape (m, 3)
        rad/s, body axes.
    bias_sigma : float
        rad/s per axis, of the rate's bias; infinite where only what is usual of gyros is known.
    tuning : SmootherTuning
    """
    tuning = tuning.after_rest(bias_sigma)
    size = np.linalg.norm(force, axis=1)
    usual = float(np.median(size))
    weight = 1.0 / (1.0 + ((size - usual) / (tuning.pulled * usual)) ** 2)
    edges = np.flatnonzero(np.diff(time) > STREAMS.longest_gyro_step) + 1
    first = np.concatenate([[0], edges])
    pieces = [slice(*ends) for ends in zip(first, [*edges, len(time)], strict=True)]
    seen = ForceLog(time, force / usual, rate, weight, first)

    heavy = weight[:, None] * force

    def averaged(bias: FloatArray, memory: float) -> FloatArray:
        up = np.empty_like(force)
        for piece in pieces:
            up[piece] = _averaged(time[piece], heavy[piece], rate[piece] - bias, memory)
        return up

    bias = gyro_bias(seen, Leans.staying(tuning), tuning)
    if float(np.linalg.norm(bias.rate)) < tuning.largest_bias:
        up = averaged(bias.rate, tuning.pull_memory)
        pulls = [pull(force[piece], up[piece], tuning) for piece in pieces]
        if max(pulls) < tuning.unpulled:
            return Level(averaged(bias.rate, tuning.level_memory_unpulled), True, LeanDoubt())
    bias = gyro_bias(seen, Leans.travelling(tuning), tuning)
    up = averaged(bias.rate, tuning.level_memory)
    across = levelled_axes(unit(up.mean(axis=0))[None])[0, 0]
    leaning = averaged(bias.rate + SMALL_BIAS * across, tuning.level_memory) - up
    lean = float(np.linalg.norm(leaning.mean(axis=0))) / SMALL_BIAS
    doubt = LeanDoubt(bias.information / tuning.bends_alike, lean, tuning.usual_bias)
    wander = averaged(bias.rate, 0.5 * tuning.level_memory) - up
    return Level(up, False, doubt, _with_walk(wander, time, rate, tuning.level_memory))


def _with_walk(wander: FloatArray, time: FloatArray, rate: FloatArray, memory: float) -> FloatArray:
    """Return what starts and stops leave in the mean, enlarged by what the gyro misses meanwhile.

    The former, (m, 3), is known as it is twice as much over half the time. Where samples come
    slowly, the latter is a random walk (`unseen_angles`), of which the mean over both sides leaves
    a fourth of the memory.
    """
    if len(time) < 2:
        return wander
    walk = 2.0 / 3.0 * float(np.sum(unseen_angles(time, rate))) / float(np.ptp(time))
    size = float(np.mean(np.sum(wander**2, axis=1)))
    return wander * math.sqrt(1.0 + 0.25 * memory * walk / max(size, 1e-12))


def pull(force: FloatArray, up: FloatArray, tuning: SmootherTuning = TUNING) -> float:
    """Return the RMS of the force across up, means over a second each, m/s².

    Parameters
    ----------
    force, up : ndarray, shape (m, 3)
        Rows of a log in body axes.
    tuning : SmootherTuning

    Returns
    -------
    float
        Infinite for less than some seconds.
    """
    width = round(1.0 / tuning.row)
    count = len(force) // width
    if count < tuning.fewest_seconds:
        return math.inf
    means = level_part(force, up)[: count * width].reshape(count, width, 3).mean(axis=1)
    return math.sqrt(float(np.mean(np.sum(means**2, axis=1))))


def _averaged(time: FloatArray, force: FloatArray, rate: FloatArray, memory: float) -> FloatArray:
    """Return the direction of the force (m, 3), averaged both ways where the gyro stands still."""
    attitude = relative_attitudes(time, rate)
    still = np.einsum("nji,nj->ni", attitude, force)
    keeps = np.exp(-np.maximum(np.diff(time), SMALLEST_STEP) / memory)
    both = _trailing(still, keeps) + _trailing(still[::-1], keeps[::-1])[::-1] - still
    return unit(np.einsum("nij,nj->ni", attitude, both))


def _trailing(rows: FloatArray, keeps: FloatArray) -> FloatArray:
    """Return the sum of all rows up to each, faded by what the steps between keep."""
    # Loaded only by who looks at a drive, as in `chain`.
    from scipy.linalg import solve_banded

    band = np.ones((2, len(rows)))
    band[1] = np.append(-keeps, 0.0)
    return np.asarray(solve_banded((1, 0), band, rows, check_finite=False))
