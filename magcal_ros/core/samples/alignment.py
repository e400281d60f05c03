"""How well the field turns against the gyro, for each way the sensors' axes may lie."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from magcal_ros.core.geometry.arrays import FloatArray
from magcal_ros.core.geometry.rotations import signed_permutations
from magcal_ros.core.samples.alignment_fit import PARAMETERS, WIDE, AlignmentFit
from magcal_ros.core.samples.window import Stretch


@dataclass(frozen=True, eq=False)
class Alignment:
    """What became of every candidate."""

    misfit: FloatArray
    """Twice the negative logarithm of the posterior in independent samples, above the best's. Shape
    (k,)."""
    rms: FloatArray
    """Typical residual of the field over the size of its changing part. Shape (k,)."""
    parameters: FloatArray
    """Soft iron and installation, field, hard iron, gravity (both sensors in body axes), the gyro's
    bias (rad/s) and scale error, and the field's lag (s). Shape (k, 23)."""
    covariance: FloatArray
    """Of the parameters; infinite for candidates that were given up. Shape (k, 23, 23)."""
    tilt_seen: float
    """Radians RMS by which the movement was more than a turn about one axis; zero where gravity
    deviates farther than that, for it may be the gyro's own wandering."""

    @property
    def best(self) -> int:
        """Which candidate explains the samples best."""
        return int(np.argmin(self.misfit))


def align(
    stretch: Stretch, axes: FloatArray, gyro: FloatArray | None = None, with_up: bool = True
) -> Alignment:
    """Fit every candidate and say how much worse than the best it explains the samples.

    `axes` (k, 3, 3) are the candidates; rows are the magnetometer's axes in the body's. `gyro` (k,
    3, 3) are the same of the gyro, the body's by default. `with_up` is whether gravity takes part.
    """
    ways = np.broadcast_to(np.eye(3), axes.shape) if gyro is None else gyro
    problem = AlignmentFit(stretch, axes, WIDE, ways, with_up)
    some = problem.descend(problem.start(), WIDE.start_noise, WIDE.rounds[0])
    cost, noise = problem.cost(some, WIDE.start_noise), WIDE.start_noise
    state, rms, misfit = some.copy(), problem.rms(some), cost - cost.min()
    kept = np.arange(len(axes))
    for limit, steps in zip((WIDE.hopeless, WIDE.lost, WIDE.lost), WIDE.rounds[1:], strict=True):
        left = misfit[kept] <= limit
        kept, some = kept[left], some[left]
        problem = AlignmentFit(stretch, axes[kept], WIDE, ways[kept], with_up)
        best = int(np.argmin(cost[left]))
        noise = problem.noise(some, best)
        problem.share = _shares(problem.residuals(some), best)
        some = problem.descend(some, noise, steps)
        cost = problem.cost(some, noise)
        state[kept], rms[kept], misfit[kept] = some, problem.rms(some), cost - cost.min()
    best = int(np.argmin(cost))
    information = problem.normal_equations(some, noise)[0]
    covariance = np.full((len(axes), PARAMETERS, PARAMETERS), np.inf)
    covariance[kept] = np.linalg.inv(information)
    attitude = problem.propagate(some)[0][best]
    tilt = _tilt_spread(attitude)
    seen = tilt if tilt > _gravity_spread(attitude, stretch.up) else 0.0
    return Alignment(misfit, rms, state, covariance, seen)


def _tilt_spread(attitude: FloatArray) -> float:
    """Return how far attitudes (n, 3, 3) leave the turn about one axis, radians RMS."""
    apart = attitude - attitude.mean(axis=0)
    power = np.einsum("nij,nik->jk", apart, apart) / len(attitude)
    return math.sqrt(max(float(np.linalg.eigvalsh(power)[0]), 0.0))


def _gravity_spread(attitude: FloatArray, up: FloatArray) -> float:
    """Return how far gravity deviates in the world that attitudes (n, 3, 3) tell, radians RMS.

    Whatever the axes of gyro and accelerometer: those with which it deviates least count.
    """
    up = up / np.maximum(np.linalg.norm(up, axis=1, keepdims=True), 1e-9)
    world = np.einsum("nji,kjl,nl->kni", attitude, signed_permutations(), up)
    deviations = world - world.mean(axis=1, keepdims=True)
    return math.sqrt(float(np.sum(deviations**2, axis=2).mean(axis=1).min()))


def _shares(residuals: tuple[FloatArray, FloatArray], best: int) -> tuple[float, float]:
    """Return how many independent samples each one counts: those of a vehicle repeat long."""
    field, up = (1.0 / inefficiency(values[best]) for values in residuals)
    return field, up


def inefficiency(residual: FloatArray) -> float:
    """Return how many neighbours (n, 3) count as one sample."""
    centred = residual - residual.mean(axis=0)
    power = float(np.sum(centred**2)) + 1e-300
    total, n = 1.0, len(centred)
    for lag in range(1, n // 8):
        correlation = float(np.sum(centred[lag:] * centred[:-lag])) / power
        if correlation < 2.0 / math.sqrt(3.0 * n):
            break
        total += 2.0 * correlation
    return total
