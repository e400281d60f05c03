"""A turn through which the gyro propagates one attitude (doc/estimator.md, section 4).

Instead of an attitude for each sample there is one for the turn, and a vector of errors with
priors: bias, scale, a slow drift whose size is estimated, and what else follows the turn where it
shows (`effects`). This ties neighbours together: leans need not be integrated out, short arcs gain
most, and a field that does not turn with the robot shows.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from magcal_ros.core.estimation.block import AXES, Reduced, TurnBlock
from magcal_ros.core.estimation.effects import Effect
from magcal_ros.core.estimation.gyro_path import BIAS, SCALE, GyroPath
from magcal_ros.core.estimation.model import (
    Evaluation,
    Samples,
    State,
    global_jacobian,
    local_jacobian,
)
from magcal_ros.core.estimation.parameters import Globals
from magcal_ros.core.estimation.seating import seated
from magcal_ros.core.estimation.sigmas import estimate_noise
from magcal_ros.core.estimation.weighting import (
    ChiSquares,
    Noise,
    Weighting,
    chi_squares,
    whitened,
)
from magcal_ros.core.geometry.arrays import FloatArray, IntArray
from magcal_ros.core.geometry.rotations import exp_rotations

SMALLEST_WOBBLE = 1e-3


@dataclass(frozen=True)
class Drift:
    """Random walk of the gyro's attitude, radians per root second.

    Parameters
    ----------
    first : float
        Where its estimate begins.
    usual : float
        Gyros drift less; what drifts more hides errors that last.
    smallest, largest : float
        Bounds of the estimate.
    """

    first: float = 2e-3
    usual: float = 1e-3
    smallest: float = 2e-4
    largest: float = 0.05


DRIFT = Drift()


@dataclass(frozen=True, eq=False)
class GyroBlock:
    """A turn whose attitudes are gyro-propagated; both axes only name a frame.

    Parameters
    ----------
    place : Evaluation
        Globals and propagated attitudes; samples with the effects taken off.
    samples : Samples
        As measured.
    weighting : Weighting
    path : GyroPath
    errors : ndarray, shape (c,)
        Of gyro and accelerometer, in the order of `GyroPath`.
    drift : float
        Random walk of the gyro's attitude, radians per root second.
    """

    place: Evaluation
    samples: Samples
    weighting: Weighting
    path: GyroPath
    errors: FloatArray
    drift: float

    own = AXES[:0]
    leans = False
    lean_cost = 0.0

    @classmethod
    def started(
        cls, state: State, samples: Samples, weighting: Weighting, path: GyroPath, drift: float
    ) -> GyroBlock:
        """Return the gyro's attitudes without errors, turned to fit those of `state` on the whole.

        The errors speak in the first sample's axes, the attitudes in the turn's frame.
        """
        shared = state.shared
        body = shared.body_axis @ state.attitude @ shared.world_axis.T
        counted = weighting.weights.sample[:, None, None]
        total = np.sum(np.swapaxes(path.relative, 1, 2) @ (body * counted), axis=0)
        left, _, right = np.linalg.svd(total)
        first = left @ np.diag([1.0, 1.0, np.linalg.det(left @ right)]) @ right
        attitude = shared.body_axis.T @ path.relative @ first @ shared.world_axis
        errors = np.zeros(path.size)
        place = Evaluation(State(shared, attitude), samples)
        return cls(place, samples, weighting, path, errors, drift)

    @property
    def acceleration(self) -> FloatArray:
        """Steady linear acceleration in body axes, over gravity, shape (3,)."""
        found = self.path.found(self.errors, Effect.PULL)
        return found[:3] if len(found) else np.zeros(3)

    @property
    def bias(self) -> FloatArray:
        """The gyro's bias, rad/s, shape (3,)."""
        return self.errors[BIAS]

    @property
    def unbiased(self) -> FloatArray:
        """Rotations from the first sample's axes to each, bias and scale taken off, (n, 3, 3)."""
        known = slice(BIAS.start, SCALE.stop)
        turned = self.path.basis[:, :, known] @ self.errors[known]
        return np.asarray(self.path.relative @ exp_rotations(turned))

    @property
    def wobble(self) -> float:
        """RMS lean of the axis, radians per axis."""
        lean = float(np.sqrt(np.mean(self.place.state.lean[:, :2] ** 2)))
        return max(lean, SMALLEST_WOBBLE)

    @cached_property
    def chi(self) -> ChiSquares:
        """Squared whitened residuals."""
        return chi_squares(self.place, self.weighting.noise)

    @cached_property
    def prior_information(self) -> FloatArray:
        """Prior information on the errors, shape (c, c)."""
        return self.path.prior_information(self.drift)

    @property
    def sample_costs(self) -> FloatArray:
        """Weighted squares of each sample, shape (n,)."""
        weights = self.weighting.weights
        return np.asarray(weights.sample * weights.data * self.chi.data)

    @property
    def cost(self) -> float:
        """Weighted sum of squares, the prior of the errors included."""
        known = float(self.errors @ self.prior_information @ self.errors)
        return float(self.sample_costs.sum()) + self.weighting.inefficiency * known

    def equations(self, free: IntArray) -> GyroEquations:
        """Return the normal equations over the globals `free`.

        The many errors of the gyro act through three numbers a sample, so everything of theirs is
        summed over those three instead of the six residuals.
        """
        noise, weights = self.weighting.noise, self.weighting.weights
        local = local_jacobian(self.place.prediction)
        direct = self._direct_jacobian(local, free) * noise.whitening[:, None]
        residual = whitened(self.place, noise)
        weight = (weights.data * weights.sample)[:, None, None]
        turning = (local * noise.whitening[:, None]) @ self._to_frame
        by_turning = np.ascontiguousarray(np.swapaxes(turning * weight, 1, 2))
        basis = self.path.basis.reshape(-1, self.path.basis.shape[2])
        size = direct.shape[2]
        rows = (direct * weight).reshape(-1, size)
        among = rows.T @ direct.reshape(-1, size)
        across = (by_turning @ direct).reshape(-1, size).T @ basis
        within = basis.T @ ((by_turning @ turning) @ self.path.basis).reshape(basis.shape)
        # Globals come first, then the basis, then the effects.
        count = len(free)
        order = np.r_[:count, size : size + basis.shape[1], count:size]
        information = np.block([[among, across], [across.T, within]])[np.ix_(order, order)]
        gradient = np.concatenate(
            [rows.T @ residual.ravel(), basis.T @ (by_turning @ residual[:, :, None]).ravel()]
        )[order]
        own = np.zeros_like(information)
        own[count:, count:] = self.weighting.inefficiency * self.prior_information
        gradient[count:] -= own[count:, count:] @ self.errors
        return GyroEquations(self, residual, information + own, gradient, own, count)

    def _direct_jacobian(self, local: FloatArray, free: IntArray) -> FloatArray:
        place = self.place
        direct = global_jacobian(place.state, place.prediction, local, place.samples)[:, :, free]
        effects = self.path.effects.columns
        if not effects.shape[2]:
            return direct
        up = place.state.shared.body_axis.T @ effects[:, :3]
        return np.concatenate([direct, np.concatenate([up, effects[:, 3:]], axis=1)], axis=2)

    @property
    def _to_frame(self) -> FloatArray:
        """From the first sample's axes to each sample's local step, shape (n, 3, 3)."""
        return np.asarray(self.place.state.shared.body_axis.T @ self.path.relative)

    def moved(self, step: FloatArray, local: FloatArray) -> GyroBlock:
        """Return the block after a step of all globals (18,) and of the errors (c,)."""
        turned = self.path.basis @ local[: self.path.basis.shape[2]]
        turns = exp_rotations((self._to_frame @ turned[:, :, None])[:, :, 0])
        state = State(self.place.state.shared.moved(step), turns @ self.place.state.attitude)
        errors, samples = self.errors + local, self.samples
        if len(self.path.effects):
            added = self.path.added(errors)
            samples = replace(
                samples, up=samples.up - added[:, :3], field=samples.field - added[:, 3:]
            )
        return replace(self, place=Evaluation(state, samples), errors=errors)

    def weighted(self, weighting: Weighting) -> GyroBlock:
        """Return the block with another weighting."""
        return replace(self, weighting=weighting)

    def under(self, other: TurnBlock) -> GyroBlock:
        """Return this turn's place under another block's weighting and drift."""
        return replace(self, weighting=other.weighting, drift=other.drift)

    def at(self, shared: Globals) -> GyroBlock:
        """Return the block with other shared numbers; the errors start at zero."""
        state = seated(shared, self.samples, self.weighting.inliers)
        return GyroBlock.started(state, self.samples, self.weighting, self.path, self.drift)


