"""The fit of a turn's field and gravity to the gyro, for many candidate axes at once.

A constant field in the world is `v(t) = R(t) f` in the body, with R propagated by the gyro from the
first sample. A magnetometer with axes P measures `m(t) = P ((I + N) v(t - lag) + h)`: N is a small
installation error and soft iron, h the hard iron. For every P, and for all possible axes G of the
gyro, these are fitted together with the gyro's bias and scale and the direction of gravity. The fit
spans the whole stretch; between neighbours, noise would hide the turn.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from magcal_ros.core.doctor.doctor_tuning import AXES, WIDE
from magcal_ros.core.doctor.prepared import Segment
from magcal_ros.core.geometry.arrays import FloatArray
from magcal_ros.core.geometry.rotations import (
    chained,
    crossed,
    exp_rotations,
    signed_permutations,
    skews,
)

START_NOISE = np.array([0.1, 0.1])
"""Noise of field (over its size) and up (radians) in the first rounds: wide, for all to move."""
NO_BIAS = np.zeros(3)
SETTLED = 0.01
"""Change of chi-square below which all candidates have settled."""
DROPPED = (4.0 * AXES.remains, 20.0 * AXES.remains, 20.0 * AXES.remains)
"""Misfit beyond which a candidate is dropped, first with wide noise and then with that of the best
one, which is estimated anew each time."""
PARAMETERS = 23
SOFT, FIELD, IRON, UP = slice(0, 9), slice(9, 12), slice(12, 15), slice(15, 18)
BIAS, SCALE, LAG = slice(18, 21), 21, 22
OF_FIELD = np.r_[9:12, 18:23]
"""Parameters that act on the field before the soft iron."""
OF_UP = np.r_[15:22]


@dataclass(frozen=True, eq=False)
class Alignment:
    """The fits of all candidates."""

    misfit: FloatArray
    """Twice the negative log of the posterior of independent samples above the best's, (k,)."""
    rms: FloatArray  # typical residual of the field over the size of its changing part. Shape (k,).
    parameters: FloatArray
    """Soft iron and installation, field, hard iron, gravity (both sensors in body axes), the gyro's
    bias (rad/s) and scale error, and the field's lag (s). Shape (k, 23)."""
    covariance: FloatArray
    """Of the parameters; infinite for candidates that were dropped. Shape (k, 23, 23)."""
    tilt: float  # deviation of the movement from a turn about one axis, radians RMS
    least_tilt: float
    """The part of `tilt` that cannot be drift of the gyro. At most, drift is the deviation of
    gravity in the world, by the gyro's attitudes."""

    @property
    def best(self) -> int:
        """Index of the candidate that explains the samples best."""
        return int(np.argmin(self.misfit))


def align(
    segment: Segment,
    axes: FloatArray,
    gyro: FloatArray,
    with_up: bool = True,
) -> Alignment:
    """Return the fits of all candidates, with their misfit relative to the best.

    Parameters as for `AlignmentFit`.
    """
    fit, kept = AlignmentFit(segment, axes, gyro, with_up), np.arange(len(axes))
    at = fit.descend(fit.start(), START_NOISE, AXES.rounds)
    state, rms, misfit = at.state.copy(), at.rms, at.cost - at.cost.min()
    for limit in DROPPED:
        left = np.flatnonzero(misfit[kept] <= limit)
        best = left[np.argmin(at.cost[left])]
        noise = noise_of(at.residual[best], at.state[best])
        kept = kept[left]
        fit = AlignmentFit(segment, axes[kept], gyro[kept], with_up)
        fit.share = np.array([1.0 / inefficiency(values) for values in at.residual[best]])
        at = fit.descend(at.state[left], noise, AXES.rounds)
        state[kept], rms[kept], misfit[kept] = at.state, at.rms, at.cost - at.cost.min()
    covariance = np.full((len(axes), PARAMETERS, PARAMETERS), np.inf)
    covariance[kept] = np.linalg.inv(at.information)
    attitude = fit.propagate(at.state)[0][np.argmin(at.cost)]
    apart = attitude - attitude.mean(axis=0)
    power = np.einsum("nij,nik->jk", apart, apart) / len(attitude)
    # Deviation of the attitudes from a turn about one axis.
    tilt = math.sqrt(max(float(np.linalg.eigvalsh(power)[0]), 0.0))
    wandering = _gravity_spread(attitude, segment.up)
    least_tilt = math.sqrt(max(tilt**2 - wandering**2, 0.0))
    return Alignment(misfit, rms, state, covariance, tilt, least_tilt)


