"""From turns that may meet to one joint optimum, and the turns that do not belong to it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from magcal_ros.core.estimation import parameters as p
from magcal_ros.core.estimation.block import TurnBlock
from magcal_ros.core.estimation.prior import SOFT_IRON_INDICES, Prior, prior_from
from magcal_ros.core.estimation.schedule import JOINING, MEET
from magcal_ros.core.estimation.soft_iron_doubt import RULE, Doubt, Look, occam_factor
from magcal_ros.core.estimation.solver import Fit, refined, settled
from magcal_ros.core.estimation.sphere import sphere_guess
from magcal_ros.core.estimation.uncertainty import twelve_covariance
from magcal_ros.core.geometry.arrays import FloatArray, IntArray
from magcal_ros.core.knowledge import Knowledge
from magcal_ros.core.multi_turn.agreement import Agreement, agreements
from magcal_ros.core.multi_turn.turn import Turn


@dataclass(frozen=True)
class JointTuning:
    """What a joint fit must show.

    Parameters
    ----------
    shown_yaw : float
        Share of its prior's sigma below which the installation's yaw counts as shown.
    fewest_inliers : float
        Share of a turn's samples that the fit must count, or the turn contradicts the others.
    """

    shown_yaw: float = 0.5
    fewest_inliers: float = 0.4


TUNING = JointTuning()


@dataclass(frozen=True, eq=False)
class JointFit:
    """What the turns show together.

    Parameters
    ----------
    meeting : Fit
        The optimum with soft iron and yaw free: what is shown is read from it.
    best : Fit
        The optimum of the model that was chosen: with soft iron or without, the yaw held at zero
        where the turns do not show it.
    scale : float
        Tesla of one field scale.
    soft_iron_gain : float
        Fall of chi-square by soft iron.
    doubt : Doubt or None
        Where soft iron was left out and could have been there.
    agreements : list of Agreement
        One for each turn.
    """

    meeting: Fit
    best: Fit
    scale: float
    soft_iron_gain: float
    doubt: Doubt | None
    agreements: list[Agreement]

    @property
    def shows_yaw(self) -> bool:
        """Whether the installation's yaw is estimated; otherwise it is zero by convention."""
        return p.YAW in self.best.free

    @property
    def widening(self) -> float:
        """By how much the turns' disagreement widens the covariance, one or more."""
        return max(agreement.widening for agreement in self.agreements)

    @property
    def covariance(self) -> FloatArray:
        """Of the twelve numbers, SI units, shape (12, 12)."""
        return self.widening * twelve_covariance(self.best, self.scale, self.doubt)


def fit_jointly(blocks: Sequence[TurnBlock], knowledge: Knowledge, scale: float) -> JointFit:
    """Join turns that agree.

    Parameters
    ----------
    blocks : sequence of TurnBlock
        The turns as their own fits left them.
    knowledge : Knowledge
    scale : float
        Tesla of one field scale.
    """
    meeting = settled(refined(meet(blocks, knowledge, scale), JOINING))
    sigma = math.sqrt(float(meeting.covariance[p.YAW, p.YAW]))
    yaw = sigma < TUNING.shown_yaw * knowledge.mounting.yaw_sigma
    best, gain, doubt = meeting, 0.0, None
    if not yaw:
        prior = prior_from(knowledge, scale, soft_iron=True, yaw=False)
        best = held(meeting, np.array([p.YAW]), prior)
    if best.prior.has_soft_iron:
        prior = prior_from(knowledge, scale, soft_iron=False, yaw=yaw)
        plain = held(best, SOFT_IRON_INDICES, prior)
        gain = plain.cost + plain.lean_cost - best.cost - best.lean_cost
        look = Look(
            gain,
            occam_factor(best.covariance, best.prior),
            plain.shared.step_to(best.shared),
            best.covariance,
        )
        if not knowledge.soft_iron.always and gain <= look.needed(RULE.most_fall):
            best, doubt = plain, Doubt(look, look.probability(gain))
    return JointFit(meeting, best, scale, gain, doubt, agreements(meeting))


