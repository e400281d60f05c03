"""Which model the samples ask for (doc/estimator.md, section 9).

Rigid axis or wobbling, with a steady linear acceleration or without, with soft iron or without:
each is fitted and compared by what it lowers chi-square by, per independent sample. Soft iron is
chosen, and doubted, by one rule whatever ties the attitudes and however many turns there are.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from magcal_ros.core.estimation.effect_choice import gyro_block, propagated
from magcal_ros.core.estimation.evidence import evidence
from magcal_ros.core.estimation.free_attitude import FreeBlock
from magcal_ros.core.estimation.gyro_attitude import DRIFT, GyroBlock
from magcal_ros.core.estimation.gyro_path import GyroPath
from magcal_ros.core.estimation.information import inverse_information
from magcal_ros.core.estimation.linear_acceleration import pulled_or_not
from magcal_ros.core.estimation.model import Evaluation, State
from magcal_ros.core.estimation.prior import Prior
from magcal_ros.core.estimation.schedule import (
    COMPARE,
    NEAR,
    SOFTENING,
    TRIMMING,
)
from magcal_ros.core.estimation.sigmas import FLOOR
from magcal_ros.core.estimation.soft_iron_doubt import RULE, Doubt, Look, look_for_soft_iron
from magcal_ros.core.estimation.solver import Fit, refined, settled, steps_of
from magcal_ros.core.estimation.weights import passes_alone
from magcal_ros.core.geometry.arrays import FloatArray


@dataclass(frozen=True)
class AxisRule:
    """When the axis counts as wobbling; falls of minus twice the log evidence.

    Parameters
    ----------
    needed : float
        Fall per independent sample from which the axis wobbles.
    few_common : float
        A rigid axis that throws more of the wobbling one's inliers away explains nothing.
    largest_rigid : float
        Radians of wobble beyond which a rigid axis is not tried.
    """

    needed: float = 10.0
    few_common: float = 0.95
    largest_rigid: float = 0.05


@dataclass(frozen=True)
class PropagationRule:
    """When gyro-propagated attitudes explain the samples about as well as free ones.

    Parameters
    ----------
    field_ratio, lenience : float
        Bound on the field's noise: so many times the free fit's, and so many field scales.
    settled_lenience : float
        In place of `lenience` where the free fit has its soft iron, too.
    fewest : float
        Share of the samples that are inliers.
    drift : float
        Share of the largest drift.
    contradiction, bad_bias : float
        Radians of heading by which a doubted gyro may part from what is found without it, where
        its bias is larger than this, rad/s.
    """

    field_ratio: float = 2.0
    lenience: float = 0.02
    settled_lenience: float = 0.01
    fewest: float = 0.6
    drift: float = 0.9
    contradiction: float = math.radians(0.3)
    bad_bias: float = math.radians(1.0)

    def contradicts(self, block: GyroBlock, apart: float) -> bool:
        """Return whether a gyro with a large bias leads `apart` radians from what is without it."""
        is_bad = block.path.is_doubted and float(np.linalg.norm(block.bias)) > self.bad_bias
        return is_bad and apart > self.contradiction


AXIS, PROPAGATION = AxisRule(), PropagationRule()


@dataclass(frozen=True, eq=False)
class Choice:
    """The model that the samples ask for.

    Parameters
    ----------
    fit : Fit
    soft_iron_gain : float
        Fall of chi-square by soft iron; zero where it was not tried.
    doubt : Doubt, optional
        Where soft iron was left out and could have been there.
    gap : float
        Radians of heading to another explanation of the gyro that cannot be excluded.
    own_lean : bool
        Whether the accelerometer leans from the gyro's axis at rest as well.
    may_be_pulled : bool
        Whether a pull of the turn can be neither seen nor excluded.
    """

    fit: Fit
    soft_iron_gain: float = 0.0
    doubt: Doubt | None = None
    gap: float = 0.0
    own_lean: bool = False
    may_be_pulled: bool = False


def free_attitudes(start: Fit, with_iron: Prior, *, always: bool) -> Choice:
    """Fit one turn with an attitude for each sample.

    Parameters
    ----------
    start : Fit
        A wobbling fit without soft iron.
    with_iron : Prior
        The prior that frees soft iron.
    always : bool
        Whether soft iron is fitted whatever the samples say.
    """
    wobbling = refined(start, TRIMMING)
    if not with_iron.has_soft_iron:
        return Choice(settled(rigid_or_wobbling(wobbling)))
    # Where soft iron is plain to see, whether the axis would look rigid without it is idle.
    look = look_at(wobbling, with_iron)
    plain_to_see = look.gain * _inefficiency(wobbling) > RULE.clear
    plain = wobbling if plain_to_see else rigid_or_wobbling(wobbling)
    if plain is not wobbling:
        look = look_at(plain, with_iron)

    def rich() -> Fit:
        # An axis that is rigid without soft iron is rigid with it, which explains more.
        begun = plain if not plain.block.leans else _near(start)
        weighting = replace(begun.block.weighting, inefficiency=1.0)
        block = begun.block.weighted(weighting)

        def under(prior: Prior) -> Fit:
            return refined(refined(Fit((block,), prior), SOFTENING), TRIMMING)

        iron = with_iron_as_large_as_seen(under, with_iron)
        return rigid_or_wobbling(iron) if iron.block.leans else iron

    choice = with_soft_iron_or_without(plain, look, rich, honest=True, always=always)
    if plain_to_see and choice.doubt is not None:
        plain = rigid_or_wobbling(wobbling)
        look, gain = look_at(plain, with_iron), choice.soft_iron_gain
        doubt = Doubt(look, look.probability(gain / _inefficiency(plain)))
        choice = Choice(plain, gain, doubt)
    return replace(choice, fit=settled(choice.fit))


def propagated_attitudes(start: Fit, path: GyroPath, with_iron: Prior, *, always: bool) -> Choice:
    """Fit one turn with gyro-propagated attitudes.

    Parameters
    ----------
    start : Fit
        Any fit of the samples that `path` belongs to, without soft iron.
    path : GyroPath
    with_iron, always
        As for `free_attitudes`.
    """
    explained = pulled_or_not(start, path, with_iron)
    plain, gap = explained.fit, explained.gap
    block = gyro_block(plain)
    if explained.own_lean or not with_iron.has_soft_iron:
        return Choice(
            plain, gap=gap, own_lean=explained.own_lean, may_be_pulled=explained.may_be_pulled
        )
    path = block.path

    def rich() -> Fit:
        return with_iron_as_large_as_seen(lambda prior: propagated(start, path, prior), with_iron)

    # Where soft iron was taken for drift, the fit without it no longer shows its slope.
    look, honest = look_at(plain, with_iron), block.drift < DRIFT.usual
    choice = with_soft_iron_or_without(plain, look, rich, honest=honest, always=always)
    return replace(choice, gap=gap, may_be_pulled=explained.may_be_pulled)


def with_iron_as_large_as_seen(under: Callable[[Prior], Fit], prior: Prior) -> Fit:
    """Fit soft iron, and again where it is far larger than believed.

    A belief of a few percent, held against samples that show a fifth, bends everything else. Each
    number of soft iron gets a sigma of its own size (the belief's tails are heavy); what the turn
    does not show stays small and keeps its own.

    Parameters
    ----------
    under : callable
        Fits with a prior.
    prior : Prior
        Frees soft iron.
    """
    fit = under(prior)
    for _ in range(RULE.most_widenings):
        wider = prior.as_wide_as(fit.shared, RULE.far_beyond)
        if wider is fit.prior or np.array_equal(wider.information, fit.prior.information):
            break
        fit = under(wider)
    return fit


def with_soft_iron_or_without(
    plain: Fit, look: Look, rich: Callable[[], Fit], *, honest: bool, always: bool
) -> Choice:
    """Fit soft iron where it may be there, and take it where the samples ask for it.

    Parameters
    ----------
    plain : Fit
        The optimum without it.
    look : Look
        What it would bring, seen from there.
    rich : callable
        Fits it.
    honest : bool
        Whether what `look` says can be relied on.
    always : bool
        Whether soft iron is fitted whatever the samples say.
    """
    gain = look.gain * _inefficiency(plain)
    # Where soft iron was taken for outliers, what is left no longer shows its slope.
    honest = honest and bool(plain.block.weighting.inliers.mean() > RULE.honest_share)
    if always or not honest or gain > RULE.worth_a_fit:
        iron = rich()
        gain = soft_iron_gain(plain, iron)
        block = iron.block
        if block.leans:
            # Leans take a passing disturbance's side with soft iron: Occam's factor is too mild.
            needed = RULE.most_fall
        else:
            rigid = isinstance(block, FreeBlock)
            needed = look.needed(RULE.most_fall_rigid if rigid else RULE.most_fall)
        # A gyro that drifts more than gyros do hides errors that last, which correlation does not
        # show.
        needed *= min(max(1.0, (block.drift / DRIFT.usual) ** 2), RULE.most_caution)
        kept = _explained(iron, plain) >= RULE.few_kept * plain.block.weighting.inliers.sum()
        if always or (kept and gain > needed * block.weighting.inefficiency):
            return Choice(iron, gain)
    return Choice(plain, gain, Doubt(look, look.probability(gain / _inefficiency(plain))))


def _explained(rich: Fit, plain: Fit) -> int:
    """Return how many samples the rich model explains, by its gate or by the plain one's noise.

    Where the noise falls, the gate narrows, and what it then leaves out was explained no better
    before.
    """
    chi = rich.block.weighted(plain.block.weighting).chi
    return int(np.sum(rich.block.weighting.inliers | passes_alone(chi)))


def _inefficiency(fit: Fit) -> float:
    return fit.block.weighting.inefficiency


def _near(start: Fit) -> Fit:
    """Return where soft iron is freed on a wobbling axis.

    Where nothing is known of the field, leans that stand for soft iron take strength and dip far
    away; a rigid axis leaves them where the prior of a small hard iron has them.
    """
    if not start.prior.holds_hard_iron:
        return start
    block = start.block
    assert isinstance(block, FreeBlock)
    shared = steps_of(start.with_blocks([block.stiffened()]), NEAR).fit.shared
    place = Evaluation(State(shared, block.place.state.attitude), block.samples)
    return start.with_blocks([replace(block, place=place)])


def rigid_or_wobbling(wobbling: Fit) -> Fit:
    """Return the fit of a rigid axis where it explains the samples nearly as well."""
    free = wobbling.block
    assert isinstance(free, FreeBlock)
    if free.wobble > AXIS.largest_rigid:
        return wobbling
    rigid = refined(wobbling.with_blocks([free.stiffened()]), TRIMMING)
    stiff = rigid.block
    assert isinstance(stiff, FreeBlock)
    if stiff.weighting.inliers.sum() < AXIS.few_common * free.weighting.inliers.sum():
        return wobbling
    common = stiff.weighting.inliers & free.weighting.inliers
    factor = free.weighting.inefficiency
    gain = evidence(stiff, rigid.prior, common, factor) - evidence(
        free, wobbling.prior, common, factor
    )
    return wobbling if gain > AXIS.needed * factor else rigid


def soft_iron_gain(plain: Fit, iron: Fit) -> float:
    """Return by how much soft iron lowers the cost, under the noise and gate found with it.

    Only then are the two nested: noise found by each for itself moves the comparison by more than
    what is to be decided.
    """
    without = steps_of(_under(plain, iron), COMPARE).fit
    with_it = steps_of(iron, COMPARE).fit
    fall = without.cost + without.lean_cost - with_it.cost - with_it.lean_cost
    falls = without.block.sample_costs - with_it.block.sample_costs
    gain = lasting_gain(_inefficiency(iron) * fall, falls)
    inliers = plain.block.weighting.inliers
    if inliers.mean() < RULE.trusted_share:
        return gain
    # What soft iron explains beyond the plain model's inliers may be a disturbance that passed by.
    return min(gain, float(falls[inliers].sum()))


def _under(poor: Fit, rich: Fit) -> Fit:
    """Return a poorer model under the weighting and drift of a richer one."""
    return poor.with_blocks([poor.block.under(rich.block)])


def lasting_gain(total: float, falls: FloatArray) -> float:
    """Return the gain as far as it is made all along the turn.

    Soft iron helps everywhere, something that passed by in one place, and what fits one stretch
    at the expense of others is something else.

    Parameters
    ----------
    total : float
        Fall of the cost.
    falls : ndarray, shape (n,)
        Each sample's fall of chi-square.
    """
    parts = np.array([part.sum() for part in np.array_split(falls, RULE.stretches)])
    one_place = max(float(parts.max()), float((parts[:-1] + parts[1:]).max()))
    return min(total, (float(parts.sum()) - max(one_place, 0.0)) / RULE.lasting_share)


def look_at(fit: Fit, with_iron: Prior) -> Look:
    """Return what soft iron would bring, from the slope at zero."""
    freed = replace(fit, prior=with_iron)
    return look_for_soft_iron(inverse_information(freed.information), freed.gradient, with_iron)


def explains_as_well(propagated: Fit, free: Fit, lenience: float = PROPAGATION.lenience) -> bool:
    """Return whether the gyro's attitudes fit about as well as attitudes of the samples' own."""
    block = propagated.block
    usual = max(free.block.weighting.noise.field, FLOOR.field)
    return bool(
        block.weighting.noise.field < PROPAGATION.field_ratio * usual + lenience
        and block.weighting.inliers.mean() > PROPAGATION.fewest
        and block.drift < PROPAGATION.drift * DRIFT.largest
    )
