"""Up all along a drive: the slow mean of the specific force in the axes that the gyro holds still.

Starts, stops and bends lean the accelerometer by ten degrees, but forth and back: over some tens of
seconds they cancel, and the gyro hardly drifts meanwhile. Without linear acceleration the mean is
short.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from magcal_ros.core.geometry.arrays import FloatArray, IntArray
from magcal_ros.core.geometry.attitude import STANDARD_GRAVITY, level_part, unit
from magcal_ros.core.geometry.rotations import skews
from magcal_ros.core.samples.streams import STREAMS
from magcal_ros.core.smoothing.nodes import LeanDoubt, Means, levelled_axes
from magcal_ros.core.smoothing.tuning import TUNING, SmootherTuning
from magcal_ros.core.up import relative_attitudes, unseen_angles

STILL, BIAS, PULL = slice(0, 3), slice(3, 6), slice(6, 9)
"""Among the unknowns of a stretch: up in axes that stand still, the bias, the pull."""
OWN = [*range(3), *range(6, 9)]


@dataclass(frozen=True, eq=False)
class Bias:
    """What a drive shows of the gyro's bias."""

    rate: FloatArray
    """rad/s. Shape (3,)."""
    information: float
    """What the drive alone says of its worst seen component across up, per (rad/s)²."""


@dataclass(frozen=True)
class Leans:
    """What leans the specific force beside the gyro's bias, over gravity; one sigma."""

    jolt: float
    """Of the mean over `SmootherTuning.jolt_seconds`."""
    pull_per_rate: float
    """Per rad/s of turning."""

    @classmethod
    def travelling(cls, tuning: SmootherTuning = TUNING) -> Leans:
        """Return those of a vehicle."""
        return cls(tuning.jolt_lean, tuning.pull_per_rate)

    @classmethod
    def staying(cls, tuning: SmootherTuning = TUNING) -> Leans:
        """Return those of a robot without linear acceleration."""
        return cls(tuning.unpulled / STANDARD_GRAVITY, 1e-3)


@dataclass(frozen=True, eq=False)
class ForceLog:
    """The specific force along a drive, over gravity."""

    time: FloatArray
    """Seconds, increasing. Shape (m,)."""
    force: FloatArray
    """Body axes. Shape (m, 3)."""
    rate: FloatArray
    """rad/s, body axes. Shape (m, 3)."""
    weight: FloatArray
    """Of each row: how many there are, less what is not believed of them. Shape (m,)."""
    pieces: IntArray
    """Rows from which on the gyro was heard anew; the first is zero."""

    def stretches(self, seconds: float) -> IntArray:
        """Return the first rows of stretches that last so long at most, none across a gap."""
        block = ((self.time - self.time[0]) / seconds).astype(int)
        return np.union1d(np.flatnonzero(np.diff(block, prepend=-1)), self.pieces)

    def thinned(self, by: int) -> ForceLog:
        """Return the means of so many rows each, none across a gap."""
        starts = np.union1d(np.arange(0, len(self.time), by), self.pieces)
        means = Means(starts, len(self.time))
        return ForceLog(
            means.of(self.time),
            means.of(self.force),
            means.of(self.rate),
            means.of(self.weight) * means.sizes,
            np.searchsorted(starts, self.pieces),
        )


def gyro_bias(seen: ForceLog, leans: Leans, tuning: SmootherTuning = TUNING) -> Bias:
    """Return the gyro's bias.

    Least squares over stretches of the drive, each with an up and a pull of its own; short ones
    first, which a large bias does not bend out of shape. A Cauchy prior holds the bias to what
    gyros usually have, and lets go of it where stretches insist: the likelier is taken of what is
    found from no bias and from what they would say alone.

    Parameters
    ----------
    seen : ForceLog
    leans : Leans
    tuning : SmootherTuning
    """
    thin = seen.thinned(tuning.bias_rows)
    search = _Search(thin, leans, tuning)
    short = tuning.bias_stretches[0]
    alone = np.zeros(3)
    for _ in range(2):
        alone = search.step(alone, short, tuning.any_bias**-2)
    bias = search.settle(np.zeros(3))
    if float(np.linalg.norm(alone)) > tuning.largest_bias:
        bias = min(bias, search.settle(alone), key=search.cost)
    told, up = search.told(bias, tuning.bias_stretches[-1]), unit(seen.force.mean(axis=0))
    # About up the force shows no bias.
    beside = told.information + told.information.max() * np.outer(up, up)
    if not np.isfinite(beside).all():
        return Bias(np.zeros(3), 0.0)
    return Bias(bias, max(float(np.linalg.eigvalsh(beside)[0]), 0.0))


