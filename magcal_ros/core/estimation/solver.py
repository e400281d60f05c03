"""The one optimisation: turns that share a calibration, brought to their optimum.

One turn is a joint fit of one block. Everything is counted per independent sample: information,
gradient and cost of a turn are divided by its inefficiency factor, so that turns of different
quality and rate meet on equal terms (doc/estimator.md, sections 7 and 8).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import Enum
from functools import cached_property

import numpy as np

from magcal_ros.core.estimation import parameters as p
from magcal_ros.core.estimation.block import TurnBlock
from magcal_ros.core.estimation.information import inverse_information
from magcal_ros.core.estimation.joint_equations import JointEquations
from magcal_ros.core.estimation.parameters import Globals
from magcal_ros.core.estimation.prior import Prior
from magcal_ros.core.estimation.schedule import (
    FINISH,
    FINISH_LEANING,
    UNNOTICED,
    Damping,
    Limit,
    Schedule,
)
from magcal_ros.core.estimation.sigmas import largest_change
from magcal_ros.core.estimation.weighting import Weights, chi_squares, whitened
from magcal_ros.core.estimation.weights import gate, student_weights
from magcal_ros.core.geometry.arrays import FloatArray, IntArray
from magcal_ros.core.samples.correlation import inefficiency_factor


class Status(Enum):
    """Why an optimisation ended."""

    CONVERGED = "converged"
    STALLED = "stalled"
    OUT_OF_ROUNDS = "out of rounds"


@dataclass(frozen=True)
class Convergence:
    """How an optimisation ended.

    Parameters
    ----------
    status : Status
        The worst of the loops that led here.
    iterations : int
        Steps of all of them.
    decrease : float
        What the last step promised: by how much chi-square should fall, independent samples
        counted as such. Squared, how many sigmas the globals moved.
    """

    status: Status = Status.OUT_OF_ROUNDS
    iterations: int = 0
    decrease: float = math.inf


@dataclass(frozen=True, eq=False)
class Fit:
    """Turns with one installation, hard iron, soft iron, strength and dip among them.

    Parameters
    ----------
    blocks : tuple of TurnBlock
        At least one.
    prior : Prior
        Of the shared numbers, counted once.
    convergence : Convergence
        How it came here.
    """

    blocks: tuple[TurnBlock, ...]
    prior: Prior
    convergence: Convergence = Convergence()

    @property
    def block(self) -> TurnBlock:
        """The first turn; of one turn, all there is."""
        return self.blocks[0]

    @property
    def shared(self) -> Globals:
        """The shared numbers; the axes in it are the first turn's."""
        return self.blocks[0].place.state.shared

    @property
    def mounting(self) -> FloatArray:
        """Known gains times nominal pose, shape (3, 3)."""
        return self.blocks[0].samples.mounting

    @property
    def free(self) -> IntArray:
        """Indices of the shared numbers that are estimated."""
        return self.prior.free

    @property
    def cost(self) -> float:
        """Weighted sum of squares per independent sample, priors included."""
        return sum(b.cost / b.weighting.inefficiency for b in self.blocks) + self.prior.cost(
            self.shared
        )

    @property
    def lean_cost(self) -> float:
        """Log-determinants of the leans, which the marginal likelihood adds to the cost."""
        return sum(b.lean_cost / b.weighting.inefficiency for b in self.blocks)

    @cached_property
    def equations(self) -> JointEquations:
        """The normal equations here."""
        return JointEquations(self.blocks, self.prior)

    @property
    def turn_information(self) -> list[FloatArray]:
        """What each turn alone says of the shared numbers, its axes eliminated; each (s, s)."""
        return self.equations.turn_information

    @property
    def information(self) -> FloatArray:
        """On the shared numbers, everything else eliminated, prior included; shape (s, s)."""
        return sum(self.turn_information) + self.prior_information

    @property
    def gradient(self) -> FloatArray:
        """Of the shared numbers, everything else following, leans and prior included; (s,)."""
        return self.equations.shared_gradient

    @property
    def prior_information(self) -> FloatArray:
        """The prior's information on the shared numbers, shape (s, s)."""
        return np.diag(self.prior.information[self.free])

    @property
    def covariance(self) -> FloatArray:
        """Of the globals, zero where they are not free, shape (18, 18)."""
        out = np.zeros((p.COUNT, p.COUNT))
        out[np.ix_(self.free, self.free)] = inverse_information(self.information)
        return out

    def with_blocks(self, blocks: Sequence[TurnBlock]) -> Fit:
        """Return the fit with other blocks."""
        return replace(self, blocks=tuple(blocks))

    def reweighted(self, weights: Sequence[Weights]) -> Fit:
        """Return the fit with other weights, one set for each turn."""
        pairs = zip(self.blocks, weights, strict=True)
        return self.with_blocks(
            [block.weighted(replace(block.weighting, weights=new)) for block, new in pairs]
        )

    def softened(self) -> Fit:
        """Return the fit with IRLS weights of Student-t residuals."""
        return self.reweighted(
            [
                student_weights(chi_squares(b.place, b.weighting.noise), leans=b.leans)
                for b in self.blocks
            ]
        )

    def regated(self, before: JointEquations, closing: bool) -> Fit:
        """Return the fit with the outliers of its residuals left out.

        `before` says what each sample paid for its attitude; `closing`, that what is out stays out.
        """
        weights = []
        for block, equations in zip(self.blocks, before.each, strict=True):
            noise = block.weighting.noise
            chi, residual = chi_squares(block.place, noise), whitened(block.place, noise)
            inliers = gate(residual, chi, equations.attitude_shares)
            if closing:
                inliers &= block.weighting.inliers
            weights.append(Weights.of_inliers(inliers))
        return self.reweighted(weights)

    def renoised(self, before: JointEquations, change: float) -> Fit:
        """Return the fit with the noise and the drift that the residuals of `before` ask for."""
        known, share = self.prior.information[self.free], 1.0 / len(self.blocks)
        blocks = []
        for block, equations in zip(self.blocks, before.each, strict=True):
            found = equations.renoised(change, known, share)
            weighting = replace(block.weighting, noise=found.weighting.noise)
            blocks.append(block.under(found.weighted(weighting)))
        return self.with_blocks(blocks)

    def with_inefficiency(self) -> Fit:
        """Return the fit with the inefficiency factors of its residuals."""
        blocks = []
        for block in self.blocks:
            weights, residual = (
                block.weighting.weights,
                whitened(block.place, block.weighting.noise),
            )
            factor = inefficiency_factor(residual, weights.data * weights.sample)
            blocks.append(block.weighted(replace(block.weighting, inefficiency=factor)))
        return self.with_blocks(blocks)


