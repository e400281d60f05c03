"""Predicted sigma of the heading, and other figures that every estimate has."""

from __future__ import annotations

import math

import numpy as np

from magcal_ros.core.calibration.calibration import Calibration, Estimate, yaw_jacobian
from magcal_ros.core.calibration.correction import PARAMETERS, Correction
from magcal_ros.core.calibration.figure import Figure
from magcal_ros.core.geometry.arrays import FloatArray
from magcal_ros.core.geometry.attitude import (
    field_in_enu,
    mean_angle,
    unit,
    wrap_angle,
    yaw_from_up_and_field,
)
from magcal_ros.core.geometry.rotations import in_axes, rotation_from_rpy
from magcal_ros.core.knowledge import Mounting, level_rotation
from magcal_ros.core.samples.window import Window

CHECKED_TILT = math.radians(10.0)
HEADINGS = 24


def every_figure(estimate: Estimate) -> dict[Figure, float]:
    """Return an estimate's figures with the derived ones and those that all estimates have."""
    residual = estimate.residual[estimate.inliers]
    rms = math.sqrt(float(np.mean(residual**2))) if len(residual) else math.inf
    figures = {
        Figure.HEADING_SIGMA: predicted_heading_sigma(estimate, 0.0),
        Figure.HEADING_SIGMA_TILTED: predicted_heading_sigma(estimate, CHECKED_TILT),
        Figure.RESIDUAL_RATIO: rms / max(estimate.circle_radius, 1e-12),
        Figure.OUTLIER_SHARE: 1.0 - float(np.mean(estimate.inliers)),
    }
    if Figure.LOCAL_FIELD in estimate.figures:
        figures[Figure.LOCAL_SIGMA] = local_sigma(estimate)
    if estimate.installation is not None:
        figures[Figure.INSTALLATION_ANGLE] = estimate.installation.angle
    if Figure.RADIUS_RATIO in estimate.figures:
        figures[Figure.RADIUS_MISFIT] = abs(estimate.figures[Figure.RADIUS_RATIO] - 1.0)
    if Figure.ELLIPSE_RATIO in estimate.figures and not estimate.figures.get(Figure.SOFT_IRON):
        figures[Figure.ELLIPSE_EXCESS] = estimate.figures[Figure.ELLIPSE_RATIO] - 1.0
    return figures | dict(estimate.figures)


def predicted_heading_sigma(estimate: Estimate | Calibration, tilt: float = 0.0) -> float:
    """Return the yaw's sigma by the calibration and by local disturbances, radians.

    It is the root mean square over 24 headings, on the level or on slopes of `tilt` (rad) to four
    sides.
    """
    return math.hypot(calibration_sigma(estimate, tilt), local_sigma(estimate, tilt))


def calibration_sigma(estimate: Estimate | Calibration, tilt: float = 0.0) -> float:
    """Return the yaw's sigma by the covariance of the twelve numbers alone, radians."""
    return rms_sigma(*_in_level_axes(estimate, tilt))


def _in_level_axes(
    estimate: Estimate | Calibration, tilt: float = 0.0
) -> tuple[FloatArray, FloatArray]:
    """Return the derivative of the yaw by the twelve numbers in level axes, and their covariance.

    Shapes are (n, 12) over all headings, on the level or on slopes of `tilt` (rad), and (12, 12).
    """
    level = in_axes(estimate, level_rotation(estimate.upward))
    reference = field_in_enu(level.strength, level.inclination)
    return heading_jacobian(level.correction, reference, tilt), level.covariance


def known_sigma(calibration: Calibration) -> float:
    """Return the sigma of the heading on the level by a calibration's evidence, radians."""
    sigma = calibration.evidence.figures.get(Figure.HEADING_SIGMA.value)
    if sigma is None:
        return calibration_sigma(calibration)
    return math.sqrt(max(sigma**2 - calibration.evidence.figure(Figure.LOCAL_SIGMA, 0.0) ** 2, 0.0))


def local_sigma(estimate: Estimate | Calibration, tilt: float = 0.0) -> float:
    """Return the yaw's sigma by local magnetic disturbances along the drive, radians."""
    if isinstance(estimate, Calibration):
        size = estimate.evidence.figure(Figure.LOCAL_FIELD, 0.0)
    else:
        size = estimate.figures.get(Figure.LOCAL_FIELD, 0.0)
    if size == 0.0:
        return 0.0
    by_field = _in_level_axes(estimate, tilt)[0][:, PARAMETERS - 3 :]
    return size * math.sqrt(float(np.mean(np.sum(by_field**2, axis=1))))


