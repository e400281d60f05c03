"""What is known of the shared numbers before the drive."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from magcal_ros.core.geometry.arrays import FloatArray
from magcal_ros.core.knowledge import Knowledge
from magcal_ros.core.smoothing.drive_model import (
    DOWN_FIELD,
    GYRO_BIAS,
    GYRO_SCALE,
    IRON,
    LEVEL_FIELD,
    PITCH,
    ROLL,
    SHARED,
    SOFT,
)
from magcal_ros.core.smoothing.nodes import MICROTESLA
from magcal_ros.core.smoothing.tuning import TUNING, SmootherTuning

TYPICAL_STRENGTH = 50e-6
"""Tesla, where nobody knows the strength."""
HELD = 1e-6
"""Sigma of a number that is held, in its own unit."""


@dataclass(frozen=True, eq=False)
class SharedPrior:
    """A Gaussian on the shared numbers."""

    mean: FloatArray
    """Shape (14,)."""
    covariance: FloatArray
    """Shape (14, 14)."""

    @property
    def information(self) -> FloatArray:
        """Its inverse, shape (14, 14)."""
        return np.asarray(np.linalg.inv(self.covariance))

    @property
    def sigma(self) -> FloatArray:
        """Standard deviations, shape (14,)."""
        return np.asarray(np.sqrt(np.diag(self.covariance)))

    def about(self, iron: FloatArray) -> SharedPrior:
        """Return the same with another hard iron for its middle."""
        mean = self.mean.copy()
        mean[IRON] = iron
        return replace(self, mean=mean)

    def widened(self, shared: FloatArray, tuning: SmootherTuning = TUNING) -> SharedPrior:
        """Return the same with what was found far beyond its sigma as wide as that.

        Of soft iron the other numbers follow; the gyro's bias is one of its own.
        """
        sigma = self.sigma
        is_far = np.abs(shared) > tuning.far_beyond * sigma
        found = np.abs(shared[SOFT])
        if is_far[SOFT].any():
            largest = float(found[is_far[SOFT]].max())
            wider = np.where(is_far[SOFT], found, tuning.shared_soft_iron * largest)
            sigma[SOFT] = np.maximum(sigma[SOFT], np.minimum(wider, tuning.widest_soft_iron))
        if is_far[GYRO_BIAS]:
            sigma[GYRO_BIAS] = abs(float(shared[GYRO_BIAS]))
        covariance = self.covariance.copy()
        rows = [*range(SHARED)[SOFT], GYRO_BIAS]
        covariance[rows, rows] = sigma[rows] ** 2
        return replace(self, covariance=covariance)


def free_prior(knowledge: Knowledge, tuning: SmootherTuning = TUNING) -> SharedPrior:
    """Return the prior of a sensor of which little is known."""
    mean, sigma = np.zeros((2, SHARED))
    counts = math.sqrt(tuning.counts)
    sigma[IRON] = tuning.hard_iron
    sigma[[ROLL, PITCH]] = tuning.tilt / counts
    sigma[SOFT] = np.array([tuning.soft_iron] * 2 + [tuning.soft_iron_upright] * 3) / counts
    iron = knowledge.soft_iron
    if iron.sigma_diagonal == 0.0 and iron.sigma_cross == 0.0:
        sigma[SOFT] = HELD
    sigma[GYRO_BIAS], sigma[GYRO_SCALE] = tuning.gyro_bias, tuning.gyro_scale
    covariance = np.diag(sigma**2)
    earth, spread = _earth(knowledge, tuning)
    rows = np.ix_([LEVEL_FIELD, DOWN_FIELD], [LEVEL_FIELD, DOWN_FIELD])
    mean[[LEVEL_FIELD, DOWN_FIELD]] = earth
    # The sensor's own gain moves both alike.
    covariance[rows] = spread / tuning.counts + tuning.gain**2 * np.outer(earth, earth)
    return SharedPrior(mean, covariance)


def _earth(knowledge: Knowledge, tuning: SmootherTuning) -> tuple[FloatArray, FloatArray]:
    """Return level and downward field, microtesla, and their covariance."""
    strength, dip = knowledge.reference.strength, knowledge.reference.inclination
    size = MICROTESLA * (TYPICAL_STRENGTH if strength.is_unknown else strength.value)
    angle = tuning.typical_dip if dip.is_unknown else dip.value
    earth = size * np.array([math.cos(angle), math.sin(angle)])
    along, across = earth / size, np.array([-earth[1], earth[0]])
    spread = np.diag(np.square(tuning.strength))
    if strength.is_unknown:
        spread += tuning.counts * np.outer(along, along) * (tuning.unknown_strength * size) ** 2
    elif strength.sigma > 0.0:
        spread += np.outer(along, along) * (MICROTESLA * strength.sigma) ** 2
    if dip.is_unknown:
        spread += tuning.counts * np.outer(across, across) * tuning.unknown_dip**2
    elif dip.sigma > 0.0:
        spread += np.outer(across, across) * dip.sigma**2
    return earth, spread


def held_prior(
    prior: SharedPrior, *, iron: bool, tilt: float = HELD, soft_iron: float = HELD
) -> SharedPrior:
    """Return the prior for a field to which a calibration was applied already.

    Parameters
    ----------
    prior : SharedPrior
        Of field and gyro.
    iron : bool
        Whether a change of the hard iron is free.
    tilt, soft_iron : float
        Sigmas of what else may have changed: radians, relative.
    """
    mean, covariance = prior.mean.copy(), prior.covariance.copy()
    mean[: SOFT.stop] = 0.0
    sigma = np.full(SOFT.stop, soft_iron)
    sigma[IRON] = prior.sigma[IRON] if iron else HELD
    sigma[[ROLL, PITCH]] = tilt
    covariance[: SOFT.stop, : SOFT.stop] = np.diag(sigma**2)
    return SharedPrior(mean, covariance)
