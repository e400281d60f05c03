"""The joint fit: shared numbers and each turn's own axes, by damped Gauss-Newton steps."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from magcal_ros.core.arrays import FloatArray, IntArray
from magcal_ros.core.methods.maximum_likelihood import parameters as p
from magcal_ros.core.methods.maximum_likelihood.covariance import inverse_information
from magcal_ros.core.methods.maximum_likelihood.parameters import Globals
from magcal_ros.core.methods.maximum_likelihood.prior import Prior
from magcal_ros.core.several.blocks import Block, Equations

LARGEST_STEP = 1.0
LARGEST_DAMPING = 1e4
SETTLED = 1e-4
"""A fall of chi-square that changes nothing."""


@dataclass(frozen=True, eq=False)
class Joint:
    """Turns with one installation, hard iron, soft iron, strength and dip among them.

    Parameters
    ----------
    blocks : tuple of Block
        At least one.
    prior : Prior
        What is believed of the shared numbers, counted once.
    """

    blocks: tuple[Block, ...]
    prior: Prior

    @property
    def shared(self) -> Globals:
        """The shared numbers; the axes in it are the first turn's."""
        return self.blocks[0].state.shared

    @property
    def mounting(self) -> FloatArray:
        """Known gains times nominal pose, shape (3, 3)."""
        return self.blocks[0].problem.samples.mounting

    @property
    def free(self) -> IntArray:
        """Indices of the shared numbers that are estimated."""
        return self.prior.free[self.prior.free >= p.ROLL]

    @property
    def cost(self) -> float:
        """Weighted sum of squares per independent sample, priors included."""
        return sum(block.cost for block in self.blocks) + self.prior.cost(self.shared)

    @property
    def lean_cost(self) -> float:
        """Log-determinants of the leans, which the marginal likelihood adds to the cost."""
        return sum(block.lean_cost for block in self.blocks)

    @cached_property
    def equations(self) -> JointEquations:
        """The normal equations here."""
        return assemble(self)

    @property
    def information(self) -> FloatArray:
        """On the shared numbers, everything else eliminated, prior included; shape (s, s)."""
        return sum(self.turn_information) + self.prior_information

    @property
    def prior_information(self) -> FloatArray:
        """What is believed of the shared numbers, shape (s, s)."""
        return np.diag(self.prior.information[self.free])

    @cached_property
    def turn_information(self) -> list[FloatArray]:
        """What each turn alone says of the shared numbers, its axes eliminated; each (s, s)."""
        return [
            without_own(e.information, len(b.own))
            for b, e in zip(self.blocks, self.equations.each, strict=True)
        ]

    @property
    def covariance(self) -> FloatArray:
        """Of all globals, zero where they are not free, shape (18, 18)."""
        out = np.zeros((p.COUNT, p.COUNT))
        out[np.ix_(self.free, self.free)] = inverse_information(self.information)
        return out


@dataclass(frozen=True, eq=False)
class JointEquations:
    """Normal equations over every turn's own axes (first) and the shared numbers (last).

    Parameters
    ----------
    each : list of Equations
        Of the turns.
    places : list of ndarray of int
        Where each turn's parameters stand in the whole.
    information, gradient, extra : ndarray
        Of the whole, prior included.
    """

    each: list[Equations]
    places: list[IntArray]
    information: FloatArray
    gradient: FloatArray
    extra: FloatArray


def without_own(information: FloatArray, own: int) -> FloatArray:
    """Eliminate the first `own` parameters."""
    if own == 0:
        return information
    across = information[:own, own:]
    return np.asarray(
        information[own:, own:] - across.T @ inverse_information(information[:own, :own]) @ across
    )


def assemble(joint: Joint) -> JointEquations:
    """Build the normal equations of all turns together."""
    shared = joint.free
    each = [block.equations(np.concatenate([block.own, shared])) for block in joint.blocks]
    owned = sum(len(block.own) for block in joint.blocks)
    size = owned + len(shared)
    last = np.arange(owned, size)
    information, gradient, extra = np.zeros((size, size)), np.zeros(size), np.zeros(size)
    places, first = [], 0
    for block, part in zip(joint.blocks, each, strict=True):
        place = np.concatenate([np.arange(first, first + len(block.own)), last])
        first += len(block.own)
        information[np.ix_(place, place)] += part.information
        gradient[place] += part.gradient
        extra[place] += part.extra
        places.append(place)
    information[owned:, owned:] += joint.prior_information
    pull = joint.prior.information * joint.prior.deviation(joint.shared)
    gradient[owned:] += pull[shared]
    return JointEquations(each, places, information, gradient, extra)


def settle(joint: Joint, steps: int, tolerance: float = SETTLED) -> Joint:
    """Take up to `steps` steps until the cost falls by less than `tolerance`."""
    damping = 1e-6
    for _ in range(steps):
        before, equations = joint.cost, joint.equations
        moved, damping, gain = _step(joint, equations, before, damping)
        if moved is None:
            break
        joint = moved
        if abs(before - joint.cost) < tolerance and gain < tolerance:
            break
    return joint


def _step(
    joint: Joint, equations: JointEquations, before: float, damping: float
) -> tuple[Joint | None, float, float]:
    """Return the turns after a step that lowers the cost, the next damping, and what it took."""
    diagonal = np.diag(np.diag(equations.information) + 1e-9)
    right = equations.gradient - equations.extra
    while damping < LARGEST_DAMPING:
        move = solved(equations.information + damping * diagonal, right)
        if np.isfinite(move).all() and np.abs(move).max() < LARGEST_STEP:
            blocks = tuple(
                part.follow(move[place])
                for part, place in zip(equations.each, equations.places, strict=True)
            )
            candidate = replace(joint, blocks=blocks)
            rise = float(2.0 * equations.extra @ move)
            if candidate.cost + rise <= before * (1.0 + 1e-12) + 1e-9:
                return candidate, max(0.1 * damping, 1e-10), abs(rise)
        damping = max(10.0 * damping, 1e-6)
    return None, 1e-3, 0.0


def solved(matrix: FloatArray, right: FloatArray) -> FloatArray:
    """Solve linear equations; not a number where they are singular."""
    try:
        return np.asarray(np.linalg.solve(matrix, right), dtype=np.float64)
    except np.linalg.LinAlgError:
        return np.full(len(right), np.nan)


def gated(joint: Joint, rounds: int = 3) -> Joint:
    """Let gates and noise follow the joint optimum, and it them."""
    for _ in range(rounds):
        counted = joint.blocks
        joint = replace(joint, blocks=tuple(block.regated() for block in joint.blocks))
        joint = settle(joint, steps=4)
        if all(_is_same_gate(a, b) for a, b in zip(counted, joint.blocks, strict=True)):
            break
    return joint


def _is_same_gate(one: Block, other: Block) -> bool:
    changed = one.problem.weights.sample != other.problem.weights.sample
    return bool(changed.mean() <= 0.002)
