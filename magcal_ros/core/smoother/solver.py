"""Normal equations of the smoother: the nodes are eliminated block by block.

The nodes form a block tridiagonal system. The Schur complement is the information on the shared
unknowns; its inverse is their covariance. The time is linear in the number of nodes.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cache, cached_property

import numpy as np

from magcal_ros.core.geometry.arrays import BoolArray, FloatArray, IntArray
from magcal_ros.core.smoother.factors import Residuals, put
from magcal_ros.core.smoother.unknowns import LOCAL


@cache
def normaliser(freedom: float, width: int) -> float:
    """Return what the cost of a Student distribution has beyond one of a Gaussian.

    It depends on the degrees of freedom and the number of components only, and is zero for
    infinitely many degrees of freedom.
    """
    half = 0.5 * freedom
    gone = math.lgamma(half) - math.lgamma(half + 0.5 * width)
    return 2.0 * gone + width * math.log(half)


# By the standard library: scipy's special functions take longer to load than a turn to fit.
normalisers = np.frompyfunc(normaliser, 2, 1)


@dataclass(frozen=True, eq=False)
class WeightedResiduals:
    """Residuals with their variance and Student weights."""

    linear: Residuals
    variance: FloatArray  # per component; infinite where there was no measurement. Shape (k,).
    freedom: float | FloatArray  # degrees of freedom of the Student distribution, one or (k,)
    sized: Mapping[str, BoolArray] = field(default_factory=dict)
    """For each noise size (`SIZES`), the residuals whose standard deviation is proportional to it.
    Shapes (k,)."""
    is_expected: bool = False
    """Whether the weights are the expected curvature of the cost, for the covariance. The weights
    of the steps bound the cost from above (Lange, Little and Taylor, JASA 84, 1989)."""

    @cached_property
    def chi2(self) -> FloatArray:
        """Squared normalised residuals, shape (k,)."""
        return np.asarray(np.sum(self.linear.residual**2, axis=1) / self.variance)

    @cached_property
    def weight(self) -> FloatArray:
        """Student weights divided by the variance, shape (k,)."""
        reach = self.freedom + self.linear.residual.shape[1]
        weight = reach / (self.freedom + self.chi2) / self.variance
        return np.asarray(weight * self.expected_share if self.is_expected else weight)

    @property
    def expected_share(self) -> FloatArray:
        """The expected curvature of the cost over the weights of the steps, shape () or (k,)."""
        reach = np.asarray(self.freedom) + self.linear.residual.shape[1]
        return np.asarray(reach / (reach + 2.0))

    @property
    def imagined(self) -> WeightedResiduals:
        """The same for samples not yet measured: zero residuals, and the expected curvature."""
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
    def normaliser(self) -> FloatArray:
        """What each cost has beyond one of a Gaussian with the same variance, shape () or (k,)."""
        found = normalisers(self.freedom, self.linear.residual.shape[1])
        return np.asarray(found, dtype=np.float64)

    @property
    def cost(self) -> float:
        """The sum of `costs`."""
        return float(np.sum(self.costs + self.normaliser))


@dataclass(frozen=True, eq=False)
class Solution:
    """One Gauss-Newton step, and the covariance at its linearisation point."""

    local: FloatArray  # step of the nodes' unknowns. Shape (n, LOCAL).
    shared: FloatArray  # step of the shared unknowns that are free. Shape (s,).
    covariance: FloatArray  # of the shared unknowns that are free. Shape (s, s).
    follow: FloatArray
    """Minus the derivative of the nodes' optimum by the shared unknowns. Shape (n, LOCAL, s)."""
    information: FloatArray
    """Of the shared unknowns, with the nodes' unknowns marginalised. Shape (s, s)."""
    gradient: FloatArray  # `information @ shared`. Shape (s,).
    log_determinant: float  # of the information matrix of all unknowns
    chain: BlockTridiagonal  # the information matrix of the nodes' unknowns
    stacks: list[StackedResiduals]  # the residuals

    def given(self, shared: FloatArray, covariance: FloatArray) -> Solution:
        """Return the step with further information on the shared unknowns."""
        local = self.local + self.follow @ (self.shared - shared)
        return replace(self, local=local, shared=shared, covariance=covariance)


@dataclass(frozen=True, eq=False)
class Prior:
    """Gaussian priors at the linearisation point."""

    local_information: FloatArray
    local_offset: FloatArray
    """Information of each of the nodes' unknowns, and prior mean minus value. Shape (n, LOCAL)."""
    information: FloatArray  # of the shared unknowns that are free. Shape (s, s).
    offset: FloatArray  # their prior mean minus their value. Shape (s,).