@dataclass(frozen=True, eq=False)
class GyroEquations:
    """The normal equations of a `GyroBlock` over free globals (first) and errors (last).

    Parameters
    ----------
    block : GyroBlock
    residual : ndarray, shape (n, 6)
        Whitened, not weighted.
    information, gradient : ndarray, shape (f + c, f + c) and (f + c,)
        The prior of the errors included.
    own : ndarray, shape (f + c, f + c)
        That prior, times the inefficiency factor.
    free : int
        Number of free globals.
    """

    block: GyroBlock
    residual: FloatArray
    information: FloatArray
    gradient: FloatArray
    own: FloatArray
    free: int

    @property
    def diagonal(self) -> FloatArray:
        """Diagonal of the information on the globals, errors held, shape (f,)."""
        return np.asarray(np.diag(self.information)[: self.free])

    @property
    def lean_gradient(self) -> FloatArray:
        """No leans are integrated out; zero, shape (f,)."""
        return np.zeros(self.free)

    @property
    def attitude_shares(self) -> FloatArray:
        """One attitude for the turn costs a sample next to nothing, shape (n,)."""
        return np.zeros(len(self.residual))

    def reduced(self, damping: float) -> Reduced:
        """Eliminate the errors."""
        f, information = self.free, self.information
        among = information[f:, f:] + damping * np.diag(np.diag(information)[f:] + 1e-9)
        right = np.column_stack([self.gradient[f:], information[f:, :f]])
        # Without an inlier the gyro's own errors are not determined either.
        solve = np.linalg.solve if damping > 0.0 else _least_squares
        found = np.asarray(solve(among, right))
        local, coupling = found[:, 0], found[:, 1:]
        return Reduced(
            np.asarray(information[:f, :f] - information[:f, f:] @ coupling),
            self.gradient[:f] - information[:f, f:] @ local,
            local,
            coupling,
        )

    def renoised(self, change: float, known: FloatArray, share: float) -> GyroBlock:
        """Return the block with the noise and the drift that the residuals ask for.

        The samples pay for what they say beyond the priors (MacKay's effective parameters).
        """
        block, prior = self.block, self.own.copy()
        prior[: self.free, : self.free] = block.weighting.inefficiency * np.diag(known)
        total = self.information - self.own + prior
        covariance = _least_squares(total, np.eye(len(total)))
        shared = float(np.sum(covariance[: self.free] * prior[: self.free]))
        errors = float(np.sum(covariance[self.free :] * prior[self.free :]))
        spent = share * (self.free - shared) + len(prior) - self.free - errors
        # Where no sample is an inlier the noise shrinks no further than below; it is refused.
        count = max(float(block.weighting.weights.sample.sum()), 1.0)
        left = count * max(1.0 - spent / (5.0 * count), 0.1)
        freedom = Noise(2.0 * left, 3.0 * left, block.weighting.noise.wobble)
        noise = estimate_noise(self.residual, block.weighting, freedom, change)
        weighting = replace(block.weighting, noise=noise)
        return replace(block, weighting=weighting, drift=self._drift(covariance))

    def _drift(self, covariance: FloatArray) -> float:
        """Return the random walk that the knots ask for (the fixed point of their evidence).

        The knots were found under the drift of the round before, so the full change would swing
        between two values for ever; the geometric mean settles.
        """
        block = self.block
        path, drift = block.path, block.drift
        if path.knots == 0:
            return drift
        known = path.drifts
        rows = slice(self.free + known.start, self.free + known.stop)
        walk = block.weighting.inefficiency * block.prior_information[known, known]
        seen = 3 * path.knots - float(np.sum(covariance[rows, rows] * walk))
        moved = float(np.sum(path.knot_steps(block.errors) ** 2)) / path.spacing
        new = math.sqrt(drift * math.sqrt(moved / max(seen, 0.5)))
        return min(max(new, DRIFT.smallest, 0.5 * drift), DRIFT.largest, 2.0 * drift)


def _least_squares(matrix: FloatArray, right: FloatArray) -> FloatArray:
    return np.asarray(np.linalg.pinv(matrix, rcond=1e-14, hermitian=True) @ right)
