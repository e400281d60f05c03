"""Whether a turn has a linear acceleration, or its gyro has a bias (doc/estimator.md, section 9).

On an even turn the two look alike: the gyro's mean axis and the mean specific force differ. A pull
follows the turn rate, and a bias does not. Where that does not show, what is known of sensors and
vehicles speaks: a gyro that is far off about two axes is off about the third, an accelerometer is
off by little, and a vehicle that is pulled for long is jolted, too.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import expit

from magcal_ros.core.estimation.effect_choice import (
    gyro_block,
    propagated,
    with_effects_that_show,
    with_lever_arm,
)
from magcal_ros.core.estimation.effects import Effect
from magcal_ros.core.estimation.evidence import propagated_evidence
from magcal_ros.core.estimation.gyro_attitude import DRIFT, GyroBlock
from magcal_ros.core.estimation.gyro_path import GyroPath
from magcal_ros.core.estimation.heading_gap import heading_gap
from magcal_ros.core.estimation.prior import Prior
from magcal_ros.core.estimation.solver import Fit
from magcal_ros.core.geometry.attitude import unit
from magcal_ros.core.geometry.rotations import minimal_rotation


@dataclass(frozen=True)
class AccelerationRule:
    """When a linear acceleration of the turn is looked for, and when it is taken.

    Held to an accelerometer that always leans, the gyro can only follow with a bias, a drift or a
    lean that no gyro has. Costs are minus twice a log likelihood per independent sample.

    Parameters
    ----------
    bias, deviation, drift : float
        Sigmas of the gyro's bias, sigmas of the mean of up's residual, and times the usual drift,
        beyond which it is looked for.
    inefficiency : float
        Samples per independent sample beyond which it is: what is left out correlates residuals.
    needed : float
        Fall of the cost from which the plain model is given up.
    taken_off : float
        Fall of the cost from which a pull is taken off: left in, it makes a calibration no worse
        than it is without a gyro.
    clear : float
        Fall from which nothing but the samples is asked, and one explanation alone remains.
    most_believed : float
        Share of the samples that a pull has to explain for that; else it has to be overwhelming.
    own_lean : float
        Sigma of the lean that accelerometer and gyro have against one another by themselves,
        offsets and crossed axes together: over gravity, per axis.
    level_lean : float
        Lean, over gravity, of one sigma of which a pull is worth neither more nor less.
    jolted : float
        Times the slow jolts of the acceleration that it may be pulled on average.
    jolted_alone : float
        The same without a gyro, of jolts beyond those of a robot that turns on the spot.
    least_pull : float
        Sigma of the pull of a robot that turns on the spot, over gravity: its lever arm.
    jolt : float
        Seconds over which a jolt is averaged; what is shorter is vibration.
    usual_bias : float
        rad/s. Of a larger bias every size is as likely as another.
    bad_bias, overwhelming : float
        rad/s of bias about up, which the field shows, that a pull must not need at the same time,
        or the gyro is not used for it; and the fall from which the samples have no other
        explanation all the same.
    spread_of_drift : float
        Times by which the random walk of gyros usually differs from the usual one.
    unexpected : float
        Sigma of what a pull grows with the square of the rate otherwise than expected, over its
        mean.
    least_doubt : float
        Probability that what is less likely keeps as long as the samples leave it open.
    idle : float
        Probability below which it is not looked at.
    on_the_spot : float
        Radians of jolts that a robot has that turns on the spot.
    largest_circle : float
        Metres. A robot without jolts drives no wider circle.
    arms : float
        Sigmas of the lever arm that explain a lean without a circle.
    """

    bias: float = 2.0
    deviation: float = 3.5
    drift: float = 3.0
    inefficiency: float = 8.0
    needed: float = 10.0
    taken_off: float = 10.0
    clear: float = 20.0
    most_believed: float = 0.9
    own_lean: float = 0.025
    level_lean: float = 0.1
    jolted: float = 10.0
    jolted_alone: float = 6.0
    least_pull: float = 0.01
    jolt: float = 1.0
    usual_bias: float = 0.003
    bad_bias: float = math.radians(0.5)
    overwhelming: float = 60.0
    spread_of_drift: float = 2.0
    unexpected: float = 0.35
    least_doubt: float = 0.12
    idle: float = 0.002
    on_the_spot: float = 0.015
    largest_circle: float = 4.0
    arms: float = 2.0


ACCELERATION = AccelerationRule()
OWN, PULLED, BAD = range(1, 4), range(4, 6), 5
"""Which of the explanations leave up to the accelerometer, and which to the gyro. That it is a bad
one besides is counted as a doubt; what it then says of the pull is taken only where a usual gyro
says that there is one."""
MEAN, UNEXPECTED = slice(0, 3), slice(3, 6)
"""Among the numbers of a pull."""


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
    may_be_pulled : bool
        Whether a pull of the turn can be neither seen nor excluded: what is usual of gyro and
        accelerometer explains the lean as well.
    """

    fit: Fit
    gap: float = 0.0
    own_lean: bool = False
    may_be_pulled: bool = False


