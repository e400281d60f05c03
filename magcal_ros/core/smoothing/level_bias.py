"""The gyro's bias along a drive, separated from centripetal acceleration in bends.

Both lean the specific force away from where the gyro takes up. A pull follows the turn rate, and a
bias does not; over a steady circle they look the same, and what is known of gyros decides: a
vehicle is pulled by a tenth of gravity every day, and hardly a gyro is off by a degree a second.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from magcal_ros.core.geometry.arrays import FloatArray, IntArray
from magcal_ros.core.geometry.attitude import STANDARD_GRAVITY, unit
from magcal_ros.core.geometry.rotations import skews
from magcal_ros.core.smoothing.nodes import Means
from magcal_ros.core.smoothing.tuning import TUNING, SmootherTuning
from magcal_ros.core.up import relative_attitudes

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
