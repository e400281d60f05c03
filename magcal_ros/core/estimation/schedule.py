"""The numbers that steer the optimisation, each with its reason (doc/estimator.md, section 8)."""

from __future__ import annotations

import math
from dataclasses import dataclass

from magcal_ros.core.estimation.weighting import Noise

FIRST_NOISE = Noise(up=0.03, field=0.03, wobble=0.1)
"""Larger than any usable sensor's: estimating the noise anew each round is the annealing."""


@dataclass(frozen=True)
class Damping:
    """Levenberg and Marquardt's damping, relative to the diagonal of the information.

    Parameters
    ----------
    least, largest : float
        Bounds; beyond the largest no step is tried.
    relaxed, raised : float
        Factors after a step that was taken and after one that was refused.
    first_raised : float
        Where raising begins: below it a damping changes no step.
    longest_step : float
        Largest change of a global (radians, field scales) in one step; about a half turn.
    """

    least: float = 1e-10
    largest: float = 1e6
    relaxed: float = 0.1
    raised: float = 10.0
    first_raised: float = 1e-7
    longest_step: float = 3.0


@dataclass(frozen=True)
class Schedule:
    """One outer loop: reweigh, step, estimate the noise, until all three agree.

    Parameters
    ----------
    rounds : int
        At most so many.
    soft_rounds : int
        Rounds with IRLS weights before a gate is closed (the trimmed refit); all of `rounds`
        where it is infinite.
    steps : int
        Levenberg-Marquardt steps a round.
    damping : float
        Of the first step.
    fewest : int
        Rounds before the loop may end.
    first_inefficiency : float
        Round from which the inefficiency factor is estimated.
    lean_rounds : tuple of float
        First round, and every how many rounds, the gradient of the marginalised leans is computed;
        between them it is held. Infinite: it is left out.
    noise_change : float
        Largest factor by which a sigma changes in one round.
    lagged : bool
        Whether the noise is estimated from the equations that the round's step was made of, which
        saves building others.
    noise_settled : float
        Relative change of a sigma, and a fifth of that of the inefficiency factor, that ends it.
    closing : float
        Round from which a sample that is out stays out: gate and optimum can chase one another in
        a circle, and this ends it.
    gate_settled : float
        Share of the samples whose weight may change in the last round.
    still : float
        Squared sigmas (samples taken as independent) by which the globals may move in it.
    """

    rounds: int
    soft_rounds: float = 0
    steps: int = 1
    damping: float = 1e-4
    fewest: int = 2
    first_inefficiency: float = 1
    lean_rounds: tuple[float, float] = (0, 1)
    noise_change: float = 2.0
    lagged: bool = True
    noise_settled: float = 0.02
    closing: float = 15
    gate_settled: float = 0.002
    still: float = 0.01


ANNEALING = Schedule(
    rounds=30,
    soft_rounds=math.inf,
    fewest=1,
    first_inefficiency=5,
    lean_rounds=(4, 3),
    noise_settled=0.01,
    still=0.05,
)
"""From a first guess to the IRLS optimum. Leans are dear to marginalise and change slowly."""

SOFTENING = Schedule(
    rounds=4,
    soft_rounds=math.inf,
    fewest=5,
    first_inefficiency=math.inf,
    lean_rounds=(math.inf, 1),
)
"""A few IRLS steps: a gate that is closed before freshly freed globals have moved shuts out the
samples that they are to explain."""

TRIMMING = Schedule(rounds=60, steps=2, damping=1e-6, noise_change=1.5, lagged=False)
"""The trimmed refit with an attitude for each sample."""

PROPAGATING = Schedule(
    rounds=80,
    soft_rounds=5,
    closing=20,
    damping=1e-6,
    fewest=8,
    first_inefficiency=5,
    noise_settled=0.015,
)
"""From any start to the trimmed refit with gyro-propagated attitudes."""


@dataclass(frozen=True)
class Limit:
    """When a sequence of steps under held weights and noise ends.

    Parameters
    ----------
    steps : int
        At most so many.
    tolerance : float
        Squared sigmas that a step promises below which it is the last.
    """

    steps: int
    tolerance: float


FINISH = Limit(30, 1e-12)
"""Where no lean is integrated out nothing keeps the last steps from being exact."""
FINISH_LEANING = Limit(30, 1e-8)
"""The gradient of the leans is exact, the curvature leaves them out: the last steps are slow."""
COMPARE = Limit(6, 1e-3)
"""Enough to compare two models that are worlds apart in chi-square."""
NEAR = Limit(6, 0.1)
"""Enough to begin from."""


@dataclass(frozen=True)
class Unnoticed:
    """What may still move where an optimisation ends.

    Parameters
    ----------
    step : float
        Squared sigmas: a last step by less than a hundredth of a sigma changes no figure.
    wobble : float
        Times the noise of up. A smaller wobble creeps towards none for as long as one waits.
    """

    step: float = 1e-4
    wobble: float = 0.5


UNNOTICED = Unnoticed()