def pulled_or_not(start: Fit, path: GyroPath, beside: Prior) -> Explanation:
    """Fit without soft iron: plain, or with what parts gyro and accelerometer.

    A linear acceleration of the turn is none of the robot's when it stands, and is taken off. A
    large bias of the gyro, or axes and offsets by which both sensors differ, leave up to the
    accelerometer, which will read the same when the calibration is used. A rest beside the turn
    decides it: it shows the bias, and what pulls a turn is not there.

    Parameters
    ----------
    start : Fit
    path : GyroPath
    beside : Prior
        Of soft iron, where it may be.
    """
    plain = with_effects_that_show(start, path, beside)
    if path.rests:
        return _with_rests(start, plain, path, beside)
    if not _is_strained(plain):
        return Explanation(plain, may_be_pulled=True)
    return _by_what_is_known(start, plain, beside)


def _with_rests(start: Fit, plain: Fit, bare: GyroPath, beside: Prior) -> Explanation:
    """Choose where rests show the gyro's bias: a lever arm may stand for a lean, and strain none.

    What it pulls by on the average of a turn is what an accelerometer that is off reads always.
    """
    if _is_strained(plain):
        return _by_rests(start, plain, beside)
    if Effect.LEVER_ARM not in gyro_block(plain).path.effects:
        return Explanation(plain)
    armless = with_effects_that_show(start, bare, beside, [Effect.LATENCY, Effect.MOTORS])
    if not _is_strained(armless):
        return Explanation(plain)
    other = _by_rests(start, armless, beside)
    if not other.own_lean:
        return Explanation(plain)
    factor = min(fit.block.weighting.inefficiency for fit in (plain, other.fit))
    by_arm, by_other = (propagated_evidence(fit, factor) for fit in (plain, other.fit))
    return other if by_other < by_arm else Explanation(plain)


def _by_rests(start: Fit, plain: Fit, beside: Prior) -> Explanation:
    """Choose by the rests beside the turn: they show the bias, and nothing pulls there."""
    path = gyro_block(plain).path
    pulled = propagated(start, path.with_acceleration(), start.prior)
    factor = min(fit.block.weighting.inefficiency for fit in (plain, pulled))
    none, pull = (propagated_evidence(fit, factor) for fit in (plain, pulled))
    if none < pull + ACCELERATION.needed:
        return Explanation(plain)
    share, sigma = _own_share(pulled)
    own = share > 0.5
    leaning = propagated(start, _leaning(path, pulled), start.prior)
    neglected = math.hypot(1.0 - share if own else share, sigma)
    gap = min(neglected, 1.0) * heading_gap(leaning, pulled)
    chosen = gyro_block(leaning if own else pulled).path
    return Explanation(_asked_anew(start, chosen, beside), gap, own_lean=own)


def _asked_anew(start: Fit, path: GyroPath, beside: Prior) -> Fit:
    """Fit a path with what stands out of it: what a lean bends passes for what follows the rate."""
    bare = replace(path, effects=path.effects.only(Effect.PULL))
    return with_effects_that_show(start, bare, beside)


