"""Whether what a calibration file claims can be true of any magnetometer on Earth."""

from __future__ import annotations

import math

import numpy as np

from magcal_ros.core.calibration.calibration import Calibration
from magcal_ros.core.geometry.arrays import FloatArray

LARGEST_GAIN = 1e4
"""Of the matrix's entries; also radians of the noise: far within the floats' squares."""

LARGEST_IRON = 0.1
"""Tesla: a magnet touching the sensor has less, and no compass chip measures so much."""

LARGEST_VARIANCE = 1e8
"""Of the matrix and in tesla squared: far beyond every doubt, far within the floats."""

LARGEST_CONDITION = 1e4
"""Of the matrix: known gains from 0.1 to 10 make a hundred, and soft iron some more."""

WEAKEST_FIELD, STRONGEST_FIELD = 5e-6, 300e-6
"""Tesla. The Earth's field has 22 to 67 µT, and steel around multiplies it a few times."""

ASYMMETRY = 1e-6
"""Relative to the two sigmas, as from a copy with few digits."""

NEGATIVE = 1e-6
"""Smallest eigenvalue of the correlations that rounding alone can make negative."""

MOST_SAMPLES = 1e8
"""More than a day of the fastest sensor: nothing averages the noise further than this."""


def require_possible(calibration: Calibration) -> None:
    """Refuse what no turn can have found.

    Parameters
    ----------
    calibration : Calibration
        As read from a file that may have been edited or damaged.

    Raises
    ------
    ValueError
        With what is impossible, in words that name the entry.
    """
    _require_sizes(calibration)
    condition = float(np.linalg.cond(calibration.correction.matrix))
    if not condition <= LARGEST_CONDITION:
        raise ValueError(
            f"correction_matrix is all but singular (condition {condition:.0e}): it loses a "
            "direction of the field"
        )
    if not WEAKEST_FIELD <= calibration.strength <= STRONGEST_FIELD:
        raise ValueError(
            f"the reference strength is {calibration.strength * 1e6:.3g} µT, and the Earth's "
            "field has 22 to 67 µT"
        )
    if abs(calibration.inclination) > math.pi / 2.0:
        raise ValueError("the reference inclination is more than a right angle")
    _require_covariance(calibration.covariance)
    _require_doubt(calibration)


def _require_sizes(calibration: Calibration) -> None:
    correction = calibration.correction
    for name, numbers, limit in (
        ("correction_matrix", correction.matrix, LARGEST_GAIN),
        ("hard_iron", correction.hard_iron, LARGEST_IRON),
        ("covariance", calibration.covariance, LARGEST_VARIANCE),
        ("noise_field", calibration.noise_field, LARGEST_IRON),
        ("noise_up", calibration.noise_up, LARGEST_GAIN),
    ):
        largest = float(np.abs(numbers).max())
        if largest > limit:
            raise ValueError(f"{name} reads up to {largest:.0e}, which no magnetometer needs")


def _require_covariance(covariance: FloatArray) -> None:
    """Look at correlations: the twelve numbers have units far apart."""
    sigmas = np.sqrt(np.diag(covariance))
    scale = np.where(sigmas > 0.0, sigmas, 1.0)
    correlations = covariance / np.outer(scale, scale)
    if (np.abs(covariance[sigmas == 0.0]) > 0.0).any():
        raise ValueError("covariance ties a number to others that it calls exact")
    if np.abs(correlations - correlations.T).max() > ASYMMETRY:
        raise ValueError("covariance is not symmetric")
    smallest = float(np.linalg.eigvalsh((correlations + correlations.T) / 2.0)[0])
    if smallest < -NEGATIVE:
        raise ValueError(
            "covariance is not that of any numbers: some direction would have a negative variance"
        )


def _require_doubt(calibration: Calibration) -> None:
    sigma = math.sqrt(float(np.trace(calibration.covariance[9:, 9:])))
    least = calibration.noise_field / math.sqrt(MOST_SAMPLES)
    if sigma < least:
        raise ValueError(
            f"covariance claims a hard iron known to {sigma:.1e} T; with a noise of "
            f"{calibration.noise_field:.1e} T a sample, no turn shows it better than {least:.1e} T"
        )