@dataclass(frozen=True, eq=False)
class Steps:
    """Where a sequence of steps led.

    Parameters
    ----------
    fit : Fit
        Its convergence tells of these steps.
    damping : float
        Where to start next time.
    moved : float
        The most that a step promised.
    """

    fit: Fit
    damping: float
    moved: float


def steps_of(
    fit: Fit,
    limit: Limit,
    damping: float = 1e-6,
    extra: FloatArray | None = None,
    rule: Damping = Damping(),
) -> Steps:
    """Take Levenberg-Marquardt steps until one promises less than the tolerance.

    Parameters
    ----------
    fit : Fit
    limit : Limit
    damping : float
        Of the first step.
    extra : ndarray, optional
        Gradient of what the cost leaves out; of the leans at each place unless given.
    rule : Damping
    """
    moved, promised, status, count = 0.0, math.inf, Status.OUT_OF_ROUNDS, 0
    while count < limit.steps and status is Status.OUT_OF_ROUNDS:
        beyond = fit.equations.lean_gradient if extra is None else extra
        taken, promised, damping = _step(fit, damping, beyond, rule)
        if taken is None:
            status = Status.STALLED
            break
        fit, count, moved = taken, count + 1, max(moved, promised)
        if promised < limit.tolerance:
            status = Status.CONVERGED
    if promised < UNNOTICED.step:
        status = Status.CONVERGED
    return Steps(replace(fit, convergence=Convergence(status, count, promised)), damping, moved)


def _step(
    fit: Fit, damping: float, extra: FloatArray, rule: Damping
) -> tuple[Fit | None, float, float]:
    """Return the fit after a step that lowers the cost, what it promised, and the next damping."""
    before, promised = fit.cost, math.inf
    while damping < rule.largest:
        move = fit.equations.move(damping, extra)
        if move is not None:
            promised = move.promised if math.isinf(promised) else promised
            candidate = fit.with_blocks(move.blocks)
            allowed = before * (1.0 + 1e-12) + 1e-9
            if move.size < rule.longest_step and candidate.cost + move.extra <= allowed:
                return candidate, move.promised, max(rule.relaxed * damping, rule.least)
        damping = max(rule.raised * damping, rule.first_raised)
    return None, promised, 1e-3


