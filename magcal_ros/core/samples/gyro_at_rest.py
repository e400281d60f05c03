"""What a gyro reads while its robot stands: the bias to be taken off what it reads later."""

from __future__ import annotations

from typing import NamedTuple

from magcal_ros.core.geometry.vec3 import Triple


class GyroAtRest(NamedTuple):
    """A gyro's bias as a rest has shown it.

    Parameters
    ----------
    rate : tuple of float
        rad/s, body axes.
    sigma : float
        Of it, per axis, rad/s.
    """

    rate: Triple
    sigma: float
