"""Uncertainty of the motors' field, as the current is unknown between the battery's messages."""

from __future__ import annotations

import numpy as np

from magcal_ros.core.geometry.arrays import FloatArray
from magcal_ros.core.smoother.factors import Residuals
from magcal_ros.core.smoother.nodes import Nodes
from magcal_ros.core.smoother.unknowns import AT, CURRENT_LATE


def with_unknown_current(
    linear: Residuals, nodes: Nodes, shared: FloatArray, variance: FloatArray, most: float
) -> Residuals:
    """Return the field's residuals, scaled down along the motors' field.

    The scaled residuals have `variance` per axis (n,) in all directions, including the uncertainty
    of the current. `most` is the largest field per axis that the motors may add at the largest
    current, µT, until the iterations have estimated it.
    """
    if nodes.currents is None:
        return linear
    gain = shared[AT["motors_current"]]
    unknown = nodes.currents.variance(shared[CURRENT_LATE])
    square, other = float(gain @ gain), (most / nodes.currents.battery.largest) ** 2
    along, across = (
        np.sqrt(variance / (variance + each * unknown)) for each in (square + other, other)
    )
    direction = np.outer(gain, gain) / max(square, 1e-12)
    return linear.times(
        along[:, None, None] * direction + across[:, None, None] * (np.eye(3) - direction)
    )
