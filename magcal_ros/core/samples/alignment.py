"""How well the field turns against the gyro, for each way the magnetometer's axes may lie.

A field that stands still in the world is `v(t) = R(t) f` in the body, R propagated by the gyro from
the first sample. A magnetometer whose axes are P shows `m(t) = P ((I + N) v(t) + h)`: N holds a
small installation error and soft iron, h is the hard iron. For every P all of it is fitted
together with the gyro's bias and scale and the direction of gravity, over the whole stretch and not
between neighbours, where noise would hide the turn.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import numpy as np

from magcal_ros.core.geometry.arrays import FloatArray, IntArray
from magcal_ros.core.geometry.rotations import exp_rotations, skews
from magcal_ros.core.samples.window import Window


@dataclass(frozen=True)
class AlignmentTuning:
    """What is taken for granted while the axes are weighed.

    Parameters
    ----------
    largest : int
        Neighbouring samples are averaged until no more than this number remain.
    most : int
        Where the turn is too fast to average so many, the liveliest part of this length is used.
    widest_block : float
        Radians of turn over which samples are averaged.
    installation : float
        Radians, standard deviation of the installation error about each axis.
    soft_iron : float
        Standard deviation of each element of the soft iron, dimensionless.
    bias : float
        rad/s, standard deviation of the gyro's bias.
    scale : float
        Standard deviation of the gyro's scale error.
    hard_iron : float
        Standard deviation of the hard iron over the field's size.
    field_floor, up_floor : float
        Least noise that is believed: over the field's size, and radians.
    freedom : float
        Degrees of freedom of the t distribution of the residuals.
    hopeless : float
        Misfit after the first steps, with wide noise, beyond which a candidate is given up.
    """

    largest: int = 120
    most: int = 240
    widest_block: float = math.radians(5.0)
    installation: float = math.radians(5.0)
    soft_iron: float = 0.05
    bias: float = math.radians(3.0)
    scale: float = 0.05
    hard_iron: float = 4.0
    field_floor: float = 0.01
    up_floor: float = math.radians(2.0)
    freedom: float = 4.0
    hopeless: float = 80.0


TUNING = AlignmentTuning()
START_NOISE = (0.1, 0.1)
"""Of field (over its size) and up (radians) in the first rounds: wide, so that all can move."""
ROUNDS = (5, 4, 4, 4)
"""Steps between estimates of the noise."""
PARAMETERS = 22
SOFT, FIELD, IRON, UP, GYRO = slice(0, 9), slice(9, 12), slice(12, 15), slice(15, 18), slice(18, 22)


@dataclass(frozen=True, eq=False)
class Stretch:
    """Averaged samples with the turns between them.

    Parameters
    ----------
    field : ndarray, shape (n, 3)
        Over `size`.
    up : ndarray, shape (n, 3)
        Specific force over its own usual size.
    turn : ndarray, shape (n - 1, 3)
        Rotation vectors from each sample to the next, radians.
    seconds : ndarray, shape (n - 1,)
    size : float
        Of the field's changing part, tesla.
    """

    field: FloatArray
    up: FloatArray
    turn: FloatArray
    seconds: FloatArray
    size: float


@dataclass(frozen=True, eq=False)
class Alignment:
    """What became of every candidate.

    Parameters
    ----------
    misfit : ndarray, shape (k,)
        Twice the negative logarithm of the posterior in independent samples, above the best's.
    rms : ndarray, shape (k,)
        Typical residual of the field over the size of its changing part.
    parameters : ndarray, shape (k, 22)
        Soft iron and installation, field, hard iron, gravity (both sensors in body axes), the
        gyro's bias (rad/s) and scale error.
    covariance : ndarray, shape (k, 22, 22)
        Of the parameters; infinite for candidates that were given up.
    tilt_spread : float
        Radians RMS by which the movement was more than a turn about one axis.
    size : float
        Tesla in which field and hard iron are counted.
    """

    misfit: FloatArray
    rms: FloatArray
    parameters: FloatArray
    covariance: FloatArray
    tilt_spread: float
    size: float

    @property
    def best(self) -> int:
        """Which candidate explains the samples best."""
        return int(np.argmin(self.misfit))


def stretch_of(window: Window, tuning: AlignmentTuning = TUNING) -> Stretch:
    """Average neighbours and propagate the gyro between them; `window` has a gyro.

    Parameters
    ----------
    window : Window
        Samples in their order.
    tuning : AlignmentTuning, optional
    """
    rate = window.angular_rate
    assert rate is not None
    seconds = np.diff(window.time)
    vectors = 0.5 * (rate[1:] + rate[:-1]) * seconds[:, None]
    usual = float(np.mean(np.linalg.norm(vectors, axis=1))) + 1e-9
    wanted = min(-(-len(window) // tuning.largest), max(1, int(tuning.widest_block / usual)))
    block = max(1, wanted - (wanted + 1) % 2)
    if len(window) > block * tuning.most:
        return stretch_of(window.take(_liveliest(vectors, block * tuning.most)), tuning)
    count = len(window) // block
    rows = block * count
    middle = np.arange(count) * block + block // 2
    field = window.field[:rows].reshape(count, block, 3).mean(axis=1)
    force = window.specific_force[:rows].reshape(count, block, 3).mean(axis=1)
    size = float(np.linalg.norm(np.ptp(np.quantile(field, (0.02, 0.98), axis=0), axis=0))) / 2.0
    gravity = float(np.median(np.linalg.norm(force, axis=1)))
    return Stretch(
        field / max(size, 1e-12),
        force / max(gravity, 1e-12),
        np.array([_joined(vectors[i:j]) for i, j in itertools.pairwise(middle)]),
        np.diff(window.time[middle]),
        size,
    )


def _liveliest(vectors: FloatArray, length: int) -> IntArray:
    """Return the rows of the part of this length that turns most."""
    turned = np.concatenate([[0.0], np.cumsum(np.linalg.norm(vectors, axis=1))])
    first = int(np.argmax(turned[length - 1 :] - turned[: len(turned) - length + 1]))
    return np.arange(first, first + length)


def _joined(vectors: FloatArray) -> FloatArray:
    """Return rotation vectors (n, 3) one after another as one, to second order."""
    total = vectors.sum(axis=0)
    before = np.cumsum(vectors, axis=0) - vectors
    return np.asarray(total + 0.5 * np.cross(before, vectors).sum(axis=0))


def align(stretch: Stretch, axes: FloatArray, tuning: AlignmentTuning = TUNING) -> Alignment:
    """Fit every candidate and say how much worse than the best it explains the samples.

    Parameters
    ----------
    stretch : Stretch
        Of `stretch_of`.
    axes : ndarray, shape (k, 3, 3)
        Candidates; rows are the magnetometer's axes in the body's.
    tuning : AlignmentTuning, optional
    """
    everything = _Problem(stretch, axes, tuning)
    state = everything.descend(everything.start(), START_NOISE, ROUNDS[0])
    first = everything.cost(state, START_NOISE)
    misfit, rms = first - first.min(), everything.rms(state)
    kept = np.flatnonzero(misfit <= tuning.hopeless)
    problem, some = _Problem(stretch, axes[kept], tuning), state[kept]
    noise = START_NOISE
    for steps in ROUNDS[1:]:
        best = int(np.argmin(problem.cost(some, noise)))
        noise = problem.noise(some[best : best + 1], best)
        some = problem.descend(some, noise, steps)
    cost = problem.cost(some, noise)
    best = int(np.argmin(cost))
    repeated = _inefficiency(problem.residuals(some)[0][best])
    information = problem.normal_equations(some, noise)[0]
    state[kept], rms[kept] = some, problem.rms(some)
    misfit[kept] = (cost - cost[best]) / repeated
    covariance = np.full((len(axes), PARAMETERS, PARAMETERS), np.inf)
    covariance[kept] = np.linalg.inv(information) * repeated
    attitude = problem.propagate(some[best : best + 1])[0][0]
    return Alignment(misfit, rms, state, covariance, _tilt_spread(attitude), stretch.size)


def _tilt_spread(attitude: FloatArray) -> float:
    """Return how far attitudes (n, 3, 3) leave the turn about one axis, radians RMS."""
    apart = attitude - attitude.mean(axis=0)
    power = np.einsum("nij,nik->jk", apart, apart) / len(attitude)
    return math.sqrt(max(float(np.linalg.eigvalsh(power)[0]), 0.0))


def _inefficiency(residual: FloatArray) -> float:
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


class _Problem:
    """The fit of all candidates at once; a state is an array (k, 22)."""

    def __init__(self, stretch: Stretch, axes: FloatArray, tuning: AlignmentTuning) -> None:
        self.tuning = tuning
        self.stretch = stretch
        self.measured = np.einsum("kij,ni->knj", axes, stretch.field)
        mirror = np.array([0, 3, 6, 1, 4, 7, 2, 5, 8])
        antisymmetric = 0.5 * (np.eye(9) - np.eye(9)[mirror])
        symmetric = np.eye(9) - antisymmetric
        self.prior = np.diag(
            np.concatenate(
                [
                    np.zeros(9),
                    np.full(3, 1e-3),
                    np.full(3, tuning.hard_iron**-2.0),
                    np.full(3, 1e-6),
                    np.full(3, tuning.bias**-2.0),
                    [tuning.scale**-2.0],
                ]
            )
        )
        # Of a rotation by d two elements are ± d, whence the half.
        self.prior[SOFT, SOFT] = (
            0.5 * antisymmetric / tuning.installation**2 + symmetric / tuning.soft_iron**2
        )

    def start(self) -> FloatArray:
        """Return the best field and hard iron for each candidate, all else as hoped for."""
        state = np.zeros((len(self.measured), PARAMETERS))
        state[:, UP] = self.stretch.up[0]
        rotation = self.propagate(state[:1])[0][0]
        n = len(rotation)
        design = np.concatenate([rotation, np.broadcast_to(np.eye(3), (n, 3, 3))], axis=2)
        rows = design.reshape(-1, 6)
        normal = rows.T @ rows + 1e-3 * n * np.diag([0.1] * 3 + [1.0] * 3)
        found = np.linalg.solve(normal, rows.T @ self.measured.reshape(len(state), -1).T)
        state[:, 9:15] = found.T
        state[:, UP] = np.einsum("nij,ni->j", rotation, self.stretch.up) / n
        return state

    def propagate(self, state: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return attitudes (k, n, 3, 3) from the first sample's, and what bias and scale do.

        The latter has shape (k, n, 3, 4): rotation vectors, on the left of the attitudes.
        """
        bias, scale = state[:, 18:21], state[:, 21]
        seconds, turn = self.stretch.seconds, self.stretch.turn
        count, n = len(state), len(seconds) + 1
        vectors = (1.0 + scale[:, None, None]) * turn - bias[:, None, :] * seconds[:, None]
        steps = exp_rotations(-vectors.reshape(-1, 3)).reshape(count, n - 1, 3, 3)
        halfway = 0.5 * (steps + np.eye(3))
        pushed = np.zeros((count, n - 1, 3, 4))
        pushed[..., :3] = halfway * seconds[:, None, None]
        pushed[..., 3] = -np.einsum("knij,nj->kni", halfway, turn)
        attitude = np.empty((n, count, 3, 3))
        moved = np.zeros((n, count, 3, 4))
        attitude[0] = np.eye(3)
        for k in range(n - 1):
            attitude[k + 1] = steps[:, k] @ attitude[k]
            moved[k + 1] = steps[:, k] @ moved[k] + pushed[:, k]
        return attitude.swapaxes(0, 1), moved.swapaxes(0, 1)

    def residuals(
        self, state: FloatArray, only: int | None = None
    ) -> tuple[FloatArray, FloatArray]:
        """Return measured less expected field and up, each (k, n, 3)."""
        attitude, _ = self.propagate(state)
        return self._residuals(state, attitude, only)

    def _residuals(
        self, state: FloatArray, attitude: FloatArray, only: int | None = None
    ) -> tuple[FloatArray, FloatArray]:
        measured = self.measured if only is None else self.measured[only : only + 1]
        body = np.einsum("knij,kj->kni", attitude, state[:, FIELD])
        soft = np.eye(3) + state[:, SOFT].reshape(-1, 3, 3)
        field = measured - np.einsum("kij,knj->kni", soft, body) - state[:, None, IRON]
        up = self.stretch.up - np.einsum("knij,kj->kni", attitude, state[:, UP])
        return field, up

    def noise(self, state: FloatArray, best: int) -> tuple[float, float]:
        """Return the noise per axis that one candidate's residuals show."""
        field, up = self.residuals(state, best)
        typical = [
            math.sqrt(float(np.median(np.sum(values**2, axis=2))) / 2.37) for values in (field, up)
        ]
        whole = float(np.linalg.norm(state[0, FIELD]))
        floors = (self.tuning.field_floor * max(1.0, whole), self.tuning.up_floor)
        return max(typical[0], floors[0]), max(typical[1], floors[1])

    def rms(self, state: FloatArray) -> FloatArray:
        """Return the typical residual of the field, shape (k,)."""
        return np.asarray(np.sqrt(np.median(np.sum(self.residuals(state)[0] ** 2, axis=2), axis=1)))

    def cost(self, state: FloatArray, noise: tuple[float, float]) -> FloatArray:
        """Return twice the negative logarithm of the posterior, shape (k,)."""
        attitude, _ = self.propagate(state)
        return self._cost(state, self._residuals(state, attitude), noise)

    def _cost(
        self,
        state: FloatArray,
        residuals: tuple[FloatArray, FloatArray],
        noise: tuple[float, float],
    ) -> FloatArray:
        nu = self.tuning.freedom
        total = np.einsum("ki,ij,kj->k", state, self.prior, state)
        for values, sigma in zip(residuals, noise, strict=True):
            chi2 = np.sum(values**2, axis=2) / sigma**2
            total = total + (nu + 3.0) * np.log1p(chi2 / nu).sum(axis=1)
        return np.asarray(total)

    def normal_equations(
        self, state: FloatArray, noise: tuple[float, float]
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return information (k, 22, 22), gradient (k, 22) and cost (k,) with robust weights."""
        attitude, moved = self.propagate(state)
        field, up = self._residuals(state, attitude)
        jacobian = self._jacobian(state, attitude, moved)
        nu, (count, n) = self.tuning.freedom, field.shape[:2]
        weights = []
        for values, sigma in zip((field, up), noise, strict=True):
            chi2 = np.sum(values**2, axis=2) / sigma**2
            weights.append((nu + 3.0) / (nu + chi2) / sigma**2)
        weight = np.repeat(np.stack(weights, axis=2), 3, axis=2).reshape(count, -1, 1)
        rows = jacobian.reshape(count, n * 6, PARAMETERS)
        values = np.concatenate([field, up], axis=2).reshape(count, -1, 1)
        transposed = (rows * weight).swapaxes(1, 2)
        information = transposed @ rows + self.prior
        gradient = (transposed @ values)[..., 0] - state @ self.prior
        return information, gradient, self._cost(state, (field, up), noise)

    def _jacobian(self, state: FloatArray, attitude: FloatArray, moved: FloatArray) -> FloatArray:
        """Return how the expectations change with the parameters, shape (k, n, 6, 22)."""
        count, n = attitude.shape[:2]
        body = np.einsum("knij,kj->kni", attitude, state[:, FIELD])
        up = np.einsum("knij,kj->kni", attitude, state[:, UP])
        soft = np.eye(3) + state[:, SOFT].reshape(-1, 1, 3, 3)
        out = np.zeros((count, n, 6, PARAMETERS))
        for axis in range(3):
            out[:, :, axis, 3 * axis : 3 * axis + 3] = body
        out[:, :, :3, FIELD] = soft @ attitude
        out[:, :, :3, IRON] = np.eye(3)
        out[:, :, 3:, UP] = attitude
        for part, vectors, matrix in ((slice(0, 3), body, soft), (slice(3, 6), up, np.eye(3))):
            cross = skews(vectors.reshape(-1, 3)).reshape(count, n, 3, 3)
            out[:, :, part, GYRO] = -matrix @ (cross @ moved)
        return out

    def descend(self, state: FloatArray, noise: tuple[float, float], steps: int) -> FloatArray:
        """Take Levenberg-Marquardt steps, each candidate with its own damping."""
        damping = np.full(len(state), 1e-4)
        information, gradient, cost = self.normal_equations(state, noise)
        for _ in range(steps):
            diagonal = np.einsum("kii->ki", information)
            damped = information + damping[:, None, None] * (diagonal[:, :, None] * np.eye(22))
            tried = state + np.linalg.solve(damped, gradient[..., None])[..., 0]
            again = self.normal_equations(tried, noise)
            better = again[2] < cost
            damping = np.where(better, damping * 0.2, damping * 20.0)
            state = np.where(better[:, None], tried, state)
            information = np.where(better[:, None, None], again[0], information)
            gradient = np.where(better[:, None], again[1], gradient)
            cost = np.where(better, again[2], cost)
        return state
