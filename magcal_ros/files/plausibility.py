"""Whether the numbers of a calibration file are possible for a magnetometer on Earth."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from magcal_ros.core.calibration.calibration import Calibration
from magcal_ros.core.calibration.figure import Figure
from magcal_ros.core.geometry.arrays import FloatArray
from magcal_ros.core.samples.samples_tuning import STREAMS


@dataclass(frozen=True)
class Bounds:
    """Bounds of the numbers of a calibration."""

    smallest_gain: float = 0.05
    largest_gain: float = 20.0
    """Gains of the matrix: 0.1 to 10 by the sensor, and a factor of two by soft iron."""
    largest_variance: float = 1e8
    """Variance of the matrix, and of the hard iron in tesla²: above any real uncertainty."""
    weakest_field: float = 2e-6
    strongest_field: float = 300e-6
    """Tesla. All that a verdict accepts (`VerdictTuning.beyond_iron_ut`): the Earth's field has 22
    to 67 µT, and a body of steel leaves a part of it."""
    asymmetry: float = 1e-6  # difference of two correlations that rounded digits can cause
    negative: float = 1e-6
    """Magnitude of a negative eigenvalue of the correlations that rounding can cause."""
    most_samples: float = 1e8
    """Largest number of samples over which noise is averaged: over a day of the fastest sensor."""


BOUNDS = Bounds()

LARGEST_FIGURES = {
    Figure.LATENCY: 10.0,
    Figure.GYRO_SCALE: 0.5,
    Figure.LOCAL_FIELD: STREAMS.largest_field,
}
"""Limits of the figures that the heading depends on: seconds, a ratio, and tesla."""


def require_possible(calibration: Calibration) -> None:
    """Raise a ValueError that names the entry if no calibration can have these numbers."""
    gains = np.linalg.svd(calibration.correction.matrix, compute_uv=False)
    least, most = float(gains.min()), float(gains.max())
    if not BOUNDS.smallest_gain <= least <= most <= BOUNDS.largest_gain:
        raise ValueError(
            f"correction_matrix multiplies the field by {least:.3g} to {most:.3g}, but sensors "
            f"need {BOUNDS.smallest_gain:g} to {BOUNDS.largest_gain:g}"
        )
    if not BOUNDS.weakest_field <= calibration.strength <= BOUNDS.strongest_field:
        raise ValueError(
            f"the reference strength is {calibration.strength * 1e6:.3g} µT, but the Earth's field "
            "has 22 to 67 µT"
        )
    _require_sizes(calibration, least)
    if abs(calibration.inclination) > math.pi / 2.0:
        raise ValueError("the reference inclination is more than a right angle")
    _require_covariance(calibration.covariance)
    sigma = math.sqrt(float(np.trace(calibration.covariance[9:, 9:])))
    finest = calibration.noise_field / math.sqrt(BOUNDS.most_samples)
    if sigma < finest:
        raise ValueError(
            f"covariance claims a hard iron known to {sigma:.1e} T; with a noise of "
            f"{calibration.noise_field:.1e} T a sample, no turn shows it better than {finest:.1e} T"
        )
    motors = calibration.motors
    if motors is not None:
        sizes = [motors.size(k) for k in range(len(motors.inputs))]
        if not max([*sizes, motors.ripple]) <= STREAMS.largest_field:
            raise ValueError("motors adds a field that no magnetometer can measure")
        _require_covariance(motors.joint(calibration.covariance))


def _require_sizes(calibration: Calibration, least_gain: float) -> None:
    # With a larger hard iron, the node would have dropped every sample as too large.
    largest_iron = STREAMS.largest_field + calibration.strength / least_gain
    iron, figure = calibration.correction.hard_iron, calibration.evidence.figure
    for name, size, limit in (
        ("hard_iron", np.abs(iron).max(), largest_iron),
        ("covariance", np.abs(calibration.covariance).max(), BOUNDS.largest_variance),
        ("noise_field", calibration.noise_field, STREAMS.largest_field),
        ("noise_up", calibration.noise_up, math.pi),
        *((name.value, abs(figure(name, 0.0)), most) for name, most in LARGEST_FIGURES.items()),
    ):
        if not size <= limit:
            raise ValueError(f"{name} reads up to {size:.0e}, which no magnetometer needs")


def _require_covariance(covariance: FloatArray) -> None:
    """Check the covariance by its correlations, because the variables have different units."""
    sigmas = np.sqrt(np.diag(covariance))
    scale = np.where(sigmas > 0.0, sigmas, 1.0)
    correlations = covariance / np.outer(scale, scale)
    if (np.abs(covariance[sigmas == 0.0]) > 0.0).any():
        raise ValueError("covariance has correlations of a number whose variance is zero")
    if np.abs(correlations - correlations.T).max() > BOUNDS.asymmetry:
        raise ValueError("covariance is not symmetric")
    smallest = float(np.linalg.eigvalsh((correlations + correlations.T) / 2.0)[0])
    if smallest < -BOUNDS.negative:
        raise ValueError("covariance is not possible: it has a negative eigenvalue")
