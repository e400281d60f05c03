"""By how much two fits of one turn differ where it counts: in the heading."""

from __future__ import annotations

import math

import numpy as np

from magcal_ros.core.calibration.correction import Correction
from magcal_ros.core.calibration.heading_sigma import heading_jacobian, level_poses, rms_sigma
from magcal_ros.core.estimation.solver import Fit
from magcal_ros.core.estimation.uncertainty import correction_from, correction_jacobian
from magcal_ros.core.geometry.attitude import field_in_enu, wrap_angle, yaw_from_up_and_field


def heading_gap(one: Fit, other: Fit) -> float:
    """Return the difference of heading between two fits on the level, radians RMS.

    On the level, as a sigma of the heading is told: how they differ on a slope, which the turn may
    not have shown, is another question.
    """
    first, second = (_correction(fit) for fit in (one, other))
    poses = level_poses()
    field = poses @ field_in_enu(one.shared.strength, one.shared.inclination)
    raw = field @ np.linalg.inv(first.matrix).T + first.hard_iron
    gap = yaw_from_up_and_field(poses[:, :, 2], second.apply(raw)) - yaw_from_up_and_field(
        poses[:, :, 2], field
    )
    return math.sqrt(float(np.mean(wrap_angle(gap) ** 2)))


def unexplained_gap(efficient: Fit, other: Fit) -> float:
    """Return the gap as far as it is not the other fit's own uncertainty, radians.

    Of two estimates from the same samples, the one that uses them better and the one that uses
    less of them, the difference has the difference of their variances (Hausman, 1978).

    Parameters
    ----------
    efficient, other : Fit
    """
    usual = max(_heading_variance(other) - _heading_variance(efficient), 0.0)
    return math.sqrt(max(heading_gap(efficient, other) ** 2 - usual, 0.0))


def _heading_variance(fit: Fit) -> float:
    """Return the mean square of the predicted heading error on the level."""
    field = field_in_enu(fit.shared.strength, fit.shared.inclination)
    by_twelve = heading_jacobian(_correction(fit), field, 0.0)
    by_shared = by_twelve @ correction_jacobian(fit.shared, fit.mounting, 1.0)
    return rms_sigma(by_shared, fit.covariance) ** 2


def _correction(fit: Fit) -> Correction:
    return correction_from(fit.shared, fit.mounting, 1.0)