def meet(blocks: Sequence[TurnBlock], knowledge: Knowledge, scale: float) -> Fit:
    """Return the joint optimum under each turn's own gate and noise."""
    return _met(blocks, prior_from(knowledge, scale, soft_iron=True, yaw=True))


def _met(blocks: Sequence[TurnBlock], prior: Prior) -> Fit:
    """Seek from the sphere that all samples lie on, and from the first turn's own optimum."""
    inliers = [block.samples.take(block.weighting.inliers) for block in blocks]
    first = blocks[0].place.state.shared
    found = [
        settled(Fit(tuple(block.at(guess) for block in blocks), prior), MEET)
        for guess in (sphere_guess(inliers, first), first)
    ]
    return min(found, key=lambda fit: fit.cost)


def odd_one(blocks: Sequence[TurnBlock], prior: Prior) -> int:
    """Return which turn the others fit best without; of two turns, the later one.

    Parameters
    ----------
    blocks : sequence of TurnBlock
        As their own fits left them.
    prior : Prior
        With soft iron and yaw free.
    """
    if len(blocks) == 2:
        return 1

    def cost_without(index: int) -> float:
        rest = [block for k, block in enumerate(blocks) if k != index]
        alone = blocks[index]
        return _met(rest, prior).cost + alone.cost / alone.weighting.inefficiency

    return min(range(len(blocks)), key=cost_without)


def held(rich: Fit, indices: IntArray, prior: Prior) -> Fit:
    """Return the optimum with some shared numbers held at zero, gates and noise as they are."""
    step = np.zeros(p.COUNT)
    step[indices] = prior.deviation(rich.shared)[indices]
    blocks = []
    for block in rich.blocks:
        local = block.equations(indices).reduced(0.0).follow(step[indices])
        blocks.append(block.moved(step, local))
    return settled(Fit(tuple(blocks), prior, rich.convergence))


def those_that_agree(turns: list[Turn], knowledge: Knowledge) -> tuple[list[Turn], JointFit | None]:
    """Leave out one turn after another until the rest shows one calibration.

    Returns
    -------
    list of Turn, JointFit or None
        All turns, those left out with the reason; the fit of the others, None if there are none.
    """
    while True:
        members = [turn for turn in turns if not turn.unfit]
        if not members:
            return turns, None
        scale = members[0].own_fit.prepared.scale
        blocks = [turn.block for turn in members]
        joint = meet(blocks, knowledge, scale)
        found = agreements(joint)
        if len(blocks) > 1 and any(agreement.is_broken for agreement in found):
            odd = odd_one(blocks, joint.prior)
            turns = _without(turns, members[odd], _contradiction(found[odd], len(blocks)))
            continue
        fit = fit_jointly(blocks, knowledge, scale)
        doubtful = _contradicted(fit.best) if len(blocks) > 1 else None
        if doubtful is None:
            return turns, fit
        turns = _without(turns, members[doubtful], "most of its samples contradict the other turns")


def _contradicted(fit: Fit) -> int | None:
    shares = [float(block.weighting.weights.sample.mean()) for block in fit.blocks]
    worst = int(np.argmin(shares))
    return worst if shares[worst] < TUNING.fewest_inliers else None


def _without(turns: list[Turn], odd: Turn, words: str) -> list[Turn]:
    return [turn.left_out(words) if turn is odd else turn for turn in turns]


def _contradiction(agreement: Agreement, count: int) -> str:
    others = "the other turns" if count > 2 else "the turn before"
    return (
        f"it contradicts {others}: they are {agreement.misfit:.0f} times as far apart as noise "
        "explains. Turn where the field is undisturbed and the same, with the same load; if the "
        "robot itself has changed, start afresh"
    )
