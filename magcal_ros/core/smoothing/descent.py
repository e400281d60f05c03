"""The smoother itself: Gauss-Newton on all nodes at once, robust, and the sizes of its noise.

The nodes' own unknowns form a chain, each tied to its neighbours alone, so that they are eliminated
in time linear in their number: a block tridiagonal system solved as a band, and a Schur complement
of what they share (Triggs et al., 2000).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from magcal_ros.core.geometry.arrays import FloatArray
from magcal_ros.core.smoother.solver import block_chain
from magcal_ros.core.smoothing.drive_model import (
    GYRO_BIAS,
    GYRO_SCALE,
    SHARED,
    SharedPrior,
    Unknowns,
    field_jacobians,
    field_of,
    gyro_residual,
)
from magcal_ros.core.smoothing.nodes import Nodes
from magcal_ros.core.smoothing.tuning import TUNING

UNTIED = 1e-4
"""Information of the gyro on a yaw that it did not watch."""


LOCAL = 4
"""Unknowns of a node: yaw and three of street. Neighbours are tied yaw to yaw and axis to axis,
so the band is as wide as one node."""


@dataclass(frozen=True, eq=False)
class Equations:
    """Normal equations of a chain and of what its nodes share."""

    blocks: FloatArray
    """Information of each node on itself. Shape (n, 4, 4)."""
    ties: FloatArray
    """Diagonal of the information between each node and the next. Shape (n - 1, 4)."""
    coupling: FloatArray
    """Information between each node and what is shared. Shape (n, 4, g)."""
    shared: FloatArray
    """Information on what is shared. Shape (g, g)."""
    local_gradient: FloatArray
    shared_gradient: FloatArray
    """Downhill. Shape (n, 4), (g,)."""

    def covariances(self) -> tuple[FloatArray, FloatArray]:
        """Return each node's covariance, and that with the next, what is shared held."""
        return block_chain(self.blocks, self.ties[:, :, None] * np.eye(LOCAL)).covariance()


@dataclass(frozen=True, eq=False)
class Eliminated:
    """A chain's unknowns taken out."""

    shared_step: FloatArray
    local_step: FloatArray
    """To the optimum of the normal equations. Shape (g,)."""
    information: FloatArray
    """Schur complement: what is known of the shared numbers. Shape (g, g)."""


def eliminate(chain: Equations) -> Eliminated | None:
    """Solve the normal equations; None where they are not positive definite."""
    # Loaded only by who fits a drive: it takes longer than all the rest of the package.
    from scipy.linalg import cho_solve_banded, cholesky_banded

    n, g = len(chain.blocks), len(chain.shared)
    band = np.zeros((LOCAL + 1, LOCAL * n))
    for row in range(LOCAL):
        for column in range(row + 1):
            band[row - column, column::LOCAL] = chain.blocks[:, row, column]
    band[LOCAL, : LOCAL * (n - 1)] = chain.ties.ravel()
    right = np.empty((LOCAL * n, g + 1))
    right[:, :g] = chain.coupling.reshape(-1, g)
    right[:, g] = chain.local_gradient.ravel()
    try:
        factor = cholesky_banded(band, lower=True, check_finite=False)
        solved = cho_solve_banded((factor, True), right, check_finite=False)
        cross = right[:, :g].T @ solved
        information = np.asarray(chain.shared - cross[:, :g], dtype=np.float64)
        # Only to find out whether it is positive definite.
        np.linalg.cholesky(0.5 * (information + information.T))
    except np.linalg.LinAlgError:
        return None
    left = chain.shared_gradient - cross[:, g]
    shared = np.asarray(np.linalg.solve(information, left), dtype=np.float64)
    local = solved[:, g] - solved[:, :g] @ shared
    return Eliminated(shared, local.reshape(n, LOCAL), information)


@dataclass(frozen=True)
class Sizes:
    """How large street and noise are, over the usual."""

    street: float = 1.0
    noise: float = 1.0


@dataclass(frozen=True, eq=False)
class Problem:
    """A drive, what is known, and how it is weighed."""

    nodes: Nodes
    prior: SharedPrior
    sizes: Sizes = Sizes()

    @cached_property
    def keeps(self) -> FloatArray:
        """Share of the street that lasts from the node before, shape (n - 1,)."""
        lasting = np.exp(-self.nodes.metres[1:] / TUNING.reach)
        # A robot that stands sees the same street, and a chain may not be tied without end.
        return np.asarray(np.minimum(lasting, 1.0 - 1e-4))

    @property
    def street(self) -> float:
        """Standard deviation of the street per axis, microtesla."""
        return self.sizes.street * TUNING.street

    @property
    def noise(self) -> float:
        """The same of the field's noise."""
        return self.sizes.noise * TUNING.noise

    @cached_property
    def street_variance(self) -> FloatArray:
        """Of the street's change from node to node, of the first its own, shape (n,)."""
        whole = self.street**2
        return np.concatenate([[whole], whole * (1.0 - self.keeps**2)])

    @cached_property
    def gyro_information(self) -> FloatArray:
        """Of the gyro on the turn from node to node, shape (n - 1,)."""
        variance = TUNING.angle_walk**2 * np.maximum(self.nodes.seconds[1:], 1e-3)
        return np.where(self.nodes.is_tied[1:], 1.0 / variance, UNTIED)


