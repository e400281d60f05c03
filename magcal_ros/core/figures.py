"""Figures that every method's estimate has, whatever the method measured besides."""

from __future__ import annotations

import math

import numpy as np

from magcal_ros.core.arrays import FloatArray
from magcal_ros.core.attitude import field_in_enu, unit
from magcal_ros.core.correction import Correction
from magcal_ros.core.estimate import Estimate, yaw_jacobian
from magcal_ros.core.rotations import rotation_from_rpy
from magcal_ros.core.window import Window

CHECKED_TILT = math.radians(10.0)
HEADINGS = 24
UP: FloatArray = np.array([0.0, 0.0, 1.0])


def common_figures(estimate: Estimate) -> dict[str, float]:
    """Measure an estimate.

    Returns
    -------
    dict of str to float
        heading_sigma, heading_sigma_tilted : rad, predicted from the covariance, root mean square
        over all headings on the level and on slopes of 10°;
        residual_ratio : rms residual of the believed samples over the level field;
        outlier_share : share of the samples that was not believed;
        installation_angle : rad, where the method knows one;
        radius_misfit : relative, where the method compared radii;
        ellipse_excess : longer axis of the turn's ellipse over the shorter less one, where the
        method measured it and did not take it as soft iron.
    """
    residual = estimate.residual[estimate.inliers]
    rms = math.sqrt(float(np.mean(residual**2))) if len(residual) else math.inf
    figures = {
        "heading_sigma": predicted_heading_sigma(estimate, 0.0),
        "heading_sigma_tilted": predicted_heading_sigma(estimate, CHECKED_TILT),
        "residual_ratio": rms / max(estimate.circle_radius, 1e-12),
        "outlier_share": 1.0 - float(np.mean(estimate.inliers)),
    }
    if estimate.installation is not None:
        figures["installation_angle"] = estimate.installation.angle
    if "radius_ratio" in estimate.figures:
        figures["radius_misfit"] = abs(estimate.figures["radius_ratio"] - 1.0)
    if "ellipse_ratio" in estimate.figures and not estimate.figures.get("soft_iron"):
        figures["ellipse_excess"] = estimate.figures["ellipse_ratio"] - 1.0
    return figures


def predicted_heading_sigma(estimate: Estimate, tilt: float) -> float:
    """Return the yaw's standard deviation from the covariance of the twelve numbers.

    Parameters
    ----------
    estimate : Estimate
        What was found.
    tilt : float
        Radians. Zero for the level; otherwise over slopes to all four sides.

    Returns
    -------
    float
        Radians, root mean square over 24 headings.
    """
    reference = field_in_enu(estimate.strength, estimate.inclination)
    jacobian = heading_jacobian(estimate.correction, reference, tilt)
    return rms_sigma(jacobian, estimate.covariance)


def heading_jacobian(correction: Correction, field_enu: FloatArray, tilt: float) -> FloatArray:
    """Return the derivative of the yaw by the twelve numbers over all headings, radians each.

    Parameters
    ----------
    correction : Correction
        The twelve numbers.
    field_enu : ndarray, shape (3,)
        The Earth's field, tesla.
    tilt : float
        Radians. Zero for the level; otherwise over slopes to all four sides.

    Returns
    -------
    ndarray, shape (24, 12), or (96, 12) on slopes
    """
    leanings = [(0.0, 0.0)] if tilt == 0.0 else [(tilt, 0), (-tilt, 0), (0, tilt), (0, -tilt)]
    yaws = np.arange(HEADINGS) * (math.tau / HEADINGS)
    poses = np.array([rotation_from_rpy(r, p, y).T for r, p in leanings for y in yaws])
    return yaw_jacobian(correction, poses @ UP, poses @ field_enu)


def rms_sigma(jacobian: FloatArray, covariance: FloatArray) -> float:
    """Return the root mean square over rows of what a covariance means for them."""
    variance = np.einsum("ki,ij,kj->k", jacobian, covariance, jacobian)
    return math.sqrt(max(float(variance.mean()), 0.0))


def sideways_pull(window: Window) -> float:
    """Return the angle between the gyro's mean axis and the mean specific force, radians.

    Over a full turn about any axis the true up averages to that axis. What is left is a steady
    pull to one side, as of a car in a circle. The mean goes over the angle, so a pause does not
    weigh.
    """
    rate = window.angular_rate
    if rate is None:
        return 0.0
    axis = unit(rate.mean(axis=0))
    mean = unit((rate @ axis) @ unit(window.specific_force))
    return math.acos(min(abs(float(axis @ mean)), 1.0))
