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

from magcal_ros.core.geometry.arrays import FloatArray, IntArray
from magcal_ros.core.geometry.rotations import chained, exp_rotations, skews
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
    hopeless: float = 80.0
    """Misfit after the first steps, with wide noise, beyond which a candidate is given up."""
    lost: float = 400.0  # the same later, with the noise that the best one shows
    settled: float = 0.01  # change of chi-square below which all candidates have settled
    start_noise: tuple[float, float] = (0.1, 0.1)
    """Of field (over its size) and up (radians) in the first rounds: wide, so that all can move."""
    rounds: tuple[int, int, int, int] = (5, 4, 4, 4)  # steps between estimates of the noise


WIDE = AlignmentTuning()
PARAMETERS = 23
SOFT, FIELD, IRON, UP, BIAS = (
    slice(0, 9),
    slice(9, 12),
    slice(12, 15),
    slice(15, 18),
    slice(18, 21),
)
SCALE, LAG = 21, 22
OF_FIELD = np.r_[9:12, 18:23]
"""What acts on the field before the soft iron does."""
OF_UP = np.r_[15:22]
OF_AXIS = np.array([[3 * axis, 3 * axis + 1, 3 * axis + 2, 12 + axis] for axis in range(3)])
"""Soft and hard iron of each axis of the magnetometer."""


