"""Normal equations of the smoother: the nodes are eliminated block by block.

The nodes form a block tridiagonal system. What is left for the shared unknowns is the Schur
complement, whose inverse is their covariance. The time is linear in the nodes.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from magcal_ros.core.geometry.arrays import BoolArray, FloatArray, IntArray
from magcal_ros.core.smoother.factors import Linear
from magcal_ros.core.smoother.unknowns import LOCAL


@dataclass(frozen=True, eq=False)
class Weighted:
    """Residuals with their variance and Student weights."""

    linear: Linear
    variance: FloatArray  # per component; infinite where there was no measurement. Shape (k,).
    freedom: float | FloatArray  # degrees of freedom of the Student distribution, one or (k,)
    sized: Mapping[str, BoolArray] = field(default_factory=dict)
    """By size of noise (`SIZES`), the residuals whose standard deviation is proportional to it.
    Shapes (k,)."""
    is_expected: bool = False
    """Whether the weights are the expected curvature of the cost, of which the inverse is the
    covariance; those of the steps bound the cost from above (Lange, Little and Taylor, JASA 84,
    1989)."""

    @cached_property
    def chi2(self) -> FloatArray:
        """Squared residuals over the variance, shape (k,)."""
        return np.asarray(np.sum(self.linear.residual**2, axis=1) / self.variance)

    @cached_property
    def weight(self) -> FloatArray:
        """Student weights over the variance, shape (k,)."""
        reach = self.freedom + self.linear.residual.shape[1]
        weight = reach / (self.freedom + self.chi2) / self.variance
        return np.asarray(weight * reach / (reach + 2.0) if self.is_expected else weight)

    @property
    def imagined(self) -> Weighted:
        """Imagined samples of the same kind: zero residuals, and the expected curvature."""
        linear = replace(self.linear, residual=np.zeros_like(self.linear.residual))
        reach = self.freedom + linear.residual.shape[1]
        variance = self.variance * (reach + 2.0) / self.freedom
        return replace(self, linear=linear, variance=variance)

    @property
    def costs(self) -> FloatArray:
        """Minus twice the log of each likelihood, up to a constant, shape (k,)."""
        variance = np.where(np.isfinite(self.variance), self.variance, 1.0)
        return np.asarray(self.misfits + self.linear.residual.shape[1] * np.log(variance))

    @property
    def misfits(self) -> FloatArray:
        """The part of each cost that grows with the residual, shape (k,)."""
        width = self.linear.residual.shape[1]
        return np.asarray((self.freedom + width) * np.log1p(self.chi2 / self.freedom))

    @property
    def cost(self) -> float:
        """The sum of `costs`."""
        return float(np.sum(self.costs))


@dataclass(frozen=True, eq=False)
class Solution:
    """One Gauss-Newton step, and the covariance at its linearisation point."""

    local: FloatArray  # step of the nodes' unknowns. Shape (n, LOCAL).
    shared: FloatArray  # step of the shared unknowns that are free. Shape (s,).
    covariance: FloatArray  # of the shared unknowns that are free. Shape (s, s).
    follow: FloatArray
    """By how much the nodes' unknowns follow the shared ones, with the opposite sign. Shape (n,
    LOCAL, s)."""
    information: FloatArray
    """Of the shared unknowns, with the nodes' unknowns integrated out. Shape (s, s)."""
    gradient: FloatArray
    """What the step of the shared unknowns solves for: `information @ shared`. Shape (s,)."""
    log_determinant: float  # of the information matrix of all unknowns
    chain: Chain  # the information matrix of the nodes' unknowns

    def given(self, shared: FloatArray, covariance: FloatArray) -> Solution:
        """Return the step with further information on the shared unknowns."""
        local = self.local + self.follow @ (self.shared - shared)
        return replace(self, local=local, shared=shared, covariance=covariance)


