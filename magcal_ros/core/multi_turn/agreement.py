"""Whether a turn shows the same calibration as the others, by the evidence of the smoother's model.

Two explanations are weighed: one calibration for all turns, or one for the turn and another for
the rest. Both are fitted, each with its own sizes of noises. Twice the logarithm of their
likelihood ratio is the difference of the evidences.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from magcal_ros.core.smoother.fit import Fit
from magcal_ros.core.smoother.several import Together, fit_together
from magcal_ros.core.smoother.unknowns import AT

LOOKED_AT = 2.0
"""Misfit below which nobody asks whether a turn belongs to the others; it saves time only."""
LEAST = 0.03
"""Share of a turn's own variance that the others take away at least, or they tell it nothing."""
IRON = AT["iron"]


@dataclass(frozen=True)
class Agreement:
    """How turns agree."""

    misfit: float
    """How many times as far as noise explains the hard iron of one is off that of all, at worst."""
    odd: int | None = None
    """The turn that most likely has another calibration than the rest; None if none has."""


def agreement(alone: Sequence[Fit], together: Together, yaw_sigma: float) -> Agreement:
    """Compare each turn with all others; of two that disagree the later one is the odd one.

    Parameters
    ----------
    alone : sequence of Fit
        Of each turn by itself.
    together : Together
        The same turns with one calibration.
    yaw_sigma : float
        Radians of the installation's yaw before the turns.
    """
    misfit = max(_misfit(one, joint) for one, joint in zip(alone, together.fits, strict=True))
    if misfit < LOOKED_AT or len(alone) < 2:
        return Agreement(misfit)
    asked = range(len(alone)) if len(alone) > 2 else [1]
    gains = {k: _gain(alone, k, together, yaw_sigma) for k in asked}
    odd = max(gains, key=lambda k: gains[k])
    return Agreement(misfit, odd if gains[odd] > 0.0 else None)


def _gain(alone: Sequence[Fit], odd: int, together: Together, yaw_sigma: float) -> float:
    """Return twice the logarithm of how much likelier a calibration of its own makes a turn."""
    rest = fit_together([each for k, each in enumerate(alone) if k != odd], yaw_sigma)
    own = fit_together([alone[odd]], yaw_sigma)
    return together.evidence - rest.evidence - own.evidence


def _misfit(alone: Fit, joint: Fit) -> float:
    """Return the RMS difference of hard iron in its own sigmas.

    The answer of all varies with that of each, so that the variance of their difference is the
    difference of their variances (Hausman, Econometrica 46, 1978).
    """
    values, vectors = np.linalg.eigh(alone.covariance[IRON, IRON])
    whiten = vectors / np.sqrt(np.maximum(values, 1e-12))
    shares, turned = np.linalg.eigh(whiten.T @ joint.covariance[IRON, IRON] @ whiten)
    off = turned.T @ whiten.T @ (alone.state.shared - joint.state.shared)[IRON]
    return float(np.sqrt(np.mean(off**2 / np.maximum(1.0 - shares, LEAST))))
