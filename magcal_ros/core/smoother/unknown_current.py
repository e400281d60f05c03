"""The field of a current that is not known between the messages of a battery."""

from __future__ import annotations

import numpy as np

from magcal_ros.core.geometry.arrays import FloatArray
from magcal_ros.core.smoother.factors import Linear
from magcal_ros.core.smoother.nodes import Nodes
from magcal_ros.core.smoother.unknowns import AT, CURRENT_LATE


def with_unknown_current(
    linear: Linear, nodes: Nodes, shared: FloatArray, variance: FloatArray
) -> Linear:
    """Return the field's residuals, of which the part along the motors' field counts less.

    With the scale that they get here, residuals of this `variance` per axis (n,) have it in all
    directions, what is unknown of the current included.
    """
    gain = shared[AT["motors_current"]]
    square = float(gain @ gain)
    if nodes.currents is None or square == 0.0:
        return linear
    unknown = square * nodes.currents.variance(shared[CURRENT_LATE])
    less = 1.0 - np.sqrt(variance / (variance + unknown))
    return linear.times(np.eye(3) - less[:, None, None] * np.outer(gain, gain) / square)
