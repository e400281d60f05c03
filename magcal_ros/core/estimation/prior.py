"""What is known before the turn, as a Gaussian over the globals (doc/estimator.md, section 3)."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from magcal_ros.core.estimation import parameters as p
from magcal_ros.core.estimation.parameters import Globals
from magcal_ros.core.geometry.arrays import FloatArray, IntArray
from magcal_ros.core.knowledge import Belief, Knowledge

SOFT_IRON_INDICES = np.arange(p.SOFT_IRON.start, p.SOFT_IRON.stop)


@dataclass(frozen=True)
class WidestPrior:
    """Sigmas at which a prior still holds what runs away.

    Parameters
    ----------
    soft_iron : float
        Beyond it no number of soft iron is believed, whatever the samples say.
    hard_iron : float
        Field scales, where neither strength nor dip is known: one turn about an upright axis then
        shows only their sum, and something has to hold it.
    """

    soft_iron: float = 0.25
    hard_iron: float = 1.0


WIDEST = WidestPrior()


@dataclass(frozen=True, eq=False)
class Prior:
    """A Gaussian over the globals, and which of them the fit may move.

    The turn's two axes are no part of it: a block that needs them moves them by itself.

    Parameters
    ----------
    free : ndarray of int
        Indices of the shared parameters that are estimated.
    information : ndarray, shape (18,)
        Inverse variances; zero where nothing is known.
    strength, inclination : float
        Their expectations (field scales, radians).
    """

    free: IntArray
    information: FloatArray
    strength: float
    inclination: float

    def deviation(self, shared: Globals) -> FloatArray:
        """Return expectation minus value of each parameter, shape (18,)."""
        out = np.zeros(p.COUNT)
        out[p.HARD_IRON] = -shared.hard_iron
        out[p.STRENGTH] = self.strength - shared.strength
        out[p.INCLINATION] = self.inclination - shared.inclination
        out[p.SOFT_IRON] = -shared.soft_iron
        out[p.YAW] = -shared.yaw
        return out

    def cost(self, shared: Globals) -> float:
        """Return chi-square of the deviations."""
        return float(self.information @ self.deviation(shared) ** 2)

    def as_wide_as(self, shared: Globals, beyond: float) -> Prior:
        """Return the prior with a sigma of its own size for soft iron `beyond` sigmas of it."""
        free = np.intersect1d(SOFT_IRON_INDICES, self.free)
        size = np.abs(self.deviation(shared)[free])
        information = self.information.copy()
        far = size * np.sqrt(information[free]) > beyond
        information[free[far]] = np.minimum(size[far], WIDEST.soft_iron) ** -2
        return replace(self, information=information)

    @property
    def has_soft_iron(self) -> bool:
        """Whether the fit may find soft iron."""
        return bool(np.isin(SOFT_IRON_INDICES, self.free).any())

    @property
    def holds_hard_iron(self) -> bool:
        """Whether nothing is known of the field, and a wide prior keeps the hard iron near."""
        return bool(self.information[p.HARD_IRON].any())


def prior_from(knowledge: Knowledge, scale: float, *, soft_iron: bool, yaw: bool = False) -> Prior:
    """Translate knowledge into a prior.

    Parameters
    ----------
    knowledge : Knowledge
        Beliefs in SI units.
    scale : float
        Tesla of one field scale.
    soft_iron : bool
        Whether E is estimated.
    yaw : bool
        Whether the installation's yaw is estimated: only several turns show it.
    """
    information = np.zeros(p.COUNT)
    fixed = np.arange(p.COUNT) < p.ROLL
    reference = knowledge.reference
    for index, belief, unit in (
        (p.STRENGTH, reference.strength, scale),
        (p.INCLINATION, reference.inclination, 1.0),
    ):
        fixed[index] = belief.is_exact
        if not (belief.is_exact or belief.is_unknown):
            information[index] = (unit / belief.sigma) ** 2
    if reference.strength.is_unknown and reference.inclination.is_unknown:
        information[p.HARD_IRON] = WIDEST.hard_iron**-2
    iron = knowledge.soft_iron
    sigmas = np.array([iron.sigma_diagonal] * 3 + [iron.sigma_cross] * 3)
    movable = (sigmas > 0.0) & soft_iron
    fixed[p.SOFT_IRON] = ~movable
    information[p.SOFT_IRON] = np.where(movable, np.where(sigmas > 0.0, sigmas, 1.0) ** -2, 0.0)
    fixed[p.YAW] = not yaw
    information[p.YAW] = knowledge.mounting.yaw_sigma**-2 if yaw else 0.0
    return Prior(
        np.flatnonzero(~fixed),
        information,
        _expectation(reference.strength) / scale,
        _expectation(reference.inclination),
    )


def _expectation(belief: Belief) -> float:
    return 0.0 if belief.is_unknown else belief.value