def settled(fit: Fit, limit: Limit | None = None) -> Fit:
    """Hold weights and noise, and step until nothing moves; `convergence` adds to what was."""
    leaning = any(block.leans for block in fit.blocks)
    steps = steps_of(fit, limit or (FINISH_LEANING if leaning else FINISH)).fit
    return replace(steps, convergence=_after(fit.convergence, steps.convergence))


def _after(first: Convergence, then: Convergence) -> Convergence:
    """Return how two optimisations after one another ended."""
    status = first.status if then.status is Status.CONVERGED else then.status
    return Convergence(status, first.iterations + then.iterations, then.decrease)


def refined(fit: Fit, schedule: Schedule) -> Fit:
    """Reweigh, step and estimate the noise in turn until weights, noise and optimum agree.

    Parameters
    ----------
    fit : Fit
        Where to start.
    schedule : Schedule

    Returns
    -------
    Fit
        Its convergence is out of rounds where they do not come to agree.
    """
    damping, extra, before, iterations = schedule.damping, None, None, 0
    status = Status.OUT_OF_ROUNDS
    for turn in range(schedule.rounds):
        old = fit
        if turn < schedule.soft_rounds:
            fit = fit.softened()
        else:
            fit = fit.regated(before or _all_counted(fit).equations, turn >= schedule.closing)
        if turn >= schedule.first_inefficiency:
            fit = fit.with_inefficiency()
        extra = _held_extra(fit, schedule, turn, extra)
        factor = max(block.weighting.inefficiency for block in fit.blocks)
        start, limit = fit, Limit(schedule.steps, schedule.still / factor)
        steps = steps_of(fit, limit, damping, extra)
        fit, damping = steps.fit, steps.damping
        iterations += fit.convergence.iterations
        before = (start if schedule.lagged else fit).equations
        fit = fit.renoised(before, schedule.noise_change)
        if turn + 1 >= schedule.fewest and _agrees(
            old, fit, steps.moved, schedule, soft=turn < schedule.soft_rounds
        ):
            stalled = steps.fit.convergence.status is Status.STALLED
            status = Status.STALLED if stalled else Status.CONVERGED
            break
    if turn < schedule.soft_rounds:
        fit = fit.softened()
    return replace(fit, convergence=Convergence(status, iterations, steps.moved))


def _all_counted(fit: Fit) -> Fit:
    return fit.reweighted([Weights.ones(len(block.samples)) for block in fit.blocks])


def _held_extra(
    fit: Fit, schedule: Schedule, turn: int, held: FloatArray | None
) -> FloatArray | None:
    """Return the gradient of the leans where it is not computed anew at each step."""
    first, every = schedule.lean_rounds
    if (first, every) == (0, 1):
        return None
    if turn >= first and (turn - first) % every == 0:
        return fit.equations.lean_gradient
    return np.zeros(fit.equations.size) if held is None else held


def _agrees(old: Fit, new: Fit, moved: float, schedule: Schedule, *, soft: bool) -> bool:
    """Return whether a round changed nothing worth mentioning."""
    for one, other in zip(old.blocks, new.blocks, strict=True):
        was, now = one.weighting, other.weighting
        change = largest_change(now.noise, was.noise, 0.0 if soft else UNNOTICED.wobble)
        change = max(change, abs(math.log(now.inefficiency / was.inefficiency)) / 5.0)
        if other.drift > 0.0:
            change += abs(math.log(other.drift / one.drift)) / 10.0
        regated = float(np.mean(now.weights.sample != was.weights.sample))
        # A wobble too small to matter makes way for a rigid axis, wherever the rest would go.
        fades = not soft and other.leans and now.noise.wobble < UNNOTICED.wobble * now.noise.up
        still = moved * now.inefficiency < schedule.still
        if change >= schedule.noise_settled or regated > schedule.gate_settled:
            return False
        if not (fades or still):
            return False
    return True


def sketched(fit: Fit, steps: int = 6) -> Fit:
    """Take a few IRLS steps under the noise as it is."""
    damping = 1e-3
    for _ in range(steps):
        fit = fit.softened()
        nothing = np.zeros(fit.equations.size)
        taken = steps_of(fit, Limit(1, 0.0), damping, nothing)
        if taken.fit.convergence.status is Status.STALLED:
            break
        fit, damping = taken.fit, taken.damping
    return fit