def _gravity_spread(attitude: FloatArray, up: FloatArray) -> float:
    """Return the deviation of gravity in the world by attitudes (n, 3, 3), radians RMS."""
    up = up / np.maximum(np.linalg.norm(up, axis=1, keepdims=True), 1e-9)
    # The axes of gyro and accelerometer are unknown: those with the least deviation are used.
    world = np.einsum("nji,kjl,nl->kni", attitude, signed_permutations(), up)
    deviations = world - world.mean(axis=1, keepdims=True)
    return math.sqrt(float(np.sum(deviations**2, axis=2).mean(axis=1).min()))


def inefficiency(residual: FloatArray) -> float:
    """Return the number of correlated residuals (n, 3) that count as one independent sample."""
    centred = residual - residual.mean(axis=0)
    power = float(np.sum(centred**2)) + 1e-300
    total, n = 1.0, len(centred)
    for lag in range(1, n // 8):
        correlation = float(np.sum(centred[lag:] * centred[:-lag])) / power
        if correlation < 2.0 / math.sqrt(3.0 * n):
            break
        total += 2.0 * correlation
    return total


def noise_of(residual: FloatArray, state: FloatArray) -> FloatArray:
    """Return the noise per axis (s,) of the sensors, by the residuals (s, n, 3) of a candidate."""
    typical = np.sqrt(np.median(np.sum(residual**2, axis=2), axis=1) / 2.37)
    whole = float(np.linalg.norm(state[FIELD]))
    floors = [WIDE.field_floor * max(1.0, whole), WIDE.up_floor]
    return np.asarray(np.maximum(typical, floors[: len(residual)]))


class Linearisation(NamedTuple):
    """All k candidates at one state each; the first of the s sensors is the field, then up."""

    state: FloatArray  # shape (k, 23)
    residual: FloatArray  # shape (k, s, n, 3)
    information: FloatArray  # shape (k, 23, 23)
    gradient: FloatArray  # shape (k, 23)
    cost: FloatArray  # twice the negative logarithm of the posterior, shape (k,)

    @property
    def rms(self) -> FloatArray:
        """The typical residual of the field, shape (k,)."""
        return np.asarray(np.sqrt(np.median(np.sum(self.residual[:, 0] ** 2, axis=2), axis=1)))


class AlignmentFit:
    """The fit of all candidates at once; a state is an array (k, 23).

    Rows of a candidate's `axes` (k, 3, 3) are the magnetometer's axes in body axes, those of `gyro`
    the gyro's. With `with_up` gravity is a second sensor. `share` is the number of independent
    samples for each sample of a sensor.
    """

    def __init__(
        self,
        segment: Segment,
        axes: FloatArray,
        gyro: FloatArray,
        with_up: bool = True,
    ) -> None:
        self.segment = segment
        self.sensors = 2 if with_up else 1
        self.share = np.ones(self.sensors)
        self.gyro = gyro
        self.rate = segment.rate @ gyro
        # A mirrored gyro reverses the order of two turns.
        sense = np.linalg.det(gyro)[:, None, None]
        self.rotation = segment.turn @ gyro + sense * (segment.coning @ gyro)
        self.measured = np.einsum("kij,ni->knj", axes, segment.field)
        mirror = np.array([0, 3, 6, 1, 4, 7, 2, 5, 8])
        antisymmetric = 0.5 * (np.eye(9) - np.eye(9)[mirror])
        symmetric = np.eye(9) - antisymmetric
        # Of field, hard iron, up and bias. Field and up are almost free.
        vectors = np.repeat([1e-3, WIDE.hard_iron**-2.0, 1e-6, WIDE.bias**-2.0], 3)
        self.prior = np.diag(np.r_[np.zeros(9), vectors, WIDE.scale**-2.0, WIDE.lag**-2.0])
        # A rotation by d has two elements ± d: hence the factor 0.5.
        self.prior[SOFT, SOFT] = (
            0.5 * antisymmetric / WIDE.installation**2 + symmetric / WIDE.soft_iron**2
        )

    def start(self) -> FloatArray:
        """Return the best field and hard iron for each candidate, without a bias of its rates."""
        state = np.zeros((len(self.measured), PARAMETERS))
        rotation = self.propagate(state)[0]
        count, n = rotation.shape[:2]
        axes = np.broadcast_to(np.eye(3), (count, n, 3, 3))
        design = np.concatenate([rotation, axes], axis=3).reshape(count, 3 * n, 6)
        transposed = design.swapaxes(1, 2)
        normal = transposed @ design + 1e-3 * n * np.diag([0.1] * 3 + [1.0] * 3)
        seen = transposed @ self.measured.reshape(count, 3 * n, 1)
        state[:, 9:15] = np.linalg.solve(normal, seen)[..., 0]
        state[:, UP] = np.einsum("knij,ni->kj", rotation, self.segment.up) / n
        return state

    def propagate(self, state: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return attitudes (k, n, 3, 3) since the first sample, and derivatives by bias and scale.

        The derivatives are rotation vectors on the left of the attitudes, shape (k, n, 3, 4).
        """
        bias, scale = state[:, BIAS], state[:, SCALE]
        seconds = self.segment.seconds
        count, n = len(state), len(seconds) + 1
        vectors = (1.0 + scale[:, None, None]) * self.rotation
        vectors = vectors - bias[:, None, :] * seconds[:, None]
        steps = exp_rotations(-vectors.reshape(-1, 3)).reshape(count, n - 1, 3, 3)
        halfway = 0.5 * (steps + np.eye(3))
        pushed = np.zeros((count, n - 1, 3, 4))
        pushed[..., :3] = halfway * seconds[:, None, None]
        pushed[..., 3] = -np.einsum("knij,knj->kni", halfway, self.rotation)
        attitude = chained(steps)
        # The derivatives are summed in the world, and rotated into the body of each sample.
        pushes = np.cumsum(attitude[:, 1:].swapaxes(2, 3) @ pushed, axis=1)
        moved = np.zeros((count, n, 3, 4))
        moved[:, 1:] = attitude[:, 1:] @ pushes
        return attitude, moved

    def residuals(self, state: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return residuals (k, s, n, 3) and the predictions' Jacobian (k, s, n, 3, 23)."""
        attitude, moved = self.propagate(state)
        body = np.einsum("knij,kj->kni", attitude, state[:, FIELD])
        rate = (1.0 + state[:, SCALE, None, None]) * self.rate - state[:, None, BIAS]
        # Derivative of the field by the lag.
        late = crossed(rate, body)
        seen = body + state[:, LAG, None, None] * late
        soft = np.eye(3) + state[:, SOFT].reshape(-1, 1, 3, 3)
        count, n = body.shape[:2]
        residual = np.empty((count, self.sensors, n, 3))
        jacobian = np.zeros((count, self.sensors, n, 3, PARAMETERS))
        residual[:, 0] = self.measured - (soft @ seen[..., None])[..., 0] - state[:, None, IRON]
        for axis in range(3):
            jacobian[:, 0, :, axis, 3 * axis : 3 * axis + 3] = seen
        jacobian[:, 0, ..., IRON] = np.eye(3)
        before = np.concatenate([attitude, turned(body, moved), late[..., None]], axis=3)
        jacobian[:, 0][..., OF_FIELD] = soft @ before
        if self.sensors > 1:
            up = np.einsum("knij,kj->kni", attitude, state[:, UP])
            residual[:, 1] = self.segment.up - up
            jacobian[:, 1][..., OF_UP] = np.concatenate([attitude, turned(up, moved)], axis=3)
        return residual, jacobian

    def linearised(self, state: FloatArray, noise: FloatArray) -> Linearisation:
        """Return residuals and normal equations at states (k, 23), with robust weights."""
        residual, jacobian = self.residuals(state)
        nu, sigma = WIDE.freedom, noise[: self.sensors, None]
        share = self.share[:, None] * (nu + 3.0)
        chi2 = np.sum(residual**2, axis=3) / sigma**2
        root = np.sqrt(share / (nu + chi2)) / sigma
        jacobian *= root[..., None, None]
        # The product of an array with itself takes half the time of one with another array.
        rows = jacobian.reshape(len(state), -1, PARAMETERS)
        across = rows.swapaxes(1, 2)
        weighted = (root[..., None] * residual).reshape(len(state), -1, 1)
        gradient = (across @ weighted)[..., 0] - state @ self.prior
        cost = np.einsum("ki,ij,kj->k", state, self.prior, state)
        cost += np.sum(share * np.log1p(chi2 / nu), axis=(1, 2))
        return Linearisation(state, residual, across @ rows + self.prior, gradient, cost)

    def descend(self, state: FloatArray, noise: FloatArray, steps: int) -> Linearisation:
        """Take Levenberg-Marquardt steps, each candidate with its own damping."""
        at, damping = self.linearised(state, noise), np.full(len(state), 1e-4)
        for _ in range(steps):
            damped = at.information * (1.0 + damping[:, None, None] * np.eye(PARAMETERS))
            step = np.linalg.solve(damped, at.gradient[..., None])[..., 0]
            tried = self.linearised(at.state + step, noise)
            better = tried.cost < at.cost
            settled = bool((np.abs(at.cost - tried.cost) < SETTLED).all())
            damping = np.where(better, damping * 0.2, damping * 20.0)
            for old, new in zip(at, tried, strict=True):
                new[~better] = old[~better]
            at = tried
            if settled:
                break
        return at


def turned(vectors: FloatArray, turns: FloatArray) -> FloatArray:
    """Return the change of vectors (k, n, 3) by small rotations (k, n, 3, m) of the body."""
    return np.asarray(-skews(vectors) @ turns)