def solve(weighted: list[WeightedResiduals], prior: Prior, free: IntArray) -> Solution:
    """Return a Gauss-Newton step.

    `free` (s,) are the indices of the free shared unknowns. Raises `numpy.linalg.LinAlgError` if
    the matrix is not positive definite.
    """
    nodes, count = len(prior.local_information), len(free)
    stacks = StackedResiduals.of(weighted, free)
    information = prior.information.copy()
    gradient = prior.information @ prior.offset
    for stack in stacks:
        square = stack.square
        known = len(square) - 1
        information[:known, :known] += square[1:, 1:]
        gradient[:known] += square[1:, 0]
    diagonal, upper, right = _of_nodes(stacks, prior, count)
    chain = block_tridiagonal(diagonal, upper)
    solved = chain.solve(right).reshape(nodes * LOCAL, -1)
    # Views, not copies: with many nodes, the time is that of the memory.
    cross, follow = right.reshape(nodes * LOCAL, -1)[:, 1:], solved[:, 1:]
    schur = information - cross.T @ follow
    gradient -= cross.T @ solved[:, 0]
    schur = 0.5 * (schur + schur.T)
    covariance, by_shared = inverse_and_log_determinant(schur)
    step = covariance @ gradient
    local = (solved[:, 0] - follow @ step).reshape(nodes, LOCAL)
    follow = follow.reshape(nodes, LOCAL, count)
    both = chain.log_determinant + by_shared
    return Solution(local, step, covariance, follow, schur, gradient, both, chain, stacks)


def log_determinant(weighted: list[WeightedResiduals], prior: Prior) -> float:
    """Return the log determinant of the information matrix of the nodes' unknowns."""
    stacks = StackedResiduals.of(weighted, np.zeros(0, dtype=np.intp))
    return block_tridiagonal(*_of_nodes(stacks, prior, 0)[:2]).log_determinant


@dataclass(frozen=True, eq=False)
class StackedResiduals:
    """Residuals that depend on the same unknowns, side by side."""

    columns: list[tuple[WeightedResiduals, slice]]
    """Each kind of residual, and its components among `rows`."""
    rows: FloatArray
    """Derivatives by the nodes' unknowns, residual, and derivatives by the shared unknowns. Shape
    (k, d, reached + 1 + s)."""
    weighted: FloatArray  # the same times their weights
    local: slice  # the unknowns of a node on which they depend
    reached: int  # the number of these unknowns of one node, or of two neighbours

    @classmethod
    def of(cls, weighted: list[WeightedResiduals], free: IntArray) -> list[StackedResiduals]:
        """Return the stacks: of nodes and of links, with and without shared unknowns."""
        alike: dict[tuple[int, bool, bool], list[WeightedResiduals]] = {}
        for part in weighted:
            linear = part.linear
            key = len(linear.residual), bool(linear.later), bool(linear.shared)
            alike.setdefault(key, []).append(part)
        return [cls._of_alike(parts, free) for parts in alike.values()]

    @classmethod
    def _of_alike(cls, parts: list[WeightedResiduals], free: IntArray) -> StackedResiduals:
        like, ranges = parts[0].linear, [part.linear.local for part in parts]
        first, end = min(each[0] for each in ranges), max(each[1] for each in ranges)
        reached = (end - first) * (2 if like.later else 1)
        count = len(free) if like.shared else 0
        width = sum(part.linear.residual.shape[1] for part in parts)
        rows = np.zeros((len(like.residual), width, reached + 1 + count))
        weight, columns, at = np.empty((len(rows), width, 1)), [], 0
        for part in parts:
            linear = part.linear
            own = slice(at, at + linear.residual.shape[1])
            put(rows[:, own], linear.node, first)
            put(rows[:, own, end - first :], linear.later, first)
            rows[:, own, reached] = linear.residual
            linear.put_shared(rows[:, own, reached + 1 :], free)
            weight[:, own, 0] = part.weight[:, None]
            columns.append((part, own))
            at = own.stop
        return cls(columns, rows, weight * rows, slice(first, end), reached)

    @property
    def is_linking(self) -> bool:
        """Whether each of the residuals depends on two neighbouring nodes."""
        return bool(self.reached > self.local.stop - self.local.start)

    @property
    def square(self) -> FloatArray:
        """Normal equations of the shared unknowns, residual first, shape (1 + s, 1 + s)."""
        right, heavy = (each[:, :, self.reached :] for each in (self.rows, self.weighted))
        width = right.shape[2]
        return np.asarray(right.reshape(-1, width).T @ heavy.reshape(-1, width))