@dataclass(frozen=True, eq=False)
class Linearisation:
    """Residuals, weights and cost at one linearisation point."""

    problem: Problem
    unknowns: Unknowns

    @cached_property
    def field(self) -> FloatArray:
        """Field read less expected, shape (n, 3)."""
        return np.asarray(self.problem.nodes.field - field_of(self.problem.nodes, self.unknowns))

    @cached_property
    def street(self) -> FloatArray:
        """Change of the street, shape (n, 3)."""
        change = self.unknowns.street.copy()
        change[1:] -= self.problem.keeps[:, None] * self.unknowns.street[:-1]
        return change

    @cached_property
    def gyro(self) -> FloatArray:
        """Yaw less the gyro's from node to node, shape (n - 1,)."""
        return gyro_residual(self.problem.nodes, self.unknowns)

    @cached_property
    def squares(self) -> tuple[FloatArray, FloatArray]:
        """Squares of field and street residuals over their variance, shape (n,) each."""
        field = np.sum(self.field**2, axis=1) / self.problem.noise**2
        street = np.sum(self.street**2, axis=1) / self.problem.street_variance
        return field, street

    @cached_property
    def weights(self) -> tuple[FloatArray, FloatArray]:
        """Of field and street, Student's, shape (n,) each."""
        nu = TUNING.freedom
        field, street = self.squares
        return (nu + 3.0) / (nu + field), (nu + 3.0) / (nu + street)

    @cached_property
    def node_costs(self) -> FloatArray:
        """What each node has of `misfit`, shape (n,)."""
        nu = TUNING.freedom
        costs = sum((nu + 3.0) * np.log1p(square / nu) for square in self.squares)
        gyro = np.concatenate([[0.0], self.gyro**2 * self.problem.gyro_information])
        return np.asarray(costs + gyro)

    @cached_property
    def shared_gap(self) -> FloatArray:
        """Shared numbers less their prior, shape (14,)."""
        return np.asarray(self.unknowns.shared - self.problem.prior.mean)

    @cached_property
    def misfit(self) -> float:
        """Minus twice the log likelihood of the nodes, but for the sizes' own part."""
        nu = TUNING.freedom
        robust = (nu + 3.0) * sum(np.log1p(square / nu).sum() for square in self.squares)
        return float(robust + self.gyro**2 @ self.problem.gyro_information)

    @cached_property
    def cost(self) -> float:
        """The same with the prior's part."""
        gap = self.shared_gap
        return self.misfit + float(gap @ self.problem.prior.information @ gap)

    @cached_property
    def chain(self) -> Equations:
        """The normal equations here."""
        problem, nodes = self.problem, self.problem.nodes
        local, every = field_jacobians(nodes, self.unknowns)
        field_weight, street_weight = self.weights
        weight = field_weight / problem.noise**2
        pulled = local * weight[:, None, None]
        blocks = np.swapaxes(pulled, 1, 2) @ local
        coupling = np.swapaxes(pulled, 1, 2) @ every
        down = np.einsum("nij,ni->nj", pulled, self.field)
        lifted = (every * weight[:, None, None]).reshape(-1, SHARED)
        shared = lifted.T @ every.reshape(-1, SHARED)
        shared_down = lifted.T @ self.field.ravel()
        ties = np.empty((len(nodes) - 1, 4))
        self._add_street(blocks, ties, down, street_weight)
        self._add_gyro(blocks, ties, coupling, down, shared, shared_down)
        information = problem.prior.information
        shared += information
        shared_down -= information @ self.shared_gap
        return Equations(blocks, ties, coupling, shared, down, shared_down)

    def _add_street(
        self, blocks: FloatArray, ties: FloatArray, down: FloatArray, weight: FloatArray
    ) -> None:
        known, keeps = weight / self.problem.street_variance, self.problem.keeps
        axes = np.arange(1, 4)
        blocks[:, axes, axes] += known[:, None]
        blocks[:-1, axes, axes] += (keeps**2 * known[1:])[:, None]
        ties[:, 1:] = -(keeps * known[1:])[:, None]
        pull = known[:, None] * self.street
        down[:, 1:] -= pull
        down[:-1, 1:] += keeps[:, None] * pull[1:]

    def _add_gyro(
        self,
        blocks: FloatArray,
        ties: FloatArray,
        coupling: FloatArray,
        down: FloatArray,
        shared: FloatArray,
        shared_down: FloatArray,
    ) -> None:
        known = self.problem.gyro_information
        blocks[1:, 0, 0] += known
        blocks[:-1, 0, 0] += known
        ties[:, 0] = -known
        nodes = self.problem.nodes
        by_shared = np.stack([nodes.seconds[1:], -nodes.turned[1:]], axis=1)
        own = slice(GYRO_BIAS, GYRO_SCALE + 1)
        coupling[1:, 0, own] += known[:, None] * by_shared
        coupling[:-1, 0, own] -= known[:, None] * by_shared
        shared[own, own] += by_shared.T @ (known[:, None] * by_shared)
        pull = known * self.gyro
        down[1:, 0] -= pull
        down[:-1, 0] += pull
        shared_down[own] -= by_shared.T @ pull