def arc_sigma(estimate: Estimate) -> float:
    """Return the sigma of the arc by the compass, on the level, radians.

    It is the largest over all starts: a partial turn determines the circle's centre least along the
    middle of the arc, and an error in this direction changes the arc.
    """
    jacobian, covariance = _in_level_axes(estimate)
    apart = np.roll(jacobian, -round(estimate.arc / math.tau * HEADINGS), axis=0) - jacobian
    variance = np.einsum("ki,ij,kj->k", apart, covariance, apart)
    return math.sqrt(max(float(variance.max()), 0.0))


def heading_jacobian(correction: Correction, field_enu: FloatArray, tilt: float) -> FloatArray:
    """Return the derivative of the yaw by the twelve numbers over all headings, radians each.

    The field (3,) is the Earth's in ENU, tesla. With a `tilt` (rad) it is over slopes to four
    sides.
    """
    leanings = [(0.0, 0.0)] if tilt == 0.0 else [(tilt, 0), (-tilt, 0), (0, tilt), (0, -tilt)]
    poses = np.concatenate([_all_headings(roll, pitch) for roll, pitch in leanings])
    return yaw_jacobian(correction, poses[:, :, 2], poses @ field_enu)


def heading_differences(
    right: Correction, other: Correction, strength: float, inclination: float
) -> FloatArray:
    """Return the yaw by another correction minus that by the right one, (24,) level headings."""
    up, field, seen = fields_on_level(right, other, strength, inclination)
    return wrap_angle(yaw_from_up_and_field(up, seen) - yaw_from_up_and_field(up, field))


def fields_on_level(
    right: Correction, other: Correction, strength: float, inclination: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return up, and the fields by the right and by another correction, at level headings.

    Each has the shape (24, 3), in body axes.
    """
    poses = _all_headings()
    field = poses @ field_in_enu(strength, inclination)
    return poses[:, :, 2], field, other.apply(right.undo(field))


def rms_heading_difference(
    right: Correction, other: Correction, strength: float, inclination: float
) -> float:
    """Return the RMS of `heading_differences`, radians."""
    gap = heading_differences(right, other, strength, inclination)
    return math.sqrt(float(np.mean(gap**2)))


def heading_swing(
    right: Correction, other: Correction, strength: float, inclination: float
) -> float:
    """Return the RMS of `heading_differences` without their constant part, radians.

    Without a known heading, samples do not show the constant part.
    """
    gap = heading_differences(right, other, strength, inclination)
    return math.sqrt(float(np.mean(wrap_angle(gap - mean_angle(gap)) ** 2)))


def _all_headings(roll: float = 0.0, pitch: float = 0.0) -> FloatArray:
    """Return attitudes ENU to body at all headings, shape (24, 3, 3)."""
    yaws = np.arange(HEADINGS) * (math.tau / HEADINGS)
    return np.array([rotation_from_rpy(roll, pitch, yaw).T for yaw in yaws])


def rms_sigma(jacobian: FloatArray, covariance: FloatArray) -> float:
    """Return the root mean square over the rows of a Jacobian of the sigma by a covariance."""
    variance = np.einsum("ki,ij,kj->k", jacobian, covariance, jacobian)
    return math.sqrt(max(float(variance.mean()), 0.0))


def sideways_acceleration(window: Window) -> float:
    """Return the angle between the gyro's mean axis and the mean specific force, radians.

    Over a full turn about any axis, the mean of the true up is this axis. A difference is a
    constant lateral acceleration, as of a car in a circle. The mean is over the angle: a pause has
    no weight.
    """
    rate = window.angular_rate
    if rate is None:
        return 0.0
    # A turn there and back has no mean rate, but an axis.
    along = np.linalg.svd(rate, full_matrices=False)[2][0]
    axis = unit(np.sign(rate @ along) @ rate)
    mean = unit(np.abs(rate @ axis) @ unit(window.specific_force))
    return math.acos(min(abs(float(axis @ mean)), 1.0))


def axis_share(window: Window) -> float:
    """Return the fraction of the squared turn rates about one axis; one without a gyro."""
    rate = window.angular_rate
    if rate is None or not rate.any():
        return 1.0
    squares = np.linalg.svd(rate, compute_uv=False) ** 2
    return float(squares[0] / squares.sum())


def usual_lean(window: Window, mounting: Mounting) -> float:
    """Return the `Mounting.lean` of the median specific force, radians."""
    return mounting.lean(np.median(window.specific_force, axis=0))