@dataclass(frozen=True, eq=False)
class Prior:
    """Gaussian priors at the linearisation point."""

    local_information: FloatArray
    local_offset: FloatArray
    """Information of each of the nodes' unknowns, and its expectation less its value. Shape (n,
    LOCAL)."""
    information: FloatArray  # of the shared unknowns that are free. Shape (s, s).
    offset: FloatArray  # their expectation less their value. Shape (s,).


def solve(weighted: list[Weighted], prior: Prior, free: IntArray) -> Solution:
    """Return a Gauss-Newton step.

    `free` (s,) are the indices of the free shared unknowns. Raises `numpy.linalg.LinAlgError` if
    the matrix is not positive definite.
    """
    nodes, count = len(prior.local_information), len(free)
    information = prior.information.copy()
    gradient = prior.information @ prior.offset
    for part in weighted:
        if part.linear.shared is not None:
            shared = part.linear.by(free)
            known = shared.shape[2]
            flat = shared.reshape(-1, known)
            heavy = (part.weight[:, None, None] * shared).reshape(-1, known)
            information[:known, :known] += flat.T @ heavy
            gradient[:known] += heavy.T @ part.linear.residual.ravel()
    diagonal, upper, right = _of_nodes(weighted, prior, free)
    chain = block_chain(diagonal, upper)
    solved = chain.solve(right).reshape(nodes * LOCAL, -1)
    cross = right[:, :, 1:].reshape(nodes * LOCAL, count)
    schur = information - cross.T @ solved[:, 1:]
    gradient -= cross.T @ solved[:, 0]
    schur = 0.5 * (schur + schur.T)
    covariance, by_shared = inverse_and_log_determinant(schur)
    step = covariance @ gradient
    local = (solved[:, 0] - solved[:, 1:] @ step).reshape(nodes, LOCAL)
    follow = solved[:, 1:].reshape(nodes, LOCAL, count)
    both = chain.log_determinant + by_shared
    return Solution(local, step, covariance, follow, schur, gradient, both, chain)


def log_determinants(cases: list[list[Weighted]], prior: Prior) -> list[float]:
    """Return the log determinant of the nodes' unknowns' information matrix for each case.

    The cases are eliminated side by side: a small matrix costs as much as several.
    """
    alone = np.zeros(0, dtype=np.intp)
    blocks = [_of_nodes(weighted, prior, alone)[:2] for weighted in cases]
    pivot, upper = (np.stack(each, axis=1) for each in zip(*blocks, strict=True))
    for k, beside in enumerate(upper):
        gain = np.linalg.inv(pivot[k]) @ beside
        pivot[k + 1] -= np.swapaxes(beside, 1, 2) @ gain
    return [_log_determinant(pivot[:, case]) for case in range(len(cases))]


