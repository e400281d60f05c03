"""Which effects of the turn rate a turn shows (doc/estimator.md, section 9)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import chdtri

from magcal_ros.core.estimation.effects import Effect, Effects, effects_of_rate
from magcal_ros.core.estimation.gyro_attitude import DRIFT, GyroBlock
from magcal_ros.core.estimation.gyro_path import GyroPath
from magcal_ros.core.estimation.prior import Prior
from magcal_ros.core.estimation.schedule import FIRST_NOISE, PROPAGATING
from magcal_ros.core.estimation.solver import Fit, refined, settled
from magcal_ros.core.geometry.arrays import FloatArray


@dataclass(frozen=True)
class EffectRule:
    """When an effect is fitted.

    Parameters
    ----------
    chance : float
        Of the fall of chi-square that it promises (Rao's score test, samples as they are), and of
        what came of it (Wald's test, samples counted by the inefficiency factor that is left).
    largest : float
        Sigmas of its prior beyond which it is something else: a car's circle is no lever arm.
    fewest, lost : float
        Share of the samples that must be believed without it, and share of the largest drift that
        the gyro may need; else it is not asked for.
    """

    chance: float = 1e-4
    largest: float = 4.0
    fewest: float = 0.5
    lost: float = 0.9


EFFECTS = EffectRule()
OF_RATE = (Effect.LATENCY, Effect.LEVER_ARM, Effect.MOTORS)


def gyro_block(fit: Fit) -> GyroBlock:
    """Return the block of a fit of one turn with gyro-propagated attitudes."""
    assert isinstance(fit.block, GyroBlock)
    return fit.block


def propagated(start: Fit, path: GyroPath, prior: Prior) -> Fit:
    """Fit one turn with gyro-propagated attitudes from the attitudes of any fit."""
    weighting = replace(start.block.weighting, noise=FIRST_NOISE, inefficiency=1.0)
    block = start.block
    begun = GyroBlock.started(block.place.state, block.samples, weighting, path, DRIFT.first)
    return settled(refined(Fit((begun,), prior), PROPAGATING))


def with_effects_that_show(
    start: Fit, path: GyroPath, beside: Prior, kinds: Sequence[Effect] = OF_RATE
) -> Fit:
    """Fit without soft iron, with those effects of the turn rate that stand out of chance.

    The clearest first: what is not yet taken off may pass for another.

    Parameters
    ----------
    start : Fit
    path : GyroPath
    beside : Prior
        Of soft iron, where it may be: where the rate follows the heading, as on a turn there and
        back, it looks like motors.
    kinds : sequence of Effect
        Those that are looked for.
    """
    fit, left = propagated(start, path, start.prior), list(kinds)
    effects = _effects(path, fit)
    while left and not _is_lost(fit):
        # On the average of a turn a lever arm is what an accelerometer that is off reads always.
        over = {kind: _promised(fit, effects.only(kind).without_mean(), beside) for kind in left}
        clearest = max(left, key=lambda kind: over[kind])
        if over[clearest] < 1.0:
            break
        left.remove(clearest)
        wider = path.with_effects(effects.only(clearest))
        richer = propagated(start, wider, start.prior)
        if _stands_out(richer, clearest, beside):
            fit, path = richer, wider
    return fit


def with_lever_arm(path: GyroPath, fit: Fit) -> GyroPath:
    """Return the path of a robot whose accelerometer may be beside the turn's axis.

    Parameters
    ----------
    path : GyroPath
    fit : Fit
        Of the same turn, by anything.
    """
    if Effect.LEVER_ARM in path.effects:
        return path
    return path.with_effects(_effects(path, fit).only(Effect.LEVER_ARM))


def _effects(path: GyroPath, fit: Fit) -> Effects:
    shared = fit.shared
    field = fit.block.samples.field - shared.hard_iron
    return effects_of_rate(path.pace, field, shared.distortion(fit.mounting))


def _is_lost(fit: Fit) -> bool:
    """Return whether gyro and field go ways of their own: whatever bends the one helps a little."""
    block = gyro_block(fit)
    believed = float(block.weighting.inliers.mean())
    return believed < EFFECTS.fewest or block.drift > EFFECTS.lost * DRIFT.largest


def _promised(fit: Fit, effects: Effects, beside: Prior) -> float:
    """Return by what an effect's first step would lower chi-square, over what chance would.

    What is left out correlates the residuals, so samples count as they are.
    """
    block = gyro_block(fit)
    size = len(effects)
    errors = np.concatenate([block.errors, np.zeros(size)])
    freed = replace(block, path=block.path.with_effects(effects), errors=errors)
    left, slope = _alone(freed, beside, size)
    fall = float(slope @ np.linalg.solve(left, slope))
    return fall / float(chdtri(size, EFFECTS.chance))


def _stands_out(fit: Fit, kind: Effect, beside: Prior) -> bool:
    """Return whether the newest effect is more than chance (Wald's test), and possible."""
    block = gyro_block(fit)
    found = block.path.found(block.errors, kind)
    left, slope = _alone(block, beside, len(found))
    lasting = found + np.linalg.solve(left, slope)
    fall = float(lasting @ left @ lasting) / block.weighting.inefficiency
    sigma = block.path.effects.only(kind).sigma
    possible = float(np.abs(found / sigma).max()) < EFFECTS.largest
    return possible and fall > float(chdtri(len(found), EFFECTS.chance))


def _alone(block: GyroBlock, prior: Prior, size: int) -> tuple[FloatArray, FloatArray]:
    """Return information and gradient on the last errors, all else eliminated."""
    equations, factor = block.equations(prior.free), block.weighting.inefficiency
    information, gradient = equations.information.copy(), equations.gradient.copy()
    known, count = prior.information[prior.free], equations.free
    information[np.arange(count), np.arange(count)] += factor * known
    gradient[:count] += factor * known * prior.deviation(block.place.state.shared)[prior.free]
    across = information[:-size, -size:]
    among = np.linalg.lstsq(information[:-size, :-size], across, rcond=None)[0]
    return (
        information[-size:, -size:] - across.T @ among,
        gradient[-size:] - among.T @ gradient[:-size],
    )
