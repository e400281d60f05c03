"""Normal equations of the smoother: the nodes are eliminated by a banded Cholesky factorisation.

The nodes form a block tridiagonal system. What is left for the shared unknowns is the Schur
complement, whose inverse is their covariance. The time is linear in the nodes.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from magcal_ros.core.geometry.arrays import FloatArray, IntArray
from magcal_ros.core.smoother.factors import Linear
from magcal_ros.core.smoother.unknowns import LOCAL


@dataclass(frozen=True, eq=False)
class Weighted:
    """Residuals with their variance, and the Student weights that go with it.

    Parameters
    ----------
    linear : Linear
    variance : ndarray, shape (k,)
        Per component; infinite where there was no measurement.
    freedom : float
        Degrees of freedom of the Student distribution.
    """

    linear: Linear
    variance: FloatArray
    freedom: float

    @property
    def chi2(self) -> FloatArray:
        """Squared residuals over the variance, shape (k,)."""
        return np.asarray(np.sum(self.linear.residual**2, axis=1) / self.variance)

    @property
    def weight(self) -> FloatArray:
        """Student weights over the variance, shape (k,)."""
        width = self.linear.residual.shape[1]
        return np.asarray((self.freedom + width) / (self.freedom + self.chi2) / self.variance)

    @property
    def cost(self) -> float:
        """Minus twice the logarithm of the likelihood, but for a constant."""
        counted = np.isfinite(self.variance)
        width = self.linear.residual.shape[1]
        spread = (self.freedom + width) * np.log1p(self.chi2[counted] / self.freedom)
        return float(np.sum(spread + width * np.log(self.variance[counted])))


@dataclass(frozen=True, eq=False)
class Solution:
    """One Gauss-Newton step, and the covariance at the point where it was taken.

    Parameters
    ----------
    local : ndarray, shape (n, LOCAL)
        Step of the nodes' unknowns.
    shared : ndarray, shape (s,)
        Step of the shared unknowns that are free.
    covariance : ndarray, shape (s, s)
        Of the shared unknowns that are free.
    follow : ndarray, shape (n, LOCAL, s)
        By how much the nodes' unknowns follow the shared ones, with the opposite sign.
    information : ndarray, shape (s, s)
        Of the shared unknowns, with the nodes' unknowns integrated out.
    gradient : ndarray, shape (s,)
        What the step of the shared unknowns solves for: `information @ shared`.
    log_determinant, of_nodes : float
        Of the information matrix of all unknowns, and of that of the nodes' unknowns alone.
    diagonal, upper : ndarray, shape (n, LOCAL, LOCAL), (n - 1, LOCAL, LOCAL)
        The information matrix of the nodes' unknowns.
    """

    local: FloatArray
    shared: FloatArray
    covariance: FloatArray
    follow: FloatArray
    information: FloatArray
    gradient: FloatArray
    log_determinant: float
    of_nodes: float
    diagonal: FloatArray
    upper: FloatArray

    def node_covariance(self) -> tuple[FloatArray, FloatArray]:
        """Return the blocks of the inverse of the nodes' matrix: of a node, and with the next."""
        return _selected_inverse(self.diagonal, self.upper)

    def given(self, shared: FloatArray, covariance: FloatArray) -> Solution:
        """Return the step where more is known of the shared unknowns than this window tells."""
        local = self.local + self.follow @ (self.shared - shared)
        return replace(self, local=local, shared=shared, covariance=covariance)


@dataclass(frozen=True, eq=False)
class Prior:
    """Gaussian priors at the point where the step is taken.

    Parameters
    ----------
    local_information, local_offset : ndarray, shape (n, LOCAL)
        Information of each of the nodes' unknowns, and its expectation less its value.
    information : ndarray, shape (s, s)
        Of the shared unknowns that are free.
    offset : ndarray, shape (s,)
        Their expectation less their value.
    """

    local_information: FloatArray
    local_offset: FloatArray
    information: FloatArray
    offset: FloatArray


