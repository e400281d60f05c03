"""From all first guesses to the one optimum, and to its rival where there is one."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from magcal_ros.core.errors import Reason, Refusal
from magcal_ros.core.estimation.averaging import thinned
from magcal_ros.core.estimation.evidence import soft_evidence
from magcal_ros.core.estimation.free_attitude import FreeBlock
from magcal_ros.core.estimation.heading_gap import heading_gap
from magcal_ros.core.estimation.model import Evaluation, Samples, State
from magcal_ros.core.estimation.parameters import Globals
from magcal_ros.core.estimation.prior import Prior
from magcal_ros.core.estimation.schedule import ANNEALING, FIRST_NOISE
from magcal_ros.core.estimation.solver import Fit, refined, sketched
from magcal_ros.core.estimation.weighting import Weighting, Weights, chi_squares
from magcal_ros.core.estimation.weights import student_cost
from magcal_ros.core.geometry.rotations import rotation_angle


@dataclass(frozen=True)
class MultiStart:
    """How first guesses are followed.

    Parameters
    ----------
    sketch_samples : int
        Enough to tell good guesses from bad ones.
    samples : int
        Enough to find the optimum of each good one.
    kept : int
        Good guesses that are followed.
    apart : float
        Guesses closer than this (radians, field scales) lead to one optimum.
    same : float
        Optima closer than this are one.
    rival : float
        Two optima whose evidence differs by less than this per independent sample are rivals.
    """

    sketch_samples: int = 120
    samples: int = 300
    kept: int = 3
    apart: float = 0.05
    same: float = 1e-3
    rival: float = 10.0


MULTI_START = MultiStart()


@dataclass(frozen=True, eq=False)
class Found:
    """The best optimum.

    Parameters
    ----------
    best : Fit
        On thinned samples.
    rival_gap : float
        Largest difference of heading on the level to a rival that explains the samples as well,
        radians; zero without a rival.
    """

    best: Fit
    rival_gap: float


def search(guesses: list[State], samples: Samples, prior: Prior) -> Found:
    """Follow every guess a little, the best of them to their optimum, and choose.

    Among rivals the smaller installation error wins.

    Raises
    ------
    Refusal
        If no guess led anywhere.
    """
    few = max(1, -(-len(samples) // MULTI_START.sketch_samples))
    sketch = samples.take(slice(None, None, few))
    weighting = Weighting(FIRST_NOISE, Weights.ones(len(sketch)))
    followed = []
    for guess in guesses:
        block = FreeBlock(Evaluation(State(guess.shared, guess.attitude[::few]), sketch), weighting)
        fit = sketched(Fit((block,), prior))
        chi = chi_squares(fit.block.place, weighting.noise)
        value = student_cost(chi, leans=True) + prior.cost(fit.shared)
        if np.isfinite(value):
            followed.append((value, fit.shared))
    if not followed:
        raise Refusal(
            Reason.NO_SOLUTION,
            "no installation and hard iron fit these samples; check the axes and repeat the turn",
        )
    followed.sort(key=lambda pair: pair[0])
    fits = _distinct_optima([shared for _, shared in followed], samples, prior)
    return _choose(fits)


def _distinct_optima(guesses: list[Globals], samples: Samples, prior: Prior) -> list[Fit]:
    enough = thinned(samples, MULTI_START.samples)
    weighting = Weighting(FIRST_NOISE, Weights.ones(len(enough)))
    fits: list[Fit] = []
    tried: list[Globals] = []
    for guess in guesses:
        if len(tried) == MULTI_START.kept:
            break
        if any(_distance(guess, other) < MULTI_START.apart for other in tried):
            continue
        tried.append(guess)
        fit = refined(Fit((FreeBlock.seated_at(guess, enough, weighting),), prior), ANNEALING)
        if not any(_distance(fit.shared, other.shared) < MULTI_START.same for other in fits):
            fits.append(fit)
    return fits


def _distance(one: Globals, other: Globals) -> float:
    """Return the largest difference in installation and hard iron."""
    turn = rotation_angle(one.installation @ other.installation.T)
    return max(turn, float(np.abs(one.hard_iron - other.hard_iron).max()))


def _choose(fits: list[Fit]) -> Found:
    costs = [_soft_evidence(fit) for fit in fits]
    factor = fits[int(np.argmin(costs))].block.weighting.inefficiency
    limit = min(costs) + MULTI_START.rival * factor
    rivals = [fit for fit, cost in zip(fits, costs, strict=True) if cost < limit]
    rivals.sort(key=lambda fit: rotation_angle(fit.shared.installation))
    if not rivals:
        raise Refusal(
            Reason.NO_SOLUTION,
            "no calibration explains the samples at all; check the units and axes of both sensors",
        )
    best = rivals[0]
    gaps = [heading_gap(best, other) for other in rivals[1:]]
    return Found(best, max(gaps, default=0.0))


def _soft_evidence(fit: Fit) -> float:
    block = fit.block
    assert isinstance(block, FreeBlock)
    return soft_evidence(block, fit.prior)