def _own_share(pulled: Fit) -> tuple[float, float]:
    """Return which share of a pull is there at rest, where nothing pulls, and its sigma.

    The gyro carries up from the turn to the rest, and what it drifts by, it loses. What it leaves
    open is left to what is usual of accelerometers and vehicles.
    """
    block = gyro_block(pulled)
    shared, path = block.place.state.shared, block.path
    size = _lean(pulled)
    leans = []
    for rest in path.rests:
        row = 0 if rest.is_before else -1
        body = shared.body_axis @ block.place.state.attitude[row] @ shared.world_axis.T
        upright = rest.relative @ path.relative[row].T @ body[:, 2]
        lean = unit(rest.seen.force) - upright
        leans.append(float(lean @ block.acceleration) / size)
    walked = block.drift * math.sqrt(path.knots * path.spacing / 3.0 / len(leans))
    lost = math.hypot(walked, _chance_of_mean(block))
    weights = np.array([lost, ACCELERATION.own_lean, _able(block)]) ** -2.0
    own = weights @ [float(np.mean(leans)), 0.0, size] / weights.sum()
    return float(np.clip(own / size, 0.0, 1.0)), 1.0 / (size * math.sqrt(weights.sum()))


def _by_what_is_known(start: Fit, plain: Fit, beside: Prior) -> Explanation:
    """Weigh what may part gyro and accelerometer by what is known of sensors and vehicles.

    All are weighed with soft iron, where it may be: what bends the field would else speak for
    whatever else bends.
    """
    path = gyro_block(plain).path
    gyros = path, path.with_doubtful_gyro()
    pulled = [gyro.with_acceleration() for gyro in gyros]
    pulls = [propagated(start, each, beside) for each in pulled]
    turned = [_leaning(*pair) for pair in zip(gyros, pulls, strict=True)]
    # What of a pull follows the rate is a lever arm's, where the rest is the sensors' own lean.
    leans = [propagated(start, with_lever_arm(each, start), beside) for each in turned]
    others = [propagated(start, gyro, beside) for gyro in gyros]
    paths, fits = (*gyros, *turned, *pulled), (*others, *leans, *pulls)
    factor = pulls[0].block.weighting.inefficiency
    misfits = [_misfit(fit, factor) for fit in fits]
    costs = [
        path.bias_in_sigmas(gyro_block(fits[0]).errors) ** 2,
        _cost_of_bias(fits[1]),
        *(_cost_of_own_lean(*pair) for pair in zip(leans, pulls, strict=True)),
        *(_cost_of_pull(fit) for fit in pulls),
    ]
    costs = [misfit + cost for misfit, cost in zip(misfits, costs, strict=True)]
    if costs[0] < min(costs) + ACCELERATION.needed:
        return Explanation(plain, may_be_pulled=True)
    usual = gyro_block(pulls[0])
    chosen, doubts = _chosen(
        costs,
        misfits,
        needs_bad_gyro=_bias_about_up(fits[BAD]) > ACCELERATION.bad_bias,
        believed=float(usual.weighting.inliers.mean()),
    )
    gaps = [
        math.sqrt(doubts[k]) * heading_gap(fits[k], fits[chosen])
        for k in (*OWN, *PULLED)
        if k != chosen and doubts[k] > ACCELERATION.idle
    ]
    # Held to the bias of a usual gyro, a large one comes out small, and the rest bends up.
    if chosen in PULLED and path.bias_in_sigmas(usual.errors) > ACCELERATION.bias:
        chosen = BAD
    return Explanation(propagated(start, paths[chosen], start.prior), max(gaps, default=0.0))


def _chosen(
    costs: list[float], misfits: list[float], *, needs_bad_gyro: bool, believed: float
) -> tuple[int, list[float]]:
    """Return which explanation is taken, and how likely each is beside it.

    Parameters
    ----------
    costs, misfits : list of float
        With what is known of sensors and vehicles, and without.
    needs_bad_gyro : bool
        Whether a pull needs a large bias about up besides.
    believed : float
        Share of the samples that follow the pull.
    """
    own, pull = min(OWN, key=costs.__getitem__), PULLED[0]
    favour, shown = costs[own] - costs[pull], min(misfits[k] for k in OWN) - misfits[pull]
    bad = needs_bad_gyro and misfits[BAD] < misfits[pull] and shown < ACCELERATION.overwhelming
    is_pulled = favour > ACCELERATION.taken_off and not bad
    chosen, rival = (pull, own) if is_pulled else (own, pull)
    doubts = [min(float(expit(0.5 * (costs[chosen] - cost))), 0.5) for cost in costs]
    follow = believed > ACCELERATION.most_believed
    clear = ACCELERATION.clear if follow else ACCELERATION.overwhelming
    if favour * shown <= 0.0 or abs(shown) <= clear:
        doubts[rival] = max(doubts[rival], ACCELERATION.least_doubt)
    return chosen, doubts


