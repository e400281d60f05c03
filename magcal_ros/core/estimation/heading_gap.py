"""By how much two fits of one turn differ where it counts: in the heading."""

from __future__ import annotations

import numpy as np

from magcal_ros.core.calibration.correction import Correction
from magcal_ros.core.estimation.solver import Fit
from magcal_ros.core.estimation.uncertainty import correction_from
from magcal_ros.core.geometry.attitude import wrap_angle, yaw_from_up_and_field


def heading_gap(one: Fit, other: Fit) -> float:
    """Return the largest difference of heading between two fits over the turn, radians."""
    first, second = (_correction(fit) for fit in (one, other))
    up, field = one.block.samples.up, one.block.samples.field
    gap = yaw_from_up_and_field(up, first.apply(field)) - yaw_from_up_and_field(
        up, second.apply(field)
    )
    return float(np.median(np.abs(wrap_angle(gap))))


def _correction(fit: Fit) -> Correction:
    return correction_from(fit.shared, fit.mounting, 1.0)
