"""From all first guesses to the one optimum, and to its rival where there is one."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from magcal_ros.core.attitude import wrap_angle, yaw_from_up_and_field
from magcal_ros.core.correction import Correction
from magcal_ros.core.errors import Reason, Refusal
from magcal_ros.core.methods.maximum_likelihood.attitudes import attitudes_from_vectors
from magcal_ros.core.methods.maximum_likelihood.choice import soft_evidence
from magcal_ros.core.methods.maximum_likelihood.covariance import correction_from
from magcal_ros.core.methods.maximum_likelihood.model import Samples, State
from magcal_ros.core.methods.maximum_likelihood.prepare import thinned
from magcal_ros.core.methods.maximum_likelihood.prior import Prior
from magcal_ros.core.methods.maximum_likelihood.refine import Solution, anneal, first_steps
from magcal_ros.core.rotations import rotation_angle

SKETCH_SAMPLES = 120
"""Enough to tell good starts from bad ones."""
ANNEAL_SAMPLES = 300
KEPT = 3
RIVAL = 10.0
"""Two optima whose evidence differs by less than this, times kappa, are rivals."""
SAME = 1e-3
"""Globals closer than this came to one optimum."""


@dataclass(frozen=True, eq=False)
class Search:
    """The best optimum.

    Parameters
    ----------
    best : Solution
        On thinned samples.
    rival_gap : float
        Largest difference of heading on the level to a rival that explains the samples as well,
        radians; zero without a rival.
    """

    best: Solution
    rival_gap: float


def search(guesses: list[State], samples: Samples, prior: Prior) -> Search:
    """Follow every guess a little, the best of them to their optimum, and choose.

    Among rivals the smaller installation error wins.

    Raises
    ------
    Refusal
        If no guess led anywhere.
    """
    few = max(1, -(-len(samples) // SKETCH_SAMPLES))
    sketch = samples.take(slice(None, None, few))
    sketched = []
    for guess in guesses:
        value, state = first_steps(State(guess.shared, guess.attitude[::few]), sketch, prior)
        if np.isfinite(value):
            sketched.append((value, state))
    if not sketched:
        raise Refusal(
            Reason.NO_SOLUTION,
            "no installation and hard iron fit these samples; check the axes and repeat the turn",
        )
    sketched.sort(key=lambda pair: pair[0])
    solutions = _anneal_distinct([state for _, state in sketched], samples, prior)
    return _choose(solutions)


def _anneal_distinct(states: list[State], samples: Samples, prior: Prior) -> list[Solution]:
    enough = thinned(samples, ANNEAL_SAMPLES)
    solutions: list[Solution] = []
    tried: list[State] = []
    for state in states:
        if len(tried) == KEPT:
            break
        if any(_distance(state, other) < 0.05 for other in tried):
            continue
        tried.append(state)
        start = State(state.shared, attitudes_from_vectors(state.shared, enough))
        solution = anneal(start, enough, prior)
        if not any(_distance(solution.state, other.state) < SAME for other in solutions):
            solutions.append(solution)
    return solutions


def _distance(one: State, other: State) -> float:
    """Return the largest difference in installation and hard iron."""
    a, b = one.shared, other.shared
    turn = rotation_angle(a.installation @ b.installation.T)
    return max(turn, float(np.abs(a.hard_iron - b.hard_iron).max()))


def _choose(solutions: list[Solution]) -> Search:
    costs = [soft_evidence(solution) for solution in solutions]
    kappa = solutions[int(np.argmin(costs))].problem.kappa
    rivals = [s for s, c in zip(solutions, costs, strict=True) if c < min(costs) + RIVAL * kappa]
    rivals.sort(key=lambda solution: rotation_angle(solution.state.shared.installation))
    if not rivals:
        raise Refusal(
            Reason.NO_SOLUTION,
            "no calibration explains the samples at all; check the units and axes of both sensors",
        )
    best = rivals[0]
    gaps = [heading_gap(best, other) for other in rivals[1:]]
    return Search(best, max(gaps, default=0.0))


def heading_gap(one: Solution, other: Solution) -> float:
    """Return the largest difference of heading between two solutions over the turn, radians."""
    first, second = (_correction(solution) for solution in (one, other))
    samples = one.problem.samples
    up, field = samples.up, samples.field
    gap = yaw_from_up_and_field(up, first.apply(field)) - yaw_from_up_and_field(
        up, second.apply(field)
    )
    return float(np.median(np.abs(wrap_angle(gap))))


def _correction(solution: Solution) -> Correction:
    return correction_from(solution.state.shared, solution.problem.samples.mounting, 1.0)