def solve(weighted: list[Weighted], prior: Prior, free: IntArray) -> Solution:
    """Take a Gauss-Newton step.

    Parameters
    ----------
    weighted : list of Weighted
    prior : Prior
    free : ndarray of int, shape (s,)
        Which of the shared unknowns are free.

    Raises
    ------
    numpy.linalg.LinAlgError
        If the matrix is not positive definite.
    """
    # Nobody who fits nothing loads it.
    from scipy.linalg import cho_solve_banded, cholesky_banded

    nodes, count = len(prior.local_information), len(free)
    diagonal = np.zeros((nodes, LOCAL, LOCAL))
    upper = np.zeros((nodes - 1, LOCAL, LOCAL))
    right = np.zeros((nodes, LOCAL, 1 + count))
    information = prior.information.copy()
    gradient = prior.information @ prior.offset
    each = np.arange(LOCAL)
    diagonal[:, each, each] = prior.local_information
    right[:, :, 0] = prior.local_information * prior.local_offset
    for part in weighted:
        linear, weight = part.linear, part.weight[:, None, None]
        sides = [linear.residual[:, :, None]]
        if linear.shared is not None:
            shared = linear.by(free)
            sides.append(shared)
            known = shared.shape[2]
            flat, heavy = shared.reshape(-1, known), (weight * shared).reshape(-1, known)
            information[:known, :known] += flat.T @ heavy
            gradient[:known] += heavy.T @ linear.residual.ravel()
        side = np.concatenate(sides, axis=2)
        width = side.shape[2]
        heavy_here = np.swapaxes(weight * linear.here, 1, 2)
        rows = slice(0, len(side))
        diagonal[rows] += heavy_here @ linear.here
        right[rows, :, :width] += heavy_here @ side
        if linear.there is not None:
            heavy_there = np.swapaxes(weight * linear.there, 1, 2)
            diagonal[1:] += heavy_there @ linear.there
            right[1:, :, :width] += heavy_there @ side
            upper += heavy_here @ linear.there
    factor = cholesky_banded(_banded(diagonal, upper), lower=True, check_finite=False)
    solved = cho_solve_banded((factor, True), right.reshape(nodes * LOCAL, -1), check_finite=False)
    cross = right[:, :, 1:].reshape(nodes * LOCAL, count)
    schur = information - cross.T @ solved[:, 1:]
    gradient -= cross.T @ solved[:, 0]
    schur = 0.5 * (schur + schur.T)
    covariance, by_shared = inverse_and_log_determinant(schur)
    step = covariance @ gradient
    local = (solved[:, 0] - solved[:, 1:] @ step).reshape(nodes, LOCAL)
    own = 2.0 * float(np.sum(np.log(factor[0])))
    follow, both = solved[:, 1:].reshape(nodes, LOCAL, count), own + by_shared
    return Solution(local, step, covariance, follow, schur, gradient, both, own, diagonal, upper)


def inverse_and_log_determinant(information: FloatArray) -> tuple[FloatArray, float]:
    """Return the inverse of a positive definite matrix, and the logarithm of its determinant."""
    values, vectors = np.linalg.eigh(information)
    values = np.maximum(values, 1e-12 * values[-1])
    return (vectors / values) @ vectors.T, float(np.sum(np.log(values)))


def _banded(diagonal: FloatArray, upper: FloatArray) -> FloatArray:
    """Return a symmetric block tridiagonal matrix in LAPACK's lower banded form."""
    count = len(diagonal)
    out = np.zeros((2 * LOCAL, count * LOCAL))
    for a in range(LOCAL):
        for b in range(a + 1):
            out[a - b, b::LOCAL] = diagonal[:, a, b]
        for b in range(LOCAL):
            out[LOCAL + a - b, b : (count - 1) * LOCAL : LOCAL] = upper[:, b, a]
    return out


def _selected_inverse(diagonal: FloatArray, upper: FloatArray) -> tuple[FloatArray, FloatArray]:
    count = len(diagonal)
    pivot, gain = np.empty_like(diagonal), np.empty_like(upper)
    pivot[0] = diagonal[0]
    for k in range(count - 1):
        gain[k] = np.linalg.solve(pivot[k], upper[k])
        pivot[k + 1] = diagonal[k + 1] - upper[k].T @ gain[k]
    own = np.asarray(np.linalg.inv(pivot), dtype=np.float64)
    next_to = np.empty_like(upper)
    for k in range(count - 2, -1, -1):
        next_to[k] = -gain[k] @ own[k + 1]
        own[k] -= next_to[k] @ gain[k].T
    return own, next_to
