"""What a gyro reads while its robot stands: the bias to be taken off what it reads later."""

from __future__ import annotations

import math
from typing import NamedTuple

from magcal_ros.core.geometry.vec3 import Triple, length

CHANGES_BY = 0.03
"""Share of itself that a bias changes by from rest to rest: 3.38 and 3.55 °/s within 40 s, of a car
whose gyro had 4.5 °/s."""


class GyroAtRest(NamedTuple):
    """A gyro's bias as a rest has shown it."""

    rate: Triple
    """rad/s, body axes."""
    sigma: float
    """Of it, per axis, rad/s, while the robot stood."""

    @property
    def later_sigma(self) -> float:
        """Sigma of the bias that is left when this is taken off later on, rad/s per axis."""
        return math.hypot(self.sigma, CHANGES_BY * length(self.rate))
