"""Whether one turn shows the same calibration as the others (doc/estimator.md, section 11).

At the joint optimum let F be the information of one turn, G that of everything else, and g the
turn's gradient there. Were both fitted alone, their costs would fall by `g F^-1 g` and `g G^-1 g`:
the sum is the chi-square of their difference. In axes in which F + G is one and F diagonal (its
values l), it is the sum of `g_i² / (l_i (1 - l_i))`, so directions of which only one side knows
anything say nothing and are left out.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.special import chdtrc

from magcal_ros.core.estimation import parameters as p
from magcal_ros.core.estimation.solver import Fit

HARD_IRON_INDICES = np.arange(p.HARD_IRON.start, p.HARD_IRON.stop)


@dataclass(frozen=True)
class AgreementTuning:
    """When turns are taken to agree.

    Attributes
    ----------
    least_share : float
        Of a direction's information that both sides must have.
    certain : float
        Probability of a chance disagreement below which it is none.
    suspicious : float
        Probability of a chance disagreement below which a turn is left out, and below which the
        covariance grows by what the turns differ.
    place_to_place : float
        Field scales (0.15 µT of 50) by which hard iron may seem to differ between sound turns: no
        two places have quite the same field. It widens what is tolerated, not the covariance.
    """

    least_share: float = 0.03
    certain: float = 1e-6
    suspicious: float = 1e-3
    place_to_place: float = 0.003


TUNING = AgreementTuning()


@dataclass(frozen=True)
class Agreement:
    """How one turn agrees with the others.

    Parameters
    ----------
    chi_square : float
        Of their difference against noise alone.
    tolerant : float
        The same against noise and what places may differ.
    freedom : int
        Directions in which both sides know something.
    """

    chi_square: float
    tolerant: float
    freedom: int

    @property
    def chance(self) -> float:
        """Probability that noise alone makes sound turns disagree so much."""
        return float(chdtrc(self.freedom, self.chi_square)) if self.freedom else 1.0

    @property
    def is_broken(self) -> bool:
        """Whether turn and others cannot belong together."""
        return self.freedom > 0 and float(chdtrc(self.freedom, self.tolerant)) < TUNING.certain

    @property
    def misfit(self) -> float:
        """How many times as far as noise explains the turn is off the others."""
        return math.sqrt(self.chi_square / max(self.freedom, 1))

    @property
    def widening(self) -> float:
        """By how much the covariance must grow to cover the disagreement, one or more."""
        return 1.0 if self.chance > TUNING.suspicious else max(1.0, self.misfit**2)


def agreements(joint: Fit) -> list[Agreement]:
    """Compare each turn with all others."""
    return [_agreement(joint, index) for index in range(len(joint.blocks))]


def _agreement(joint: Fit, index: int) -> Agreement:
    mine = joint.turn_information[index]
    gradient = joint.equations.own_gradient(index)
    size = 1.0 / np.sqrt(np.maximum(np.diag(joint.information), 1e-12))
    values, vectors = np.linalg.eigh(joint.information * np.outer(size, size))
    roots = np.sqrt(np.maximum(values, 1e-13))
    whiten = size[:, None] * (vectors / roots)
    shares, turned = np.linalg.eigh(whiten.T @ mine @ whiten)
    both = (shares > TUNING.least_share) & (shares < 1.0 - TUNING.least_share)
    slope = ((whiten @ turned).T @ gradient)[both]
    weight = shares[both] * (1.0 - shares[both])
    # The rows that take a step of the shared numbers to these axes; of hard iron only.
    back = (turned.T @ (vectors * roots).T / size)[both]
    iron = TUNING.place_to_place * back[:, np.isin(joint.free, HARD_IRON_INDICES)]
    difference = slope / weight
    allowed = np.diag(1.0 / weight) + iron @ iron.T
    return Agreement(
        float(np.sum(slope**2 / weight)),
        float(difference @ np.linalg.solve(allowed, difference)),
        int(both.sum()),
    )
