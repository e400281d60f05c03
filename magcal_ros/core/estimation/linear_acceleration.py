"""Whether a turn pulls at its accelerometer, or its gyro has a bias (doc/estimator.md, section 9).

On an even turn the two look alike: the gyro's mean axis and the mean specific force differ. A pull
follows the turn rate, and a bias does not. Where that does not show, what is known of sensors and
vehicles speaks: a gyro that is far off about two axes is off about the third, an accelerometer is
off by little, and a vehicle that is pulled for long is jolted, too.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from magcal_ros.core.estimation.evidence import propagated_evidence
from magcal_ros.core.estimation.gyro_attitude import DRIFT, GyroBlock
from magcal_ros.core.estimation.gyro_path import BIAS, GyroPath
from magcal_ros.core.estimation.heading_gap import heading_gap
from magcal_ros.core.estimation.model import Samples
from magcal_ros.core.estimation.prior import Prior
from magcal_ros.core.estimation.schedule import FIRST_NOISE, PROPAGATING
from magcal_ros.core.estimation.solver import Fit, refined, settled
from magcal_ros.core.geometry.arrays import FloatArray
from magcal_ros.core.geometry.attitude import unit
from magcal_ros.core.geometry.rotations import minimal_rotation, skew


@dataclass(frozen=True)
class AccelerationRule:
    """When a linear acceleration of the turn is looked for, and when it is taken.

    Held to an accelerometer that always leans, the gyro can only follow with a bias, a drift or a
    lean that no gyro has. Costs are minus twice a log likelihood per independent sample.

    Parameters
    ----------
    bias, stray, drift : float
        Sigmas of the gyro's bias, sigmas of the mean of up's residual, and times the usual drift,
        beyond which it is looked for.
    inefficiency : float
        Samples per independent sample beyond which it is: what is left out correlates residuals.
    needed : float
        Fall of the cost from which the plain model is given up.
    clear : float
        Fall from which nothing but the samples is asked, and one explanation alone remains.
    own_lean : float
        Sigma of the lean that accelerometer and gyro have against one another by themselves,
        offsets and crossed axes together: over gravity, per axis.
    jolted : float
        Times the slow jolts of the acceleration that it may be pulled on average.
    least_pull : float
        Sigma of the pull of a robot that turns on the spot, over gravity: its lever arm.
    jolt : float
        Seconds over which a jolt is averaged; what is shorter is vibration.
    usual_bias : float
        rad/s. Of a larger bias every size is as likely as another.
    bad_bias, overwhelming : float
        rad/s of bias about up, which the field shows, that a pull must not need at the same time,
        or the gyro is no witness of it; and the fall from which the samples have no other
        explanation all the same.
    spread_of_drift : float
        Times by which the random walk of gyros usually differs from the usual one.
    amiss : float
        Sigma of what a pull grows with the square of the rate otherwise than expected, over its
        mean.
    least_doubt : float
        Probability that what is less likely keeps as long as the samples leave it open.
    idle : float
        Probability below which it is not looked at.
    """

    bias: float = 2.0
    stray: float = 3.5
    drift: float = 3.0
    inefficiency: float = 8.0
    needed: float = 10.0
    clear: float = 20.0
    own_lean: float = 0.025
    jolted: float = 6.0
    least_pull: float = 0.01
    jolt: float = 1.0
    usual_bias: float = 0.003
    bad_bias: float = math.radians(0.5)
    overwhelming: float = 60.0
    spread_of_drift: float = 2.0
    amiss: float = 0.35
    least_doubt: float = 0.12
    idle: float = 0.002


ACCELERATION = AccelerationRule()
OWN, PULLED, BAD = range(1, 4), range(4, 6), 5
"""Which of the explanations leave up to the accelerometer, and which to the gyro. That it is a bad
one besides is counted as a doubt and never followed: then the accelerometer is trusted instead."""
MEAN, AMISS = slice(-6, -3), slice(-3, None)
"""Where a pull stands among the errors of an accelerated path."""
LEVEL_LEAN = 0.1
"""Lean, over gravity, of one sigma of which a pull is worth neither more nor less."""


def propagated(start: Fit, path: GyroPath, prior: Prior) -> Fit:
    """Fit one turn with gyro-propagated attitudes from the attitudes of any fit."""
    weighting = replace(start.block.weighting, noise=FIRST_NOISE, inefficiency=1.0)
    block = start.block
    begun = GyroBlock.started(block.place.state, block.samples, weighting, path, DRIFT.first)
    return settled(refined(Fit((begun,), prior), PROPAGATING))


def pulled_or_not(start: Fit, path: GyroPath) -> tuple[Fit, float]:
    """Fit without soft iron: plain, or with what parts gyro and accelerometer.

    A linear acceleration of the turn is none of the robot's when it stands, and is taken off. A
    large bias of the gyro, or axes and offsets by which both sensors differ, leave up to the
    accelerometer, which will read the same when the calibration is used.

    Returns
    -------
    Fit
    float
        Radians of heading to another explanation that cannot be excluded, RMS over what is likely.
    """
    plain = propagated(start, path, start.prior)
    if not _is_strained(plain):
        return plain, 0.0
    gyros = path, path.with_doubtful_gyro()
    pulls = [propagated(start, replace(gyro, accelerated=True), start.prior) for gyro in gyros]
    leans = [
        propagated(start, gyro.turned(_own_lean(pulled)), start.prior)
        for gyro, pulled in zip(gyros, pulls, strict=True)
    ]
    biased = propagated(start, gyros[1], start.prior)
    fits = (plain, biased, *leans, *pulls)
    factor = min(fit.block.weighting.inefficiency for fit in fits)
    misfits = [_misfit(fit, factor) for fit in fits]
    costs = [
        path.bias_in_sigmas(_gyro_block(plain).errors) ** 2,
        _cost_of_bias(biased),
        *(_cost_of_own_lean(*pair) for pair in zip(leans, pulls, strict=True)),
        *(_cost_of_pull(fit) for fit in pulls),
    ]
    costs = [misfit + cost for misfit, cost in zip(misfits, costs, strict=True)]
    if costs[0] < min(costs) + ACCELERATION.needed:
        return plain, 0.0
    own, pull = min(OWN, key=costs.__getitem__), PULLED[0]
    favour, shown = costs[own] - costs[pull], min(misfits[1:4]) - misfits[pull]
    bad = misfits[BAD] < misfits[pull] and _bias_about_up(fits[BAD]) > ACCELERATION.bad_bias
    bad = bad and shown < ACCELERATION.overwhelming
    chosen, rival = (pull, own) if favour > 0.0 and not bad else (own, pull)
    doubts = [min(_doubt(cost - costs[chosen]), 0.5) for cost in costs]
    if favour * shown <= 0.0 or abs(shown) <= ACCELERATION.clear:
        doubts[rival] = max(doubts[rival], ACCELERATION.least_doubt)
    gaps = [
        math.sqrt(doubts[k]) * heading_gap(fits[k], fits[chosen])
        for k in (*OWN, *PULLED)
        if k != chosen and doubts[k] > ACCELERATION.idle
    ]
    return fits[chosen], max(gaps, default=0.0)


def _doubt(cost: float) -> float:
    """Return how likely an explanation is beside one that costs so much less."""
    return 1.0 / (1.0 + math.exp(min(0.5 * cost, 50.0)))


def _gyro_block(fit: Fit) -> GyroBlock:
    assert isinstance(fit.block, GyroBlock)
    return fit.block


def _lean(pulled: Fit) -> float:
    return float(np.linalg.norm(_gyro_block(pulled).acceleration))


def _bias(fit: Fit) -> float:
    return float(np.linalg.norm(_gyro_block(fit).bias))


def _bias_about_up(fit: Fit) -> float:
    block = _gyro_block(fit)
    return abs(float(block.bias @ unit(block.samples.up.mean(axis=0))))


def _own_lean(pulled: Fit) -> FloatArray:
    """Return the turn from the gyro's axes to those in which the accelerometer does not lean."""
    block = _gyro_block(pulled)
    up = unit((block.samples.up - block.path.accelerations(block.errors)).mean(axis=0))
    return minimal_rotation(up, unit(up + block.acceleration))


