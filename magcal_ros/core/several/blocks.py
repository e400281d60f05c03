"""One turn's part in the joint fit: its information on the shared numbers, and how it follows.

Everything is counted per independent sample: information, gradient and cost of a turn are divided
by its kappa, so that turns of different quality and rate meet on equal terms.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np

from magcal_ros.core.arrays import BoolArray, FloatArray, IntArray
from magcal_ros.core.methods.maximum_likelihood import parameters as p
from magcal_ros.core.methods.maximum_likelihood.attitudes import attitudes_from_vectors
from magcal_ros.core.methods.maximum_likelihood.carried import (
    Carried,
    begin,
    carried_weights,
)
from magcal_ros.core.methods.maximum_likelihood.carried_equations import (
    Place,
    Task,
    advanced,
    at,
    cost,
    noise_from,
    normal_equations,
)
from magcal_ros.core.methods.maximum_likelihood.linearise import (
    Problem,
    chi_squares,
    linearise,
)
from magcal_ros.core.methods.maximum_likelihood.linearise import cost as sampled_cost
from magcal_ros.core.methods.maximum_likelihood.logdet import (
    log_determinant_gradient,
    log_determinants,
)
from magcal_ros.core.methods.maximum_likelihood.model import Samples, State
from magcal_ros.core.methods.maximum_likelihood.parameters import Globals
from magcal_ros.core.methods.maximum_likelihood.prior import Prior
from magcal_ros.core.methods.maximum_likelihood.refine import Solution
from magcal_ros.core.methods.maximum_likelihood.sigmas import estimate_noise, shares
from magcal_ros.core.methods.maximum_likelihood.weights import gate, hard_weights
from magcal_ros.core.rotations import minimal_rotation

AXES = np.array([0, 1, 2, 3])
PAID_FOR = np.arange(p.SOFT_IRON.start)
"""Parameters that a turn's residuals are taken to have paid for."""
NOISE_CHANGE = 1.3


@dataclass(frozen=True, eq=False)
class Equations:
    """Normal equations of one turn at one place, its attitudes eliminated.

    Parameters
    ----------
    information, gradient : ndarray, shape (f, f) and (f,)
        Of the data alone, over the free parameters that were asked for.
    extra : ndarray, shape (f,)
        Gradient of the log-determinants, which the cost does not hold.
    follow : callable
        Returns the turn after a step (f,) of those parameters.
    """

    information: FloatArray
    gradient: FloatArray
    extra: FloatArray
    follow: Callable[[FloatArray], Block]


def no_belief(free: IntArray) -> Prior:
    """Return the prior of a turn's data alone: what is believed is counted once for all turns."""
    return Prior(free, np.zeros(p.COUNT), 0.0, 0.0)


@dataclass(frozen=True, eq=False)
class SampledBlock:
    """A turn in which each sample has an attitude of its own."""

    state: State
    problem: Problem

    own = AXES

    @property
    def cost(self) -> float:
        """Weighted sum of squares of the data, per independent sample."""
        return sampled_cost(self.state, self.problem) / self.problem.kappa

    def equations(self, free: IntArray) -> Equations:
        """Return the normal equations over `free`."""
        problem = replace(self.problem, prior=no_belief(free))
        lin = linearise(self.state, problem)
        extra = np.zeros(len(free))
        if not problem.rigid:
            extra = log_determinant_gradient(lin, problem)
        pulled = (lin.local_covariance @ lin.local_gradient[:, :, None])[:, :, 0]
        coupling = lin.local_covariance @ lin.coupling

        def follow(move: FloatArray) -> SampledBlock:
            full = np.zeros(p.COUNT)
            full[free] = move
            return replace(self, state=self.state.moved(full, pulled - coupling @ move))

        scale = 1.0 / problem.kappa
        gradient = lin.gradient - lin.through_attitudes(pulled)
        return Equations(scale * lin.reduced_information, scale * gradient, scale * extra, follow)

    @property
    def lean_cost(self) -> float:
        """The log-determinants of the counted samples' leans, per independent sample."""
        lin = linearise(self.state, replace(self.problem, prior=no_belief(AXES)))
        counted = self.problem.weights.sample
        return float(counted @ log_determinants(lin)) / self.problem.kappa

    def regated(self) -> SampledBlock:
        """Return the turn with gate and noise as its residuals now ask for."""
        problem = replace(self.problem, prior=no_belief(PAID_FOR))
        lin = linearise(self.state, problem)
        chi = chi_squares(self.state, lin.prediction, problem.noise)
        paid = shares(lin, problem)
        problem = problem.with_weights(hard_weights(gate(lin, chi, paid.up + paid.field)))
        noise = estimate_noise(lin, problem, change=NOISE_CHANGE)
        return replace(self, problem=problem.with_noise(noise))

    def at(self, shared: Globals) -> SampledBlock:
        """Return the turn with other shared numbers; its axes and attitudes are found anew."""
        samples, believed = self.problem.samples, self.problem.weights.sample > 0.5
        placed = _placed(shared, samples, believed)
        state = State(placed, attitudes_from_vectors(placed, samples))
        return replace(self, state=state.upright() if self.problem.rigid else state)


