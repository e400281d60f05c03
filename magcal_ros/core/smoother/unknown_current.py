"""The field of a current that is not known between the messages of a battery."""

from __future__ import annotations

import numpy as np

from magcal_ros.core.geometry.arrays import FloatArray
from magcal_ros.core.smoother.factors import Linear
from magcal_ros.core.smoother.nodes import Nodes
from magcal_ros.core.smoother.unknowns import AT, CURRENT_LATE


def with_unknown_current(
    linear: Linear, nodes: Nodes, shared: FloatArray, variance: FloatArray, most: float
) -> Linear:
    """Return the field's residuals, of which the part along the motors' field counts less.

    With the scale that they get here, residuals of this `variance` per axis (n,) have it in all
    directions, what is unknown of the current included. `most` is the field per axis at the largest
    current that motors may add besides, µT, while theirs is not yet known.
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