def _misfit(fit: Fit, factor: float) -> float:
    """Return the cost of an explanation before what is known of biases, pulls and leans."""
    block = _gyro_block(fit)
    known = block.path.known
    pull = float(np.sum(block.errors[-6:] ** 2)) / known.acceleration**2
    bias = block.path.bias_in_sigmas(block.errors) ** 2
    far = math.log(max(block.drift / DRIFT.usual, 1.0)) / math.log(ACCELERATION.spread_of_drift)
    return propagated_evidence(fit, factor) - bias - pull * block.path.accelerated + far**2


def _cost_of_bias(fit: Fit) -> float:
    """Return what a bias costs of which every size is as likely, if it is not small."""
    return 3.0 * math.log1p((_bias(fit) / ACCELERATION.usual_bias) ** 2)


def _cost_of_lean(lean: float, sigma: float) -> float:
    """Return what a lean of two axes costs whose sigma per axis is known."""
    return (lean / sigma) ** 2 + 4.0 * math.log(sigma / LEVEL_LEAN)


def _cost_of_own_lean(leaning: Fit, pulled: Fit) -> float:
    """Return what it costs that accelerometer and gyro differ by the lean that a pull would be."""
    return _cost_of_bias(leaning) + _cost_of_lean(_lean(pulled), ACCELERATION.own_lean)


