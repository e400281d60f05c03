"""Estimates and calibrations for tests that need any."""

import math

import numpy as np

from magcal_ros.core import Calibration, Correction, Estimate, Installation
from magcal_ros.core.calibration import Evidence
from magcal_ros.core.geometry import rotation_from_rpy

EVIDENCE = Evidence("design_tip", "good", "excellent", "Calibrated.")
SKEWED = Correction(
    rotation_from_rpy(0.1, -0.2, 0.3) @ np.diag([0.8, 1.1, 1.3]), np.array([30e-6, -20e-6, 25e-6])
)


def estimate(**changes):
    """An estimate that is excellent in every respect, but for the changes."""
    n = 500
    covariance = np.zeros((12, 12))
    covariance[9:, 9:] = np.eye(3) * 0.05e-6**2
    values = {
        "method": "design_tip",
        "correction": Correction(np.eye(3), np.array([30e-6, -20e-6, 25e-6])),
        "covariance": covariance,
        "installation": Installation(math.radians(3.0), math.radians(-4.0)),
        "axis": np.array([0.0, 0.0, 1.0]),
        "arc": math.tau,
        "strength": 50e-6,
        "inclination": math.radians(60.0),
        "noise_field": 0.3e-6,
        "noise_up": 0.01,
        "inliers": np.ones(n, dtype=bool),
        "residual": np.full((n, 3), 0.3e-6),
        "figures": {},
        "message": "solved",
    }
    return Estimate(**(values | changes))


def calibration(correction=SKEWED, covariance=None, noise_field=0.3e-6, noise_up=0.01):
    if covariance is None:
        covariance = small_covariance()
    return Calibration(
        correction, covariance, noise_field, noise_up, 50e-6, math.radians(60.0), EVIDENCE
    )


def small_covariance(seed=7, of_matrix=2e-3, of_iron=0.1e-6):
    """A full 12 x 12 covariance in which everything depends on everything."""
    scale = np.append(np.full(9, of_matrix), np.full(3, of_iron))
    mix = np.random.default_rng(seed).standard_normal((12, 12)) / math.sqrt(12.0)
    return (mix @ mix.T) * np.outer(scale, scale)
