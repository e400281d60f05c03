"""Whether a turn pulls at its accelerometer, or its gyro has a bias (doc/estimator.md, section 9).

On an even turn the two look alike: the gyro's mean axis and the mean specific force differ. A pull
follows the turn rate, and a bias does not.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from magcal_ros.core.estimation.effect_choice import propagated, with_effects_that_show
from magcal_ros.core.estimation.evidence import propagated_evidence
from magcal_ros.core.estimation.gyro_attitude import DRIFT, GyroBlock
from magcal_ros.core.estimation.gyro_path import GyroPath
from magcal_ros.core.estimation.heading_gap import heading_gap
from magcal_ros.core.estimation.solver import Fit
from magcal_ros.core.geometry.attitude import unit


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


@dataclass(frozen=True, eq=False)
class Explanation:
    """What explains up and gyro together.

    Parameters
    ----------
    fit : Fit
    gap : float
        Radians of heading between it and another explanation that cannot be excluded.
    own_lean : bool
        Whether up leans from the gyro's axis at rest as well, so that the lean is the
        accelerometer's own: the compass has it, too, and the gyro's axis helps nothing.
    """

    fit: Fit
    gap: float = 0.0
    own_lean: bool = False


def pulled_or_not(start: Fit, path: GyroPath) -> Explanation:
    """Fit without soft iron: plain, with a linear acceleration, or with a large bias of the gyro.

    A rest beside the turn decides it: it shows the bias, and what pulls a turn is not there.
    """
    plain = with_effects_that_show(start, path)
    block = plain.block
    assert isinstance(block, GyroBlock)
    path = block.path
    if not _is_strained(plain):
        return Explanation(plain)
    pulled = propagated(start, path.with_acceleration(), start.prior)
    if path.rests:
        factor = min(fit.block.weighting.inefficiency for fit in (plain, pulled))
        none, pull = (propagated_evidence(fit, factor) for fit in (plain, pulled))
        if none < pull + ACCELERATION.needed:
            return Explanation(plain)
        own = _leans_at_rest(pulled)
        return Explanation(plain if own else pulled, own_lean=own)
    biased = propagated(start, path.with_doubtful_gyro(), start.prior)
    factor = min(fit.block.weighting.inefficiency for fit in (plain, pulled, biased))
    none, pull, bias = (propagated_evidence(fit, factor) for fit in (plain, pulled, biased))
    if none < min(pull, bias) + ACCELERATION.needed:
        return Explanation(plain)
    if pull < bias - ACCELERATION.clear:
        return Explanation(pulled)
    return Explanation(biased, heading_gap(biased, pulled))


def _leans_at_rest(pulled: Fit) -> bool:
    """Return whether most of a pull is there at rest, where nothing pulls."""
    block = pulled.block
    assert isinstance(block, GyroBlock)
    shared, path = block.place.state.shared, block.path
    shares = []
    for rest in path.rests:
        row = 0 if rest.is_before else -1
        body = shared.body_axis @ block.place.state.attitude[row] @ shared.world_axis.T
        upright = rest.relative @ path.relative[row].T @ body[:, 2]
        lean = unit(rest.seen.force) - upright
        shares.append(float(lean @ block.acceleration))
    return float(np.mean(shares)) > 0.5 * float(block.acceleration @ block.acceleration)


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