def _cost_of_pull(fit: Fit) -> float:
    """Return what a pull costs: it follows the rate, and who is pulled is jolted, too."""
    block = _gyro_block(fit)
    able = max(ACCELERATION.jolted * _jolts(block), ACCELERATION.least_pull)
    able = min(able, block.path.known.acceleration)
    size, amiss = (float(np.linalg.norm(block.errors[rows])) for rows in (MEAN, AMISS))
    unlike = amiss / (ACCELERATION.amiss * max(size, 1e-6))
    return _cost_of_lean(size, able) + unlike**2 + _cost_of_bias(fit)


def _jolts(block: GyroBlock) -> float:
    """Return what is left of up over `ACCELERATION.jolt` seconds: correlation is no vibration."""
    seconds = block.path.knots * block.path.spacing
    independent = len(block.samples) / block.weighting.inefficiency
    return block.weighting.noise.up * math.sqrt(seconds / ACCELERATION.jolt / independent)


def apparent_pull(samples: Samples, path: GyroPath) -> float:
    """Return how far the mean specific force leans from the gyro's up, radians.

    Up that stands still in the world, a lean that turns with the robot, and the gyro's bias are
    told apart, so that neither a slope nor part of a second turn counts, nor a pause.

    Parameters
    ----------
    samples : Samples
    path : GyroPath
        Of the same samples.
    """
    forth = path.relative
    still = unit(np.einsum("nji,nj->i", forth, samples.up))
    rows = np.concatenate(
        [
            forth,
            -forth @ skew(still) @ path.basis[:, :, BIAS],
            np.broadcast_to(np.eye(3), forth.shape),
        ],
        axis=2,
    ).reshape(-1, 9)
    # One jolt is one witness, however many samples it is seen in.
    seconds = path.knots * path.spacing
    weight = seconds / ACCELERATION.jolt / len(samples) / ACCELERATION.own_lean**2
    known = np.repeat([0.0, path.known.bias**-2, path.known.acceleration**-2], 3)
    found = np.linalg.solve(
        weight * rows.T @ rows + np.diag(known), weight * rows.T @ samples.up.ravel()
    )
    lean = found[6:] - still * float(found[6:] @ still)
    return math.atan(float(np.linalg.norm(lean)))


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
