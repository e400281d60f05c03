"""The smoother itself: Gauss-Newton on all nodes at once, robust, and the sizes of its noise."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from magcal_ros.core.geometry.arrays import FloatArray
from magcal_ros.core.geometry.attitude import wrap_angle
from magcal_ros.core.smoothing.chain import Chain, Eliminated, eliminate, own_covariances
from magcal_ros.core.smoothing.drive_model import (
    GYRO_BIAS,
    GYRO_SCALE,
    OFFSET,
    SHARED,
    SharedPrior,
    Unknowns,
    field_jacobians,
    field_of,
    gyro_residual,
)
from magcal_ros.core.smoothing.nodes import Nodes
from magcal_ros.core.smoothing.tuning import TUNING, SmootherTuning

UNTIED = 1e-4
"""Information of the gyro on a yaw that it did not watch."""


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
    declination: float = 0.0
    """Radians, for the course."""
    sizes: Sizes = Sizes()
    tuning: SmootherTuning = TUNING

    @cached_property
    def keeps(self) -> FloatArray:
        """Share of the street that lasts from the node before, shape (n - 1,)."""
        lasting = np.exp(-self.nodes.metres[1:] / self.tuning.reach)
        # A robot that stands sees the same street, and a chain may not be tied without end.
        return np.asarray(np.minimum(lasting, 1.0 - 1e-4))

    @cached_property
    def street_variance(self) -> FloatArray:
        """Of the street's change from node to node, of the first its own, shape (n,)."""
        whole = (self.sizes.street * self.tuning.street) ** 2
        return np.concatenate([[whole], whole * (1.0 - self.keeps**2)])

    @property
    def noise_variance(self) -> float:
        """Of the field's noise per axis."""
        return (self.sizes.noise * self.tuning.noise) ** 2

    @cached_property
    def gyro_information(self) -> FloatArray:
        """Of the gyro on the turn from node to node, shape (n - 1,)."""
        variance = self.tuning.angle_walk**2 * np.maximum(self.nodes.seconds[1:], 1e-3)
        return np.where(self.nodes.is_tied[1:], 1.0 / variance, UNTIED)

    @cached_property
    def course_information(self) -> FloatArray:
        """Of the course on the yaw, shape (n,)."""
        return np.asarray(self.nodes.course_sigma**-2.0)


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
    def course(self) -> FloatArray:
        """Yaw and offset less course, shape (n,)."""
        expected = self.unknowns.yaw - self.problem.declination + self.unknowns.shared[OFFSET]
        return wrap_angle(expected - self.problem.nodes.course)

    @cached_property
    def squares(self) -> tuple[FloatArray, FloatArray]:
        """Squares of field and street residuals over their variance, shape (n,) each."""
        field = np.sum(self.field**2, axis=1) / self.problem.noise_variance
        street = np.sum(self.street**2, axis=1) / self.problem.street_variance
        return field, street

    @cached_property
    def weights(self) -> tuple[FloatArray, FloatArray]:
        """Of field and street, Student's, shape (n,) each."""
        nu = self.problem.tuning.freedom
        field, street = self.squares
        return (nu + 3.0) / (nu + field), (nu + 3.0) / (nu + street)

    @cached_property
    def node_costs(self) -> FloatArray:
        """What each node has of `misfit`, the course left out, shape (n,)."""
        nu = self.problem.tuning.freedom
        costs = sum((nu + 3.0) * np.log1p(square / nu) for square in self.squares)
        gyro = np.concatenate([[0.0], self.gyro**2 * self.problem.gyro_information])
        return np.asarray(costs + gyro)

    @cached_property
    def shared_gap(self) -> FloatArray:
        """Shared numbers less their prior, shape (15,)."""
        return np.asarray(self.unknowns.shared - self.problem.prior.mean)

    @cached_property
    def misfit(self) -> float:
        """Minus twice the log likelihood of the nodes, but for the sizes' own part."""
        nu = self.problem.tuning.freedom
        robust = (nu + 3.0) * sum(np.log1p(square / nu).sum() for square in self.squares)
        gyro = float(self.gyro**2 @ self.problem.gyro_information)
        return float(robust + gyro + self.course**2 @ self.problem.course_information)

    @cached_property
    def cost(self) -> float:
        """The same with the prior's part."""
        gap = self.shared_gap
        return self.misfit + float(gap @ self.problem.prior.information @ gap)

    @cached_property
    def chain(self) -> Chain:
        """The normal equations here."""
        problem, nodes = self.problem, self.problem.nodes
        local, every = field_jacobians(nodes, self.unknowns)
        field_weight, street_weight = self.weights
        weight = field_weight / problem.noise_variance
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
        course = problem.course_information
        blocks[:, 0, 0] += course
        coupling[:, 0, OFFSET] += course
        shared[OFFSET, OFFSET] += course.sum()
        down[:, 0] -= course * self.course
        shared_down[OFFSET] -= course @ self.course
        information = problem.prior.information
        shared += information
        shared_down -= information @ self.shared_gap
        return Chain(blocks, ties, coupling, shared, down, shared_down)

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
    tuning = problem.tuning
    here = Linearisation(problem, unknowns)
    rounds, moved = 0, np.inf
    eliminated = eliminate(here.chain)
    while eliminated is not None and rounds < tuning.most_rounds and moved > tuning.enough:
        largest = float(np.abs(eliminated.local_step[:, 0]).max())
        share = min(1.0, tuning.largest_turn / max(largest, 1e-12))
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
    return Smoothed(here, eliminated, rounds, moved <= tuning.enough)


def sizes_of(smoothed: Smoothed) -> Sizes:
    """Return how large street and noise are, from their residuals and what these cost.

    The degrees of freedom that are left to each are counted as in MacKay (1992); some observations
    of the usual size keep both from vanishing.
    """
    problem, here = smoothed.problem, smoothed.here
    tuning, n = problem.tuning, len(problem.nodes)
    own, between = own_covariances(here.chain)
    local, _ = field_jacobians(problem.nodes, here.unknowns)
    field_weight, street_weight = here.weights
    spent = np.einsum("nij,njk,nik->n", local, own, local) / problem.noise_variance
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
        max(tuning.least_street, _size(problem.sizes.street, street, street_left, tuning.pseudo)),
        max(tuning.least_noise, _size(problem.sizes.noise, field, field_left, tuning.pseudo)),
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
        prior = problem.prior.widened(found.unknowns.shared, problem.tuning)
        problem = replace(problem, sizes=sizes, prior=prior)
        found = descend(problem, found.unknowns)
    return found
