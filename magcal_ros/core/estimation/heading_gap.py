"""By how much two fits of one turn differ where it counts: in the heading."""

from __future__ import annotations

import math

from magcal_ros.core.calibration.heading_sigma import rms_apart, rms_sigma
from magcal_ros.core.estimation.solver import Fit
from magcal_ros.core.estimation.uncertainty import correction_from, level_heading_by_globals


def heading_gap(one: Fit, other: Fit) -> float:
    """Return the difference of heading between two fits on the level, radians RMS.

    On the level, as a sigma of the heading is told: how they differ on a slope, which the turn may
    not have shown, is another question.
    """
    first, second = (correction_from(fit.shared, fit.mounting, 1.0) for fit in (one, other))
    return rms_apart(first, second, one.shared.strength, one.shared.inclination)


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
    return rms_sigma(level_heading_by_globals(fit, 1.0), fit.covariance) ** 2
