"""The gyro's bias along a drive, told from what pulls a vehicle in its bends.

Both lean the specific force away from where the gyro takes up. A pull follows the turn rate, and a
bias does not; over a steady circle they look the same, and what is known of gyros decides: a
vehicle is pulled by a tenth of gravity every day, and hardly a gyro is off by a degree a second.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from magcal_ros.core.geometry.arrays import FloatArray, IntArray
from magcal_ros.core.geometry.attitude import STANDARD_GRAVITY, unit
from magcal_ros.core.geometry.rotations import skews
from magcal_ros.core.smoothing.tuning import TUNING, SmootherTuning
from magcal_ros.core.up import relative_attitudes

STILL, BIAS, PULL = slice(0, 3), slice(3, 6), slice(6, 9)
"""Among the unknowns of a stretch: up in axes that stand still, the bias, the pull."""
OWN = [*range(3), *range(6, 9)]


@dataclass(frozen=True)
class Leans:
    """What leans the specific force beside the gyro's bias, over gravity; one sigma.

    Parameters
    ----------
    jolt : float
        Of the mean over `SmootherTuning.jolt_seconds`.
    pull_per_rate : float
        Per rad/s of turning.
    """

    jolt: float
    pull_per_rate: float

    @classmethod
    def travelling(cls, tuning: SmootherTuning = TUNING) -> Leans:
        """Return those of a vehicle."""
        return cls(tuning.jolt_lean, tuning.pull_per_rate)

    @classmethod
    def staying(cls, tuning: SmootherTuning = TUNING) -> Leans:
        """Return those of a robot that nothing pulls."""
        return cls(tuning.unpulled / STANDARD_GRAVITY, 1e-3)


def gyro_bias(
    time: FloatArray,
    force: FloatArray,
    rate: FloatArray,
    weight: FloatArray,
    leans: Leans,
    tuning: SmootherTuning = TUNING,
) -> FloatArray:
    """Return the gyro's bias, rad/s, shape (3,).

    Least squares over stretches of the drive, each with an up and a pull of its own; short ones
    first, which a large bias does not bend out of shape. The bias is held to what gyros usually
    have by a Cauchy prior, which lets go of it where stretches insist.

    Parameters
    ----------
    time : ndarray, shape (m,)
        Seconds, increasing.
    force : ndarray, shape (m, 3)
        Over gravity, body axes.
    rate : ndarray, shape (m, 3)
        rad/s, body axes.
    weight : ndarray, shape (m,)
        Of each row, at most one.
    leans : Leans
    tuning : SmootherTuning
    """
    bias = np.zeros(3)
    for seconds in tuning.bias_stretches:
        first = np.flatnonzero(np.diff(((time - time[0]) / seconds).astype(int), prepend=-1))
        information, pull = _of_stretches(time, force, rate - bias, weight, first, leans, tuning)
        far = float(bias @ bias) / tuning.usual_bias**2
        known = 4.0 / (1.0 + far) / tuning.usual_bias**2
        bias = bias + np.linalg.solve(information + known * np.eye(3), pull - known * bias)
    return bias


def _of_stretches(
    time: FloatArray,
    force: FloatArray,
    rate: FloatArray,
    weight: FloatArray,
    first: IntArray,
    leans: Leans,
    tuning: SmootherTuning,
) -> tuple[FloatArray, FloatArray]:
    """Return what all stretches say of a further bias: information (3, 3) and its product (3,)."""
    attitude = relative_attitudes(time, rate)
    sizes = np.diff(np.append(first, len(time)))
    seen = np.einsum("nji,nj->ni", attitude, force)
    up = np.repeat(unit(np.add.reduceat(seen, first, axis=0)), sizes, axis=0)
    rows = np.zeros((len(time), 3, 9))
    rows[:, :, STILL] = attitude
    turned = _integral(time, np.swapaxes(attitude, 1, 2))
    turned -= np.repeat(turned[first], sizes, axis=0)
    rows[:, :, BIAS] = -attitude @ skews(up) @ turned
    about_up = np.sum(rate * force, axis=1) / np.linalg.norm(force, axis=1)
    rows[:, :, PULL] = about_up[:, None, None] * np.eye(3)
    # One jolt is one witness, however many rows it is seen in.
    rows_per_jolt = tuning.jolt_seconds / tuning.row
    heavy = rows * (weight / rows_per_jolt / leans.jolt**2)[:, None, None]
    normal = np.add.reduceat(np.einsum("nik,nil->nkl", heavy, rows), first, axis=0)
    read = np.add.reduceat(np.einsum("nik,ni->nk", heavy, force), first, axis=0)
    normal[:, PULL, PULL] += np.eye(3) / leans.pull_per_rate**2
    normal[:, STILL, STILL] += 1e-6 / leans.jolt**2 * np.eye(3)
    own = normal[:, OWN][:, :, OWN]
    shares = np.linalg.solve(own, normal[:, OWN, BIAS])
    across = np.swapaxes(normal[:, OWN, BIAS], 1, 2)
    information = normal[:, BIAS, BIAS] - across @ shares
    product = read[:, BIAS] - np.einsum("skl,sk->sl", shares, read[:, OWN])
    return information.sum(axis=0), product.sum(axis=0)


def _integral(time: FloatArray, values: FloatArray) -> FloatArray:
    """Return the integral from the first row to each, by the trapezoidal rule."""
    steps = 0.5 * (values[1:] + values[:-1]) * np.diff(time)[:, None, None]
    return np.concatenate([np.zeros((1, *values.shape[1:])), np.cumsum(steps, axis=0)])