@dataclass(frozen=True, eq=False)
class Smoothed:
    """The optimum."""

    here: Linearisation
    eliminated: Eliminated
    """Of the normal equations there."""
    rounds: int
    """Steps that were taken."""
    converged: bool
    """Whether the last one moved nothing."""

    @property
    def problem(self) -> Problem:
        """What was solved."""
        return self.here.problem

    @property
    def unknowns(self) -> Unknowns:
        """What was found."""
        return self.here.unknowns


def descend(problem: Problem, unknowns: Unknowns) -> Smoothed | None:
    """Take robust Gauss-Newton steps to the optimum; None where no step can be made."""
    here = Linearisation(problem, unknowns)
    rounds, moved = 0, np.inf
    eliminated = eliminate(here.chain)
    while eliminated is not None and rounds < TUNING.most_rounds and moved > TUNING.enough:
        largest = float(np.abs(eliminated.local_step[:, 0]).max())
        share = min(1.0, TUNING.largest_turn / max(largest, 1e-12))
        for _ in range(5):
            tried = Linearisation(
                problem,
                here.unknowns.moved(share * eliminated.shared_step, share * eliminated.local_step),
            )
            if tried.cost <= here.cost + 1e-6:
                break
            share *= 0.4
        moved = share * largest
        here, rounds = tried, rounds + 1
        eliminated = eliminate(here.chain)
    if eliminated is None:
        return None
    return Smoothed(here, eliminated, rounds, moved <= TUNING.enough)


def sizes_of(smoothed: Smoothed) -> Sizes:
    """Return how large street and noise are, from their residuals and what these cost.

    The degrees of freedom that are left to each are counted as in MacKay (1992); some observations
    of the usual size keep both from vanishing.
    """
    problem, here = smoothed.problem, smoothed.here
    n = len(problem.nodes)
    own, between = here.chain.covariances()
    local, _ = field_jacobians(problem.nodes, here.unknowns)
    field_weight, street_weight = here.weights
    spent = np.einsum("nij,njk,nik->n", local, own, local) / problem.noise**2
    field_left = 3.0 * n - float(field_weight @ spent)
    keeps = problem.keeps
    trace = np.einsum("nii->n", own[:, 1:, 1:])
    cross = np.einsum("nii->n", between[:, 1:, 1:])
    change = trace.copy()
    change[1:] += keeps**2 * trace[:-1] - 2.0 * keeps * cross
    street_left = 3.0 * n - float(street_weight @ (change / problem.street_variance))
    field, street = (
        float(weight @ square) for weight, square in zip(here.weights, here.squares, strict=True)
    )
    return Sizes(
        max(TUNING.least_street, _size(problem.sizes.street, street, street_left, TUNING.pseudo)),
        max(TUNING.least_noise, _size(problem.sizes.noise, field, field_left, TUNING.pseudo)),
    )


def _size(before: float, squares: float, left: float, pseudo: float) -> float:
    variance = (before**2 * squares + pseudo) / (max(left, 0.0) + pseudo)
    return float(np.sqrt(variance))


def smooth(problem: Problem, unknowns: Unknowns, reviews: int = 4) -> Smoothed | None:
    """Find the optimum and the sizes of street and noise in turn.

    Parameters
    ----------
    problem : Problem
    unknowns : Unknowns
        Where to start.
    reviews : int
        How often the sizes are estimated.
    """
    found = descend(problem, unknowns)
    for _ in range(reviews):
        if found is None:
            return None
        sizes = sizes_of(found)
        prior = problem.prior.widened(found.unknowns.shared)
        problem = replace(problem, sizes=sizes, prior=prior)
        found = descend(problem, found.unknowns)
    return found
