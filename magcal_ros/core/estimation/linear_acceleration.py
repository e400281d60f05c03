"""Whether a turn pulls at its accelerometer, or its gyro has a bias (doc/estimator.md, section 9).

On an even turn the two look alike: the gyro's mean axis and the mean specific force differ. A pull
follows the turn rate, and a bias does not.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from magcal_ros.core.estimation.evidence import propagated_evidence
from magcal_ros.core.estimation.gyro_attitude import DRIFT, GyroBlock
from magcal_ros.core.estimation.gyro_path import GyroPath
from magcal_ros.core.estimation.heading_gap import heading_gap
from magcal_ros.core.estimation.prior import Prior
from magcal_ros.core.estimation.schedule import FIRST_NOISE, PROPAGATING
from magcal_ros.core.estimation.solver import Fit, refined, settled


@dataclass(frozen=True)
class AccelerationRule:
    """When a linear acceleration of the turn is looked for, and when it is taken.

    Held to an accelerometer that always leans, the gyro can only follow with a bias, a drift or a
    lean that no gyro has; and a gyro with a large bias looks, on an even turn, as if the robot were
    pulled. What tells them apart is that the pull follows the turn rate.

    Parameters
    ----------
    bias, stray, drift : float
        Sigmas of the gyro's bias, sigmas of the mean of up's residual, and times the usual drift,
        beyond which it is looked for.
    inefficiency : float
        Samples per independent sample beyond which it is: what is left out correlates residuals.
    needed : float
        Fall of minus twice the log likelihood per independent sample from which the plain model
        is given up.
    clear : float
        And by which the acceleration must beat a gyro with a large bias; below it both remain
        possible.
    """

    bias: float = 2.0
    stray: float = 3.5
    drift: float = 3.0
    inefficiency: float = 8.0
    needed: float = 20.0
    clear: float = 20.0


ACCELERATION = AccelerationRule()


def propagated(start: Fit, path: GyroPath, prior: Prior) -> Fit:
    """Fit one turn with gyro-propagated attitudes from the attitudes of any fit."""
    weighting = replace(start.block.weighting, noise=FIRST_NOISE, inefficiency=1.0)
    block = start.block
    begun = GyroBlock.started(block.place.state, block.samples, weighting, path, DRIFT.first)
    return settled(refined(Fit((begun,), prior), PROPAGATING))


def pulled_or_not(start: Fit, path: GyroPath) -> tuple[Fit, float]:
    """Fit without soft iron: plain, with a linear acceleration, or with a large bias of the gyro.

    Returns
    -------
    Fit
    float
        Radians of heading between it and another explanation that cannot be excluded.
    """
    plain = propagated(start, path, start.prior)
    if not _is_strained(plain):
        return plain, 0.0
    pulled = propagated(start, replace(path, accelerated=True), start.prior)
    biased = propagated(start, path.with_doubtful_gyro(), start.prior)
    factor = min(fit.block.weighting.inefficiency for fit in (plain, pulled, biased))
    none, pull, bias = (propagated_evidence(fit, factor) for fit in (plain, pulled, biased))
    if none < min(pull, bias) + ACCELERATION.needed:
        return plain, 0.0
    if pull < bias - ACCELERATION.clear:
        return pulled, 0.0
    return biased, heading_gap(biased, pulled)


def _is_strained(plain: Fit) -> bool:
    """Return whether the gyro needs a large bias or drift, or up strays to one side."""
    block = plain.block
    assert isinstance(block, GyroBlock)
    counted = block.weighting.weights.sample
    count = max(float(counted.sum()), 1.0)
    mean = float(np.linalg.norm(counted @ block.place.prediction.up_residual)) / count
    chance = block.weighting.noise.up * np.sqrt(block.weighting.inefficiency / count)
    return bool(
        block.path.bias_in_sigmas(block.errors) > ACCELERATION.bias
        or mean > ACCELERATION.stray * chance
        or block.drift > ACCELERATION.drift * DRIFT.usual
        or block.weighting.inefficiency > ACCELERATION.inefficiency
    )