def _of_nodes(
    stacks: list[StackedResiduals], prior: Prior, count: int
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the nodes' diagonal and upper blocks, and gradient with blocks of shared unknowns."""
    nodes = len(prior.local_information)
    diagonal = np.zeros((nodes, LOCAL, LOCAL))
    upper = np.zeros((nodes - 1, LOCAL, LOCAL))
    right = np.zeros((nodes, LOCAL, 1 + count))
    each = np.arange(LOCAL)
    diagonal[:, each, each] = prior.local_information
    right[:, :, 0] = prior.local_information * prior.local_offset
    for stack in stacks:
        local, reached, number = stack.local, stack.reached, len(stack.rows)
        span = local.stop - local.start
        product = np.swapaxes(stack.rows[:, :, :reached], 1, 2) @ stack.weighted
        known = product.shape[2] - reached
        diagonal[:number, local, local] += product[:, :span, :span]
        right[:number, local, :known] += product[:, :span, reached:]
        if stack.is_linking:
            diagonal[1:, local, local] += product[:, span:, span:reached]
            upper[:, local, local] += product[:, :span, span:reached]
            right[1:, local, :known] += product[:, span:, reached:]
    return diagonal, upper, right


def inverse_and_log_determinant(information: FloatArray) -> tuple[FloatArray, float]:
    """Return the inverse of a positive definite matrix, and the logarithm of its determinant."""
    try:
        factor = np.linalg.cholesky(information)
        back = np.linalg.inv(factor)
        return back.T @ back, float(2.0 * np.log(np.diagonal(factor)).sum())
    except np.linalg.LinAlgError:
        # By rounding errors the smallest eigenvalues may be negative.
        values, vectors = np.linalg.eigh(information)
    values = np.maximum(values, 1e-12 * values[-1])
    return (vectors / values) @ vectors.T, float(np.sum(np.log(values)))


@dataclass(frozen=True, eq=False)
class BlockTridiagonal:
    """A block tridiagonal matrix, factorised by cyclic reduction (Hockney, J. ACM 12, 1965).

    Every second node is eliminated at once, then every second of the remaining nodes, and so on.
    """

    inverse: FloatArray
    """Of the blocks of the eliminated nodes 0, 2, 4, ... Shape (m, LOCAL, LOCAL)."""
    before: FloatArray
    """`inverse` times the block of these nodes, except the first, with the node before."""
    after: FloatArray
    """`inverse` times the block of these nodes with the node after, if there is one."""
    rest: BlockTridiagonal | None  # the other nodes
    log_determinant: float

    def solve(self, right: FloatArray) -> FloatArray:
        """Return the inverse of the matrix times columns, shape (n, LOCAL, k)."""
        own = right[::2]
        out = np.empty_like(right)
        out[::2] = self.inverse @ own
        if self.rest is None:
            return out
        left, next_to = len(self.before), len(self.after)
        other = right[1::2] - np.swapaxes(self.after, 1, 2) @ own[:next_to]
        other[:left] -= np.swapaxes(self.before, 1, 2) @ own[1:]
        out[1::2] = others = self.rest.solve(other)
        out[:-1:2] -= self.after @ others
        out[2::2] -= self.before @ others[:left]
        return out

    def covariance(self) -> tuple[FloatArray, FloatArray]:
        """Return the inverse's blocks on the diagonal, and those to the right of it."""
        if self.rest is None:
            return self.inverse.copy(), np.empty((0, *self.inverse.shape[1:]))
        others, between = self.rest.covariance()
        left, right = len(self.before), len(self.after)
        own = np.empty((len(self.inverse) + len(others), *self.inverse.shape[1:]))
        beside = np.empty((len(own) - 1, *self.inverse.shape[1:]))
        own[1::2], inner = others, len(between)
        # Covariances of the eliminated nodes with the node after and the node before.
        by_after, by_before = -self.after @ others, -self.before @ others[:left]
        by_after[1:] -= self.before[: right - 1] @ between
        by_before[:inner] -= self.after[1 : inner + 1] @ np.swapaxes(between, 1, 2)
        own[::2] = self.inverse
        own[:-1:2] -= by_after @ np.swapaxes(self.after, 1, 2)
        own[2::2] -= by_before @ np.swapaxes(self.before, 1, 2)
        beside[::2] = by_after
        beside[1::2] = np.swapaxes(by_before, 1, 2)
        return own, beside


def block_tridiagonal(diagonal: FloatArray, upper: FloatArray) -> BlockTridiagonal:
    """Eliminate the nodes of a block tridiagonal matrix, shapes (n, k, k) and (n - 1, k, k)."""
    pivot = diagonal[::2]
    inverse = np.asarray(np.linalg.inv(pivot), dtype=np.float64)
    factor = np.linalg.cholesky(pivot)
    determinant = float(2.0 * np.log(np.diagonal(factor, axis1=1, axis2=2)).sum())
    if len(diagonal) == 1:
        return BlockTridiagonal(inverse, upper, upper, None, determinant)
    # Blocks of the eliminated nodes with the node after, and of the node before with them.
    later, earlier = upper[::2], upper[1::2]
    after = inverse[: len(later)] @ later
    before = inverse[1:] @ np.swapaxes(earlier, 1, 2)
    left = diagonal[1::2] - np.swapaxes(later, 1, 2) @ after
    left[: len(earlier)] -= earlier @ before
    inner = len(left) - 1
    rest = block_tridiagonal(left, -earlier[:inner] @ after[1 : inner + 1])
    return BlockTridiagonal(inverse, before, after, rest, determinant + rest.log_determinant)