class AlignmentFit:
    """The fit of all candidates at once; a state is an array (k, 23).

    Parameters
    ----------
    stretch : Stretch
        The samples.
    axes : ndarray, shape (k, 3, 3)
        Candidates; rows are the magnetometer's axes in the body's.
    tuning : AlignmentTuning
    gyro : ndarray, shape (k, 3, 3)
        The same of the gyro.
    with_up : bool
        Whether gravity takes part.

    Attributes
    ----------
    share : tuple of float
        How many independent samples one sample of field and of gravity counts.
    """

    def __init__(
        self,
        stretch: Stretch,
        axes: FloatArray,
        tuning: AlignmentTuning,
        gyro: FloatArray,
        with_up: bool = True,
    ) -> None:
        self.tuning = tuning
        self.share = (1.0, 1.0)
        self.stretch = stretch
        self.with_up = with_up
        self.rate = stretch.rate @ gyro
        # A mirrored gyro turns the order of two turns around.
        sense = np.linalg.det(gyro)[:, None, None]
        self.rotation = stretch.turn @ gyro + sense * (stretch.coning @ gyro)
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
                    [tuning.scale**-2.0, tuning.lag**-2.0],
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
        rotation = self.propagate(state)[0]
        count, n = rotation.shape[:2]
        design = np.concatenate(
            [rotation, np.broadcast_to(np.eye(3), (count, n, 3, 3))], axis=3
        ).reshape(count, 3 * n, 6)
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

    def residuals(self, state: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return measured less expected field and up, each (k, n, 3)."""
        return self._residuals(state, self.propagate(state)[0])

    def _residuals(self, state: FloatArray, attitude: FloatArray) -> tuple[FloatArray, FloatArray]:
        body = np.einsum("knij,kj->kni", attitude, state[:, FIELD])
        body = body + state[:, LAG, None, None] * self._against_the_turn(state, body)
        soft = np.eye(3) + state[:, SOFT].reshape(-1, 3, 3)
        field = self.measured - np.einsum("kij,knj->kni", soft, body) - state[:, None, IRON]
        up = self.stretch.up - np.einsum("knij,kj->kni", attitude, state[:, UP])
        return field, up

    def _against_the_turn(self, state: FloatArray, body: FloatArray) -> FloatArray:
        """Return how a field (k, n, 3) was less turned a second ago, per second."""
        rate = (1.0 + state[:, SCALE, None, None]) * self.rate - state[:, None, BIAS]
        return np.asarray(np.cross(rate, body))

    def noise(self, state: FloatArray, best: int) -> tuple[float, float]:
        """Return the noise per axis that one candidate's residuals show."""
        typical = [
            math.sqrt(float(np.median(np.sum(values[best] ** 2, axis=1))) / 2.37)
            for values in self.residuals(state)
        ]
        whole = float(np.linalg.norm(state[best, FIELD]))
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
        parts = list(zip(residuals, noise, self.share, strict=True))
        for values, sigma, share in parts[: 1 + self.with_up]:
            chi2 = np.sum(values**2, axis=2) / sigma**2
            total = total + share * (nu + 3.0) * np.log1p(chi2 / nu).sum(axis=1)
        return np.asarray(total)

    def normal_equations(
        self, state: FloatArray, noise: tuple[float, float]
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return information (k, 23, 23), gradient (k, 23) and cost (k,) with robust weights."""
        attitude, moved = self.propagate(state)
        residuals = self._residuals(state, attitude)
        field, up = (
            self._weights(*each) for each in zip(residuals, noise, self.share, strict=True)
        )
        information, gradient = self._of_field(state, attitude, moved, field, residuals[0])
        if self.with_up:
            there = np.einsum("knij,kj->kni", attitude, state[:, UP])
            columns = np.concatenate([attitude, _turned(there, moved)], axis=3)
            self._add(information, gradient, OF_UP, columns, up, residuals[1])
        return (
            information + self.prior,
            gradient - state @ self.prior,
            self._cost(state, residuals, noise),
        )

    def _weights(self, values: FloatArray, sigma: float, share: float) -> FloatArray:
        nu, chi2 = self.tuning.freedom, np.sum(values**2, axis=2) / sigma**2
        return np.asarray(share * (nu + 3.0) / (nu + chi2) / sigma**2)

    def _of_field(
        self,
        state: FloatArray,
        attitude: FloatArray,
        moved: FloatArray,
        weight: FloatArray,
        residual: FloatArray,
    ) -> tuple[FloatArray, FloatArray]:
        """Return information and gradient of the field's residuals.

        Soft and hard iron act on each axis alone and on all three alike: their columns, most of the
        Jacobian, are never written out.
        """
        body = np.einsum("knij,kj->kni", attitude, state[:, FIELD])
        columns = self._field_columns(state, body, attitude, moved)
        count, n = body.shape[:2]
        information, gradient = np.zeros((count, PARAMETERS, PARAMETERS)), np.zeros_like(state)
        self._add(information, gradient, OF_FIELD, columns, weight, residual)
        alone = np.concatenate([body, np.ones((count, n, 1))], axis=2)
        weighted = (alone * weight[:, :, None]).swapaxes(1, 2)
        among, seen = weighted @ alone, weighted @ residual
        across = (weighted @ columns.reshape(count, n, -1)).reshape(count, 4, 3, -1)
        for axis, own in enumerate(OF_AXIS):
            information[:, own[:, None], own] = among
            information[:, own[:, None], OF_FIELD] = across[:, :, axis]
            information[:, OF_FIELD[:, None], own] = across[:, :, axis].swapaxes(1, 2)
            gradient[:, own] = seen[:, :, axis]
        return information, gradient

    @staticmethod
    def _add(
        information: FloatArray,
        gradient: FloatArray,
        where: IntArray,
        columns: FloatArray,
        weight: FloatArray,
        residual: FloatArray,
    ) -> None:
        """Add what residuals (k, n, 3) with columns (k, n, 3, m) say of the parameters `where`."""
        count, size = len(columns), columns.shape[3]
        rows = columns.reshape(count, -1, size)
        weighted = (columns * weight[:, :, None, None]).reshape(count, -1, size).swapaxes(1, 2)
        information[:, where[:, None], where] += weighted @ rows
        gradient[:, where] += (weighted @ residual.reshape(count, -1, 1))[..., 0]

    def field_jacobian(
        self, state: FloatArray, attitude: FloatArray, moved: FloatArray
    ) -> FloatArray:
        """Return how the expected field changes with the parameters, shape (k, n, 3, 23)."""
        body = np.einsum("knij,kj->kni", attitude, state[:, FIELD])
        out = np.zeros((*body.shape, PARAMETERS))
        for axis in range(3):
            out[:, :, axis, 3 * axis : 3 * axis + 3] = body
        out[..., IRON] = np.eye(3)
        out[..., OF_FIELD] = self._field_columns(state, body, attitude, moved)
        return out

    def field_turned(
        self, state: FloatArray, attitude: FloatArray, turns: FloatArray
    ) -> FloatArray:
        """Return how turns (k, n, 3, m) on the left of the attitudes move the field, same shape."""
        body = np.einsum("knij,kj->kni", attitude, state[:, FIELD])
        return np.asarray(self._soft(state) @ _turned(body, turns))

    def _soft(self, state: FloatArray) -> FloatArray:
        return np.eye(3) + state[:, SOFT].reshape(-1, 1, 3, 3)

    def _field_columns(
        self, state: FloatArray, body: FloatArray, attitude: FloatArray, moved: FloatArray
    ) -> FloatArray:
        """Return how the field changes with `OF_FIELD`, (k, n, 3, 8)."""
        late = self._against_the_turn(state, body)[..., None]
        before = np.concatenate([attitude, _turned(body, moved), late], axis=3)
        return np.asarray(self._soft(state) @ before)

    def descend(self, state: FloatArray, noise: tuple[float, float], steps: int) -> FloatArray:
        """Take Levenberg-Marquardt steps, each candidate with its own damping."""
        damping = np.full(len(state), 1e-4)
        information, gradient, cost = self.normal_equations(state, noise)
        for _ in range(steps):
            diagonal = np.einsum("kii->ki", information)
            damped = information + damping[:, None, None] * (
                diagonal[:, :, None] * np.eye(PARAMETERS)
            )
            tried = state + np.linalg.solve(damped, gradient[..., None])[..., 0]
            again = self.normal_equations(tried, noise)
            better = again[2] < cost
            settled = bool((np.abs(cost - again[2]) < self.tuning.settled).all())
            damping = np.where(better, damping * 0.2, damping * 20.0)
            state = np.where(better[:, None], tried, state)
            information = np.where(better[:, None, None], again[0], information)
            gradient = np.where(better[:, None], again[1], gradient)
            cost = np.where(better, again[2], cost)
            if settled:
                break
        return state


def _turned(vectors: FloatArray, turns: FloatArray) -> FloatArray:
    """Return how turns (k, n, 3, m) of the body move vectors (k, n, 3) of the world.

    Shape (k, n, 3, m).
    """
    cross = skews(vectors.reshape(-1, 3)).reshape(*vectors.shape, 3)
    return np.asarray(-cross @ turns)
