"""Which effects of the turn rate a turn shows (doc/estimator.md, section 9)."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.special import chdtri

from magcal_ros.core.estimation.effects import Effect, Effects, effects_of_rate
from magcal_ros.core.estimation.gyro_attitude import DRIFT, GyroBlock
from magcal_ros.core.estimation.gyro_path import GyroPath
from magcal_ros.core.estimation.prior import Prior
from magcal_ros.core.estimation.schedule import FIRST_NOISE, PROPAGATING
from magcal_ros.core.estimation.solver import Fit, refined, settled


@dataclass(frozen=True)
class EffectRule:
    """When an effect is fitted.

    Parameters
    ----------
    chance : float
        Of the fall of chi-square that it promises (Rao's score test), samples counted by the
        inefficiency factor.
    largest : float
        Sigmas of its prior beyond which it is something else: a car's circle is no lever arm.
    """

    chance: float = 1e-4
    largest: float = 4.0


EFFECTS = EffectRule()
OF_RATE = (Effect.LATENCY, Effect.LEVER_ARM, Effect.MOTORS)


def propagated(start: Fit, path: GyroPath, prior: Prior) -> Fit:
    """Fit one turn with gyro-propagated attitudes from the attitudes of any fit."""
    weighting = replace(start.block.weighting, noise=FIRST_NOISE, inefficiency=1.0)
    block = start.block
    begun = GyroBlock.started(block.place.state, block.samples, weighting, path, DRIFT.first)
    return settled(refined(Fit((begun,), prior), PROPAGATING))


def with_effects_that_show(start: Fit, path: GyroPath) -> Fit:
    """Fit without soft iron, with those effects of the turn rate that stand out of chance.

    The clearest first: what is not yet taken off may pass for another.
    """
    fit, left = propagated(start, path, start.prior), list(OF_RATE)
    shared = fit.shared
    field = start.block.samples.field - shared.hard_iron
    effects = effects_of_rate(path.pace, field, shared.distortion(fit.mounting))
    while left:
        over = {kind: _score(fit, effects.only(kind)) for kind in left}
        clearest = max(left, key=lambda kind: over[kind])
        if over[clearest] < 1.0:
            break
        left.remove(clearest)
        wider = path.with_effects(effects.only(clearest))
        richer = propagated(start, wider, start.prior)
        block = richer.block
        assert isinstance(block, GyroBlock)
        found = wider.found(block.errors, clearest) / effects.only(clearest).sigma
        if np.abs(found).max() < EFFECTS.largest:
            fit, path = richer, wider
    return fit


def _score(fit: Fit, effects: Effects) -> float:
    """Return by what an effect's first step would lower chi-square, over what chance would."""
    block = fit.block
    assert isinstance(block, GyroBlock)
    size, factor = len(effects), block.weighting.inefficiency
    errors = np.concatenate([block.errors, np.zeros(size)])
    freed = replace(block, path=block.path.with_effects(effects), errors=errors)
    equations = freed.equations(fit.free)
    information = equations.information.copy()
    count = equations.free
    information[:count, :count] += factor * fit.prior_information
    across = information[:-size, -size:]
    among = np.linalg.lstsq(information[:-size, :-size], across, rcond=None)[0]
    left = information[-size:, -size:] - across.T @ among
    slope = equations.gradient[-size:]
    fall = float(slope @ np.linalg.solve(left, slope)) / factor
    return fall / float(chdtri(size, EFFECTS.chance))