def _of_nodes(
    weighted: list[Weighted], prior: Prior, free: IntArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the nodes' diagonal and off-diagonal blocks, gradient, and blocks with the shared."""
    nodes, count = len(prior.local_information), len(free)
    diagonal = np.zeros((nodes, LOCAL, LOCAL))
    upper = np.zeros((nodes - 1, LOCAL, LOCAL))
    right = np.zeros((nodes, LOCAL, 1 + count))
    each = np.arange(LOCAL)
    diagonal[:, each, each] = prior.local_information
    right[:, :, 0] = prior.local_information * prior.local_offset
    for parts in _alike(weighted):
        rows = len(parts[0].linear.here)
        design, weight = _stacked(parts, free)
        reached = design.shape[2] - 1 - count
        product = np.swapaxes(weight[:, :, None] * design[:, :, :reached], 1, 2) @ design
        diagonal[:rows] += product[:, :LOCAL, :LOCAL]
        right[:rows] += product[:, :LOCAL, reached:]
        if reached > LOCAL:
            diagonal[1:] += product[:, LOCAL:, LOCAL:reached]
            upper += product[:, :LOCAL, LOCAL:reached]
            right[1:] += product[:, LOCAL:, reached:]
    return diagonal, upper, right


def inverse_and_log_determinant(information: FloatArray) -> tuple[FloatArray, float]:
    """Return the inverse of a positive definite matrix, and the logarithm of its determinant."""
    values, vectors = np.linalg.eigh(information)
    values = np.maximum(values, 1e-12 * values[-1])
    return (vectors / values) @ vectors.T, float(np.sum(np.log(values)))


def _alike(weighted: list[Weighted]) -> list[list[Weighted]]:
    """Return the residuals grouped by shape: of nodes, and of links."""
    found: dict[tuple[int, bool], list[Weighted]] = {}
    for part in weighted:
        found.setdefault((len(part.linear.here), part.linear.there is None), []).append(part)
    return list(found.values())


def _stacked(parts: list[Weighted], free: IntArray) -> tuple[FloatArray, FloatArray]:
    """Return derivatives by the nodes', residual and derivatives by the shared, and weights."""
    first = parts[0].linear
    reached = LOCAL if first.there is None else 2 * LOCAL
    width = sum(part.linear.residual.shape[1] for part in parts)
    design = np.zeros((len(first.here), width, reached + 1 + len(free)))
    weight, at = np.empty((len(first.here), width)), 0
    for part in parts:
        linear = part.linear
        rows = slice(at, at + linear.residual.shape[1])
        design[:, rows, :LOCAL] = linear.here
        if linear.there is not None:
            design[:, rows, LOCAL:reached] = linear.there
        design[:, rows, reached] = linear.residual
        if linear.shared is not None:
            shared = linear.by(free)
            design[:, rows, reached + 1 : reached + 1 + shared.shape[2]] = shared
        weight[:, rows] = part.weight[:, None]
        at = rows.stop
    return design, weight


@dataclass(frozen=True, eq=False)
class Chain:
    """A block tridiagonal matrix with its nodes eliminated, one after the other."""

    inverse: FloatArray
    """Of each node's block, when those before it are eliminated. Shape (n, LOCAL, LOCAL)."""
    gain: FloatArray
    """By how much a node follows the next, with the opposite sign. Shape (n - 1, LOCAL, LOCAL)."""
    log_determinant: float

    def solve(self, right: FloatArray) -> FloatArray:
        """Return the inverse of the matrix times columns, shape (n, LOCAL, k)."""
        forward = right.copy()
        for k, gain in enumerate(self.gain):
            forward[k + 1] -= gain.T @ forward[k]
        out = self.inverse @ forward
        for k in range(len(self.gain) - 1, -1, -1):
            out[k] -= self.gain[k] @ out[k + 1]
        return out

    def covariance(self) -> tuple[FloatArray, FloatArray]:
        """Return the inverse's blocks on the diagonal, and those to the right of it."""
        own, beside = self.inverse.copy(), np.empty_like(self.gain)
        for k in range(len(self.gain) - 1, -1, -1):
            beside[k] = -self.gain[k] @ own[k + 1]
            own[k] -= beside[k] @ self.gain[k].T
        return own, beside


def block_chain(diagonal: FloatArray, upper: FloatArray) -> Chain:
    """Eliminate the nodes of a block tridiagonal matrix, shapes (n, k, k) and (n - 1, k, k)."""
    pivot, inverse, gain = diagonal.copy(), np.empty_like(diagonal), np.empty_like(upper)
    for k, beside in enumerate(upper):
        inverse[k] = np.linalg.inv(pivot[k])
        pivot[k + 1] -= beside.T @ np.matmul(inverse[k], beside, out=gain[k])
    inverse[-1] = np.linalg.inv(pivot[-1])
    return Chain(inverse, gain, _log_determinant(pivot))


def _log_determinant(pivot: FloatArray) -> float:
    """Return that of a matrix by the blocks that its elimination leaves, shape (n, k, k)."""
    factor = np.linalg.cholesky(pivot)
    return float(2.0 * np.log(np.diagonal(factor, axis1=1, axis2=2)).sum())
