"""From turns that may meet to one joint optimum, and the turns that do not belong to it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from magcal_ros.core.arrays import FloatArray, IntArray
from magcal_ros.core.knowledge import Knowledge
from magcal_ros.core.methods.maximum_likelihood import parameters as p
from magcal_ros.core.methods.maximum_likelihood.covariance import (
    correction_from,
    correction_jacobian,
)
from magcal_ros.core.methods.maximum_likelihood.prior import (
    SOFT_IRON_INDICES,
    Prior,
    prior_from,
)
from magcal_ros.core.several.agreement import Agreement, agreements
from magcal_ros.core.several.blocks import Block
from magcal_ros.core.several.joint import Joint, gated, settle
from magcal_ros.core.several.start import sphere_guess

YAW_IS_SHOWN = 0.5
"""Share of its belief's sigma below which the installation's yaw counts as shown."""
STEPS = 25


@dataclass(frozen=True, eq=False)
class JointFit:
    """What the turns tell together.

    Parameters
    ----------
    meeting : Joint
        The optimum with soft iron and yaw free: what is shown is read from it.
    with_iron : Joint
        The same with the yaw held at zero where the turns do not show it.
    joint : Joint
        The optimum of the model that was chosen: with soft iron or without.
    scale : float
        Tesla of one field scale.
    soft_iron_gain : float
        Fall of chi-square by soft iron.
    soft_iron_chance : float
        How likely there is soft iron, 0 to 1.
    agreements : list of Agreement
        One for each turn.
    """

    meeting: Joint
    with_iron: Joint
    joint: Joint
    scale: float
    soft_iron_gain: float
    soft_iron_chance: float
    agreements: list[Agreement]

    @property
    def shows_yaw(self) -> bool:
        """Whether the installation's yaw is estimated; otherwise it is zero by convention."""
        return p.YAW in self.joint.free

    @property
    def widening(self) -> float:
        """By how much the turns' disagreement widens the covariance, one or more."""
        return max(agreement.widening for agreement in self.agreements)

    @property
    def covariance(self) -> FloatArray:
        """Of the twelve numbers, SI units, shape (12, 12).

        Where soft iron was left out and may be there all the same, it is the covariance of both
        models together (Hoeting et al., "Bayesian model averaging", 1999).
        """
        plain, rich = (self._twelve(joint) for joint in (self.joint, self.with_iron))
        if self.joint.prior.has_soft_iron:
            return self.widening * plain
        likely = self.soft_iron_chance
        away = self._parameters(self.with_iron) - self._parameters(self.joint)
        mixed = (1.0 - likely) * plain + likely * rich
        return self.widening * (mixed + likely * (1.0 - likely) * np.outer(away, away))

    def _twelve(self, joint: Joint) -> FloatArray:
        jacobian = correction_jacobian(joint.shared, joint.mounting, self.scale)
        return np.asarray(jacobian @ joint.covariance @ jacobian.T)

    def _parameters(self, joint: Joint) -> FloatArray:
        return correction_from(joint.shared, joint.mounting, self.scale).parameters


def fit_jointly(blocks: Sequence[Block], knowledge: Knowledge, scale: float) -> JointFit:
    """Join turns that agree.

    Parameters
    ----------
    blocks : sequence of Block
        The turns as their own fits left them.
    knowledge : Knowledge
    scale : float
        Tesla of one field scale.
    """
    meeting = settle(gated(meet(blocks, knowledge, scale)), STEPS, tolerance=1e-9)
    sigma = math.sqrt(float(meeting.covariance[p.YAW, p.YAW]))
    yaw = sigma < YAW_IS_SHOWN * knowledge.mounting.yaw_sigma
    with_iron = joint = meeting
    if not yaw:
        prior = prior_from(knowledge, scale, soft_iron=True, yaw=False)
        with_iron = joint = held(meeting, np.array([p.YAW]), prior)
    gain, chance = 0.0, 0.0
    if with_iron.prior.has_soft_iron:
        prior = prior_from(knowledge, scale, soft_iron=False, yaw=yaw)
        plain = held(with_iron, SOFT_IRON_INDICES, prior)
        gain, chance = _weigh(plain, with_iron)
        if not knowledge.soft_iron.always and chance < 0.5:
            joint = plain
    return JointFit(meeting, with_iron, joint, scale, gain, chance, agreements(meeting))


def meet(blocks: Sequence[Block], knowledge: Knowledge, scale: float) -> Joint:
    """Return the joint optimum under each turn's own gate and noise."""
    return _met(blocks, prior_from(knowledge, scale, soft_iron=True, yaw=True))


def _met(blocks: Sequence[Block], prior: Prior) -> Joint:
    """Seek from the sphere that all samples lie on, and from the first turn's own optimum."""
    believed = [b.problem.samples.take(b.problem.weights.sample > 0.5) for b in blocks]
    first = blocks[0].state.shared
    found = [
        settle(Joint(tuple(block.at(guess) for block in blocks), prior), STEPS)
        for guess in (sphere_guess(believed, first), first)
    ]
    return min(found, key=lambda joint: joint.cost)


def odd_one(blocks: Sequence[Block], prior: Prior) -> int:
    """Return which turn the others fit best without; of two turns, the later one.

    Parameters
    ----------
    blocks : sequence of Block
        As their own fits left them.
    prior : Prior
        With soft iron and yaw free.
    """
    if len(blocks) == 2:
        return 1

    def cost_without(index: int) -> float:
        rest = [block for k, block in enumerate(blocks) if k != index]
        return _met(rest, prior).cost + blocks[index].cost

    return min(range(len(blocks)), key=cost_without)


def held(rich: Joint, indices: IntArray, prior: Prior) -> Joint:
    """Return the optimum with some shared numbers held at zero, gates and noise as they are."""
    step = np.zeros(p.COUNT)
    step[indices] = prior.deviation(rich.shared)[indices]
    blocks = tuple(block.equations(indices).follow(step[indices]) for block in rich.blocks)
    return settle(Joint(blocks, prior), STEPS, tolerance=1e-6)


def _weigh(plain: Joint, rich: Joint) -> tuple[float, float]:
    """Return by how much soft iron lowers the cost, and how likely it is at even odds.

    The price is Occam's: the room that the belief gave over the room that the turns leave.
    """
    gain = plain.cost + plain.lean_cost - rich.cost - rich.lean_cost
    iron = np.isin(rich.free, SOFT_IRON_INDICES)
    index = rich.free[iron]
    left = rich.covariance[np.ix_(index, index)]
    room = -float(np.log(rich.prior.information[index]).sum())
    occam = room - float(np.linalg.slogdet(left)[1])
    return gain, 1.0 / (1.0 + math.exp(min(max(0.5 * (occam - gain), -50.0), 50.0)))
