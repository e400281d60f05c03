"""The fit of a turn's field and gravity to the gyro, for many ways of the axes at once.

A field that stands still in the world is `v(t) = R(t) f` in the body, R propagated by the gyro from
the first sample. A magnetometer whose axes are P shows `m(t) = P ((I + N) v(t - lag) + h)`: N holds
a small installation error and soft iron, h is the hard iron. For every P, and for every way G in
which the gyro's axes may lie, all of it is fitted together with the gyro's bias and scale and the
direction of gravity, over the whole stretch and not between neighbours, where noise would hide the
turn.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from magcal_ros.core.geometry.arrays import FloatArray
from magcal_ros.core.geometry.rotations import (
    chained,
    crossed,
    exp_rotations,
    signed_permutations,
    skews,
)
from magcal_ros.core.samples.window import Stretch


@dataclass(frozen=True)
class AlignmentTuning:
    """What is assumed while the axes are weighed.

    Wide enough for what is looked for: a bias of 5 °/s, a scale error of a fifth, half a second of
    latency.
    """

    installation: float = math.radians(5.0)
    """Radians, standard deviation of the installation error about each axis."""
    soft_iron: float = 0.05  # standard deviation of each element of the soft iron, dimensionless
    bias: float = math.radians(6.0)  # rad/s, standard deviation of the gyro's bias
    scale: float = 0.2  # standard deviation of the gyro's scale error
    lag: float = 0.3  # seconds, standard deviation of how late the field is
    hard_iron: float = 4.0  # standard deviation of the hard iron over the field's size
    field_floor: float = 0.01
    up_floor: float = math.radians(2.0)
    """Least noise that is believed: over the field's size, and radians."""
    freedom: float = 4.0  # degrees of freedom of the t distribution of the residuals


WIDE = AlignmentTuning()
START_NOISE = np.array([0.1, 0.1])
"""Of field (over its size) and up (radians) in the first rounds: wide, so that all can move."""
NO_BIAS = np.zeros(3)
SETTLED = 0.01
"""Change of chi-square below which all candidates have settled."""
FIRST_STEPS = 5
ROUNDS = ((80.0, 4), (400.0, 4), (400.0, 4))
"""Misfit, first with wide noise and then with that of the best one, beyond which a candidate is
given up; and steps between estimates of the noise."""
PARAMETERS = 23
SOFT, FIELD, IRON, UP = slice(0, 9), slice(9, 12), slice(12, 15), slice(15, 18)
BIAS, SCALE, LAG = slice(18, 21), 21, 22
OF_FIELD = np.r_[9:12, 18:23]
"""What acts on the field before the soft iron does."""
OF_UP = np.r_[15:22]


@dataclass(frozen=True, eq=False)
class Alignment:
    """What became of every candidate."""

    misfit: FloatArray
    """Twice the negative log of the posterior of independent samples above the best's, (k,)."""
    rms: FloatArray  # typical residual of the field over the size of its changing part. Shape (k,).
    parameters: FloatArray
    """Soft iron and installation, field, hard iron, gravity (both sensors in body axes), the gyro's
    bias (rad/s) and scale error, and the field's lag (s). Shape (k, 23)."""
    covariance: FloatArray
    """Of the parameters; infinite for candidates that were given up. Shape (k, 23, 23)."""
    tilt: float  # radians RMS by which the movement was more than a turn about one axis
    least_tilt: float
    """The part of it that is not the gyro's own wandering: so much of it may be that as gravity
    deviates in the world meanwhile."""

    @property
    def best(self) -> int:
        """Which candidate explains the samples best."""
        return int(np.argmin(self.misfit))


def align(
    stretch: Stretch,
    axes: FloatArray,
    gyro: FloatArray,
    with_up: bool = True,
    bias: FloatArray = NO_BIAS,
) -> Alignment:
    """Fit every candidate and say how much worse than the best it explains the samples.

    Takes the same as `AlignmentFit`; `bias` (3,) is that of the gyro's rates at first, rad/s.
    """
    problem = AlignmentFit(stretch, axes, gyro, WIDE, with_up)
    some, noise = problem.descend(problem.start(bias), START_NOISE, FIRST_STEPS), START_NOISE
    information, _, cost = problem.normal_equations(some, noise)
    state, rms, misfit = some.copy(), problem.rms(some), cost - cost.min()
    kept = np.arange(len(axes))
    for limit, steps in ROUNDS:
        left = misfit[kept] <= limit
        kept, some = kept[left], some[left]
        problem = AlignmentFit(stretch, axes[kept], gyro[kept], WIDE, with_up)
        best = int(np.argmin(cost[left]))
        noise = problem.noise(some, best)
        residual = problem.linearised(some)[0][best]
        problem.share = np.array([1.0 / inefficiency(values) for values in residual])
        some = problem.descend(some, noise, steps)
        information, _, cost = problem.normal_equations(some, noise)
        state[kept], rms[kept], misfit[kept] = some, problem.rms(some), cost - cost.min()
    covariance = np.full((len(axes), PARAMETERS, PARAMETERS), np.inf)
    covariance[kept] = np.linalg.inv(information)
    attitude = problem.propagate(some)[0][int(np.argmin(cost))]
    apart = attitude - attitude.mean(axis=0)
    power = np.einsum("nij,nik->jk", apart, apart) / len(attitude)
    # How far attitudes leave the turn about one axis.
    tilt = math.sqrt(max(float(np.linalg.eigvalsh(power)[0]), 0.0))
    wandering = _gravity_spread(attitude, stretch.up)
    least_tilt = math.sqrt(max(tilt**2 - wandering**2, 0.0))
    return Alignment(misfit, rms, state, covariance, tilt, least_tilt)


