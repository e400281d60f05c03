"""The normal equations of several turns together: their own axes first, the shared numbers last."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from magcal_ros.core.estimation import parameters as p
from magcal_ros.core.estimation.block import Equations, Reduced, TurnBlock
from magcal_ros.core.estimation.information import without_own
from magcal_ros.core.estimation.prior import Prior
from magcal_ros.core.geometry.arrays import FloatArray, IntArray


@dataclass(frozen=True, eq=False)
class Move:
    """A step of all turns.

    Parameters
    ----------
    step : ndarray
        Of the turns' own axes (first) and the shared numbers (last).
    size : float
        Largest change of a global, in its own units.
    extra : float
        By how much the term beyond the cost should rise, twice.
    promised : float
        By how much chi-square should fall.
    blocks : tuple of TurnBlock
        Where it leads.
    """

    step: FloatArray
    size: float
    extra: float
    promised: float
    blocks: tuple[TurnBlock, ...]


@dataclass(frozen=True, eq=False)
class JointEquations:
    """The normal equations of turns that share a prior, per independent sample."""

    blocks: tuple[TurnBlock, ...]
    prior: Prior

    @cached_property
    def each(self) -> list[Equations]:
        """The equations of the turns."""
        free = self.prior.free
        return [block.equations(np.concatenate([block.own, free])) for block in self.blocks]

    @cached_property
    def undamped(self) -> list[Reduced]:
        """The turns' equations with their attitudes eliminated."""
        return [equations.reduced(0.0) for equations in self.each]

    @cached_property
    def turn_information(self) -> list[FloatArray]:
        """What each turn says of the shared numbers per independent sample; each (s, s)."""
        return [
            without_own(part.information, len(block.own)) / block.weighting.inefficiency
            for block, part in zip(self.blocks, self.undamped, strict=True)
        ]

    def own_gradient(self, index: int) -> FloatArray:
        """Return a turn's gradient on the shared numbers, its own axes following; shape (s,)."""
        own, part = len(self.blocks[index].own), self.undamped[index]
        gradient = part.gradient - self.each[index].lean_gradient
        if own:
            across = part.information[own:, :own]
            among = np.linalg.pinv(part.information[:own, :own])
            gradient = gradient[own:] - across @ among @ gradient[:own]
        return np.asarray(gradient / self.blocks[index].weighting.inefficiency)

    @property
    def shared_gradient(self) -> FloatArray:
        """Gradient on the shared numbers, everything else following, prior included; (s,)."""
        return sum((self.own_gradient(k) for k in range(len(self.blocks))), self._prior_gradient)

    @property
    def lean_gradient(self) -> FloatArray:
        """Gradient of the marginalised leans' half log-determinants, over all parameters."""
        return self._sum([equations.lean_gradient for equations in self.each])

    def move(self, damping: float, extra: FloatArray) -> Move | None:
        """Solve the damped equations; None where they are singular.

        Parameters
        ----------
        damping : float
            Relative addition to the diagonal.
        extra : ndarray
            Gradient of a further term of half the cost, taken as constant over the step.
        """
        parts = self.undamped if damping == 0.0 else [e.reduced(damping) for e in self.each]
        information = np.zeros((self.size, self.size))
        for block, part, place in zip(self.blocks, parts, self._places, strict=True):
            information[np.ix_(place, place)] += part.information / block.weighting.inefficiency
        diagonal = self._sum([equations.diagonal for equations in self.each]) + 1e-9
        right = self._sum([part.gradient for part in parts]) - extra
        known = self.prior.information[self.prior.free]
        shared = slice(self.size - len(known), None)
        diagonal[shared] += known
        right[shared] += self._prior_gradient
        index = np.arange(self.size)
        information[index, index] += damping * diagonal
        information[index[shared], index[shared]] += known
        try:
            step = np.asarray(np.linalg.solve(information, right), dtype=np.float64)
        except np.linalg.LinAlgError:
            return None
        if not np.isfinite(step).all():
            return None
        size, rise, promised = float(np.abs(step).max()), 2.0 * extra @ step, right @ step
        return Move(step, size, float(rise), float(promised), self._moved(parts, step))

    def _moved(self, parts: Sequence[Reduced], step: FloatArray) -> tuple[TurnBlock, ...]:
        moved = []
        for block, part, place in zip(self.blocks, parts, self._places, strict=True):
            full = np.zeros(p.COUNT)
            full[np.concatenate([block.own, self.prior.free])] = step[place]
            moved.append(block.moved(full, part.follow(step[place])))
        return tuple(moved)

    @cached_property
    def _places(self) -> list[IntArray]:
        """Where each turn's parameters stand in the whole."""
        places, first = [], 0
        last = np.arange(self.size - len(self.prior.free), self.size)
        for block in self.blocks:
            places.append(np.concatenate([np.arange(first, first + len(block.own)), last]))
            first += len(block.own)
        return places

    @cached_property
    def size(self) -> int:
        """How many parameters there are."""
        return sum(len(block.own) for block in self.blocks) + len(self.prior.free)

    @cached_property
    def _prior_gradient(self) -> FloatArray:
        shared = self.blocks[0].place.state.shared
        gradient = self.prior.information * self.prior.deviation(shared)
        return np.asarray(gradient[self.prior.free])

    def _sum(self, vectors: Sequence[FloatArray]) -> FloatArray:
        total = np.zeros(self.size)
        for block, vector, place in zip(self.blocks, vectors, self._places, strict=True):
            total[place] += vector / block.weighting.inefficiency
        return total