@dataclass(frozen=True, eq=False)
class CarriedBlock:
    """A turn whose attitudes the gyro carries; both axes only name a frame."""

    place: Place
    task: Task

    own = AXES[:0]

    @property
    def state(self) -> State:
        """Globals and attitudes."""
        return self.place.state

    @property
    def problem(self) -> Problem:
        """Samples, noise and weights."""
        return self.task.problem

    @property
    def cost(self) -> float:
        """Weighted sum of squares of data and gyro errors, per independent sample."""
        return cost(self.place, self._blank(AXES[:0])) / self.problem.kappa

    lean_cost = 0.0

    def equations(self, free: IntArray) -> Equations:
        """Return the normal equations over `free`."""
        task, count = self._blank(free), len(free)
        found = normal_equations(self.place, task)
        among, across = found.information[count:, count:], found.information[count:, :count]
        inverse = np.linalg.pinv(among, rcond=1e-14, hermitian=True)
        pulled, coupling = inverse @ found.gradient[count:], inverse @ across

        def follow(move: FloatArray) -> CarriedBlock:
            full = np.zeros(p.COUNT)
            full[free] = move
            return replace(self, place=advanced(self.place, task, full, pulled - coupling @ move))

        scale = 1.0 / self.problem.kappa
        information = found.information[:count, :count] - across.T @ coupling
        gradient = found.gradient[:count] - across.T @ pulled
        return Equations(scale * information, scale * gradient, np.zeros(count), follow)

    def regated(self) -> CarriedBlock:
        """Return the turn with gate and noise as its residuals now ask for."""
        weights = carried_weights(self.place, self.problem, soft=False)
        task = self._blank(PAID_FOR[p.ROLL :]).with_weights(weights)
        noise = noise_from(normal_equations(self.place, task), task.problem)
        return replace(self, task=replace(task, problem=task.problem.with_noise(noise)))

    def at(self, shared: Globals) -> CarriedBlock:
        """Return the turn with other shared numbers; the gyro's errors start at zero."""
        samples, believed = self.problem.samples, self.problem.weights.sample > 0.5
        placed = _placed(shared, samples, believed)
        state = State(placed, attitudes_from_vectors(placed, samples))
        return replace(self, place=begin(Solution(state, self.problem), self.task))

    def _blank(self, free: IntArray) -> Task:
        return replace(self.task, problem=replace(self.problem, prior=no_belief(free)))


Block: TypeAlias = SampledBlock | CarriedBlock


def block_from(solution: Solution, carried: Carried | None) -> Block:
    """Return a turn as its own fit left it."""
    if carried is None:
        return SampledBlock(solution.state, solution.problem)
    problem = replace(carried.solution.problem, prior=no_belief(AXES[:0]))
    task = Task(problem, carried.carrier, carried.drift)
    return CarriedBlock(at(carried.solution.state, carried.coefficients, task), task)


def _placed(shared: Globals, samples: Samples, believed: BoolArray) -> Globals:
    """Return the shared numbers with the axes that this turn's samples show under them."""
    if believed.sum() < 3:
        believed = np.ones(len(samples), dtype=np.bool_)
    plain = replace(shared, body_axis=np.eye(3), world_axis=np.eye(3))
    attitude = attitudes_from_vectors(plain, samples.take(believed))
    body, world = _common_axis(attitude)
    z = np.array([0.0, 0.0, 1.0])
    return replace(
        shared, body_axis=minimal_rotation(z, body), world_axis=minimal_rotation(z, world)
    )


def _common_axis(attitude: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the axis about which attitudes (n, 3, 3) turn, in body and in world axes.

    For an axis b in the body that is w in the world `R_i w = b` for all i: with the mean of the
    attitudes M, w and b are its singular vectors whose singular value is one. On a short arc all
    three are near one, and the body's own z serves.
    """
    left, values, right = np.linalg.svd(attitude.mean(axis=0))
    body, world = left[:, 0], right[0]
    if values[1] > SHORTEST_ARC_MEAN:
        body = np.array([0.0, 0.0, 1.0])
        world = (np.swapaxes(attitude, 1, 2) @ body).mean(axis=0)
        world = world / np.linalg.norm(world)
    sense = math.copysign(1.0, float(body[2]))
    return sense * body, sense * world


SHORTEST_ARC_MEAN = 0.95
"""Second singular value of the mean attitude, sin(a/2)/(a/2) of an arc a: about 63 degrees."""