def _gravity_spread(attitude: FloatArray, up: FloatArray) -> float:
    """Return how far gravity deviates in the world that attitudes (n, 3, 3) tell, radians RMS."""
    up = up / np.maximum(np.linalg.norm(up, axis=1, keepdims=True), 1e-9)
    # Whatever the axes of gyro and accelerometer: those with which it deviates least count.
    world = np.einsum("nji,kjl,nl->kni", attitude, signed_permutations(), up)
    deviations = world - world.mean(axis=1, keepdims=True)
    return math.sqrt(float(np.sum(deviations**2, axis=2).mean(axis=1).min()))


def inefficiency(residual: FloatArray) -> float:
    """Return how many neighbours (n, 3) count as one sample: those of a vehicle repeat long."""
    centred = residual - residual.mean(axis=0)
    power = float(np.sum(centred**2)) + 1e-300
    total, n = 1.0, len(centred)
    for lag in range(1, n // 8):
        correlation = float(np.sum(centred[lag:] * centred[:-lag])) / power
        if correlation < 2.0 / math.sqrt(3.0 * n):
            break
        total += 2.0 * correlation
    return total


class AlignmentFit:
    """The fit of all candidates at once; a state is an array (k, 23).

    Rows of a candidate's `axes` (k, 3, 3) are the magnetometer's in the body's, and those of `gyro`
    the gyro's. With `with_up` gravity takes part, as the second of two sensors. `share` is how many
    independent samples one sample of each sensor counts.
    """

    def __init__(
        self,
        stretch: Stretch,
        axes: FloatArray,
        gyro: FloatArray,
        tuning: AlignmentTuning,
        with_up: bool = True,
    ) -> None:
        self.tuning = tuning
        self.stretch = stretch
        self.sensors = 2 if with_up else 1
        self.share = np.ones(self.sensors)
        self.gyro = gyro
        self.rate = stretch.rate @ gyro
        # A mirrored gyro turns the order of two turns around.
        sense = np.linalg.det(gyro)[:, None, None]
        self.rotation = stretch.turn @ gyro + sense * (stretch.coning @ gyro)
        self.measured = np.einsum("kij,ni->knj", axes, stretch.field)
        mirror = np.array([0, 3, 6, 1, 4, 7, 2, 5, 8])
        antisymmetric = 0.5 * (np.eye(9) - np.eye(9)[mirror])
        symmetric = np.eye(9) - antisymmetric
        loose, free = 1e-3, 1e-6
        iron, bias = tuning.hard_iron**-2.0, tuning.bias**-2.0
        ends = [tuning.scale**-2.0, tuning.lag**-2.0]
        sizes = [[0.0] * 9, [loose] * 3, [iron] * 3, [free] * 3, [bias] * 3, ends]
        self.prior = np.diag(np.concatenate(sizes))
        # Of a rotation by d two elements are ± d, whence the half.
        self.prior[SOFT, SOFT] = (
            0.5 * antisymmetric / tuning.installation**2 + symmetric / tuning.soft_iron**2
        )

    def start(self, bias: FloatArray = NO_BIAS) -> FloatArray:
        """Return the best field and hard iron for each candidate, and a bias of its rates (3,)."""
        state = np.zeros((len(self.measured), PARAMETERS))
        state[:, BIAS] = bias @ self.gyro
        rotation = self.propagate(state)[0]
        count, n = rotation.shape[:2]
        axes = np.broadcast_to(np.eye(3), (count, n, 3, 3))
        design = np.concatenate([rotation, axes], axis=3).reshape(count, 3 * n, 6)
        transposed = design.swapaxes(1, 2)
        normal = transposed @ design + 1e-3 * n * np.diag([0.1] * 3 + [1.0] * 3)
        seen = transposed @ self.measured.reshape(count, 3 * n, 1)
        state[:, 9:15] = np.linalg.solve(normal, seen)[..., 0]
        state[:, UP] = np.einsum("knij,ni->kj", rotation, self.stretch.up) / n
        return state

    def propagate(self, state: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return attitudes (k, n, 3, 3) from the first sample's, and what bias and scale do.

        The latter has shape (k, n, 3, 4): rotation vectors, on the left of the attitudes.
        """
        bias, scale = state[:, BIAS], state[:, SCALE]
        seconds = self.stretch.seconds
        count, n = len(state), len(seconds) + 1
        vectors = (1.0 + scale[:, None, None]) * self.rotation
        vectors = vectors - bias[:, None, :] * seconds[:, None]
        steps = exp_rotations(-vectors.reshape(-1, 3)).reshape(count, n - 1, 3, 3)
        halfway = 0.5 * (steps + np.eye(3))
        pushed = np.zeros((count, n - 1, 3, 4))
        pushed[..., :3] = halfway * seconds[:, None, None]
        pushed[..., 3] = -np.einsum("knij,knj->kni", halfway, self.rotation)
        attitude = chained(steps)
        # Pushes add up in the world; each is turned back into the body that it is asked for.
        pushes = np.cumsum(attitude[:, 1:].swapaxes(2, 3) @ pushed, axis=1)
        moved = np.zeros((count, n, 3, 4))
        moved[:, 1:] = attitude[:, 1:] @ pushes
        return attitude, moved

    def linearised(self, state: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return measured less expected, and how what is expected changes with the parameters.

        Shapes (k, s, n, 3) and (k, s, n, 3, 23); the first sensor is the field, the second up.
        """
        attitude, moved = self.propagate(state)
        body = np.einsum("knij,kj->kni", attitude, state[:, FIELD])
        rate = (1.0 + state[:, SCALE, None, None]) * self.rate - state[:, None, BIAS]
        # What was measured a second ago was less turned by this.
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
            residual[:, 1] = self.stretch.up - up
            jacobian[:, 1][..., OF_UP] = np.concatenate([attitude, turned(up, moved)], axis=3)
        return residual, jacobian

    def noise(self, state: FloatArray, best: int) -> FloatArray:
        """Return the noise per axis (s,) that one candidate's residuals show."""
        values = self.linearised(state)[0][best]
        typical = np.sqrt(np.median(np.sum(values**2, axis=2), axis=1) / 2.37)
        whole = float(np.linalg.norm(state[best, FIELD]))
        floors = [self.tuning.field_floor * max(1.0, whole), self.tuning.up_floor]
        return np.asarray(np.maximum(typical, floors[: self.sensors]))

    def rms(self, state: FloatArray) -> FloatArray:
        """Return the typical residual of the field, shape (k,)."""
        field = self.linearised(state)[0][:, 0]
        return np.asarray(np.sqrt(np.median(np.sum(field**2, axis=2), axis=1)))

    def normal_equations(
        self, state: FloatArray, noise: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return information (k, 23, 23), gradient (k, 23) and cost (k,) with robust weights.

        The cost is twice the negative logarithm of the posterior.
        """
        residual, jacobian = self.linearised(state)
        nu, sigma = self.tuning.freedom, noise[: self.sensors, None]
        share = self.share[:, None] * (nu + 3.0)
        chi2 = np.sum(residual**2, axis=3) / sigma**2
        weight = (share / (nu + chi2) / sigma**2)[..., None, None]
        rows = jacobian.reshape(len(state), -1, PARAMETERS)
        weighted = (weight * jacobian).reshape(rows.shape).swapaxes(1, 2)
        gradient = (weighted @ residual.reshape(len(state), -1, 1))[..., 0] - state @ self.prior
        cost = np.einsum("ki,ij,kj->k", state, self.prior, state)
        cost += np.sum(share * np.log1p(chi2 / nu), axis=(1, 2))
        return weighted @ rows + self.prior, gradient, cost

    def descend(self, state: FloatArray, noise: FloatArray, steps: int) -> FloatArray:
        """Take Levenberg-Marquardt steps, each candidate with its own damping."""
        damping = np.full(len(state), 1e-4)
        information, gradient, cost = self.normal_equations(state, noise)
        for _ in range(steps):
            diagonal = np.einsum("kii->ki", information)[..., None] * np.eye(PARAMETERS)
            damped = information + damping[:, None, None] * diagonal
            tried = state + np.linalg.solve(damped, gradient[..., None])[..., 0]
            again = self.normal_equations(tried, noise)
            better = again[2] < cost
            settled = bool((np.abs(cost - again[2]) < SETTLED).all())
            damping = np.where(better, damping * 0.2, damping * 20.0)
            state = np.where(better[:, None], tried, state)
            information = np.where(better[:, None, None], again[0], information)
            gradient = np.where(better[:, None], again[1], gradient)
            cost = np.where(better, again[2], cost)
            if settled:
                break
        return state


def turned(vectors: FloatArray, turns: FloatArray) -> FloatArray:
    """Return how turns (k, n, 3, m) of the body move vectors (k, n, 3), shape (k, n, 3, m)."""
    return np.asarray(-skews(vectors) @ turns)
