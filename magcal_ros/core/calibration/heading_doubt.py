"""Doubt of the heading that comes from beside a method, as of another that answers otherwise."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from magcal_ros.core.calibration.estimate import Estimate


def in_doubt(estimate: Estimate, heading: float) -> Estimate:
    """Return an estimate whose heading on the level is less certain.

    An error that goes once round with the robot, whatever made it, is what a hard iron across its
    axis would make, and enters the covariance as such.

    Parameters
    ----------
    estimate : Estimate
    heading : float
        Radians RMS over all headings, one sigma, to be added to what is there.
    """
    axis = estimate.axis
    across = heading * estimate.circle_radius * (np.eye(3) - np.outer(axis, axis))
    iron = np.linalg.solve(estimate.correction.matrix, across)
    covariance = estimate.covariance.copy()
    covariance[9:, 9:] += iron @ iron.T
    return replace(estimate, covariance=covariance)