def _lean(pulled: Fit) -> float:
    return float(np.linalg.norm(gyro_block(pulled).acceleration))


def _bias(fit: Fit) -> float:
    return float(np.linalg.norm(gyro_block(fit).bias))


def _bias_about_up(fit: Fit) -> float:
    block = gyro_block(fit)
    return abs(float(block.bias @ unit(block.samples.up.mean(axis=0))))


def _leaning(path: GyroPath, pulled: Fit) -> GyroPath:
    """Turn the gyro's axes to where the accelerometer does not lean by a pull."""
    block = gyro_block(pulled)
    up = unit(block.place.samples.up.mean(axis=0))
    turn = minimal_rotation(up, unit(up + block.acceleration))
    return path.turned(turn)


def _misfit(fit: Fit, factor: float) -> float:
    """Return the cost of an explanation before what is known of biases, pulls and leans."""
    block = gyro_block(fit)
    known = block.path.known
    pull = float(np.sum(block.path.found(block.errors, Effect.PULL) ** 2)) / known.acceleration**2
    bias = block.path.bias_in_sigmas(block.errors) ** 2
    far = math.log(max(block.drift / DRIFT.usual, 1.0)) / math.log(ACCELERATION.spread_of_drift)
    return propagated_evidence(fit, factor) - bias - pull + far**2


def _cost_of_bias(fit: Fit) -> float:
    """Return what a bias costs of which every size is as likely, if it is not small."""
    return 3.0 * math.log1p((_bias(fit) / ACCELERATION.usual_bias) ** 2)


def _cost_of_lean(lean: float, sigma: float) -> float:
    """Return what a lean of two axes costs whose sigma per axis is known."""
    return (lean / sigma) ** 2 + 4.0 * math.log(sigma / ACCELERATION.level_lean)


def _cost_of_own_lean(leaning: Fit, pulled: Fit) -> float:
    """Return what it costs that accelerometer and gyro differ by the lean that a pull would be."""
    return _cost_of_bias(leaning) + _cost_of_lean(_lean(pulled), ACCELERATION.own_lean)


def _cost_of_pull(fit: Fit) -> float:
    """Return what a pull costs: it follows the rate, and who is pulled is jolted, too."""
    block = gyro_block(fit)
    pull = block.path.found(block.errors, Effect.PULL)
    size, unexpected = (float(np.linalg.norm(pull[rows])) for rows in (MEAN, UNEXPECTED))
    unlike = unexpected / (ACCELERATION.unexpected * max(size, 1e-6))
    return _cost_of_lean(size, _able(block)) + unlike**2 + _cost_of_bias(fit)


def _able(block: GyroBlock) -> float:
    """Return by how much a robot that is jolted so may be pulled, over gravity: one sigma."""
    able = max(ACCELERATION.jolted * _jolts(block), ACCELERATION.least_pull)
    return min(able, block.path.known.acceleration)


def _jolts(block: GyroBlock) -> float:
    """Return what is left of up, means over `ACCELERATION.jolt` seconds: RMS per axis, radians."""
    residual = block.place.prediction.up_residual
    seconds = block.path.knots * block.path.spacing
    parts = np.array_split(residual, max(round(seconds / ACCELERATION.jolt), 1))
    means = np.array([part.mean(axis=0) for part in parts if len(part)])
    return math.sqrt(0.5 * float(np.mean(np.sum(means**2, axis=1))))


def _is_strained(plain: Fit) -> bool:
    """Return whether the gyro needs a large bias or drift, or up deviates to one side."""
    block = gyro_block(plain)
    counted = block.weighting.weights.sample
    count = max(float(counted.sum()), 1.0)
    mean = float(np.linalg.norm(counted @ block.place.prediction.up_residual)) / count
    return bool(
        block.path.bias_in_sigmas(block.errors) > ACCELERATION.bias
        or mean > ACCELERATION.deviation * _chance_of_mean(block)
        or block.drift > ACCELERATION.drift * DRIFT.usual
        or block.weighting.inefficiency > ACCELERATION.inefficiency
    )


def _chance_of_mean(block: GyroBlock) -> float:
    """Return the sigma that chance leaves to the mean of up's residuals, radians."""
    count = max(float(block.weighting.weights.sample.sum()), 1.0)
    return block.weighting.noise.up * math.sqrt(block.weighting.inefficiency / count)