@dataclass(frozen=True, eq=False)
class _Told:
    """What stretches say of a further bias: information (3, 3), its product (3,), the misfit."""

    information: FloatArray
    product: FloatArray
    misfit: float


@dataclass(frozen=True, eq=False)
class _Search:
    """Looks for a bias in what was seen."""

    seen: ForceLog
    leans: Leans
    tuning: SmootherTuning

    def settle(self, bias: FloatArray) -> FloatArray:
        """Follow the stretches under the prior, from a bias (3,)."""
        for seconds in self.tuning.bias_stretches:
            far = float(bias @ bias) / self.tuning.usual_bias**2
            bias = self.step(bias, seconds, 4.0 / (1.0 + far) / self.tuning.usual_bias**2)
        return bias

    def step(self, bias: FloatArray, seconds: float, known: float) -> FloatArray:
        """Return the next bias of a Gauss-Newton step, with so much information on none."""
        told = self.told(bias, seconds)
        pull = told.product - known * bias
        return np.asarray(bias + np.linalg.solve(told.information + known * np.eye(3), pull))

    def cost(self, bias: FloatArray) -> float:
        """Return minus twice the log likelihood of a bias, the prior included."""
        far = float(bias @ bias) / self.tuning.usual_bias**2
        return self.told(bias, self.tuning.bias_stretches[-1]).misfit + 4.0 * math.log1p(far)

    def told(self, bias: FloatArray, seconds: float) -> _Told:
        """Return what stretches of so many seconds say beyond a bias."""
        rows, first = self._rows(bias, seconds)
        # One jolt is one observation, in however many rows it is seen.
        rows_per_jolt = self.tuning.jolt_seconds / self.tuning.row
        weight = self.seen.weight / rows_per_jolt / self.leans.jolt**2
        force = self.seen.force
        heavy = rows * weight[:, None, None]
        normal = np.add.reduceat(np.swapaxes(heavy, 1, 2) @ rows, first, axis=0)
        read = np.add.reduceat(np.einsum("nik,ni->nk", heavy, force), first, axis=0)
        normal[:, PULL, PULL] += np.eye(3) / self.leans.pull_per_rate**2
        normal[:, STILL, STILL] += 1e-6 / self.leans.jolt**2 * np.eye(3)
        own, across = normal[:, OWN][:, :, OWN], normal[:, OWN, BIAS]
        shares = np.linalg.solve(own, np.concatenate([across, read[:, OWN, None]], axis=2))
        gone = np.einsum("skl,skm->lm", across, shares)
        left = read[:, OWN, None] * shares[:, :, 3:]
        return _Told(
            normal[:, BIAS, BIAS].sum(axis=0) - gone[:, :3],
            read[:, BIAS].sum(axis=0) - gone[:, 3],
            float(weight @ np.sum(force**2, axis=1) - left.sum()),
        )

    def _rows(self, bias: FloatArray, seconds: float) -> tuple[FloatArray, IntArray]:
        """Return the derivatives of the force (n, 3, 9), and where stretches begin."""
        seen = self.seen
        time, force, rate = seen.time, seen.force, seen.rate - bias
        first, attitude = seen.stretches(seconds), relative_attitudes(time, rate)
        sizes = np.diff(np.append(first, len(time)))
        still = np.einsum("nji,nj->ni", attitude, force)
        up = np.repeat(unit(np.add.reduceat(still, first, axis=0)), sizes, axis=0)
        turned = _integral(time, np.swapaxes(attitude, 1, 2))
        turned -= np.repeat(turned[first], sizes, axis=0)
        about_up = np.sum(rate * force, axis=1) / np.linalg.norm(force, axis=1)
        rows = np.zeros((len(time), 3, 9))
        rows[:, :, STILL] = attitude
        rows[:, :, BIAS] = -attitude @ skews(up) @ turned
        rows[:, :, PULL] = about_up[:, None, None] * np.eye(3)
        return rows, first


def _integral(time: FloatArray, values: FloatArray) -> FloatArray:
    """Return the integral from the first row to each, by the trapezoidal rule."""
    steps = 0.5 * (values[1:] + values[:-1]) * np.diff(time)[:, None, None]
    return np.concatenate([np.zeros((1, *values.shape[1:])), np.cumsum(steps, axis=0)])


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
