"""Whether the raw field turned since a spell began: what no gyro bias can imitate.

A robot on a slow, even circle looks to gyro and accelerometer like one that stands and whose gyro
has a bias about up. The field tells them apart, calibrated or not: it turns with the robot.
"""

from __future__ import annotations

import math

from magcal_ros.core.geometry.vec3 import Triple, between, distance, length
from magcal_ros.core.up.up_tuning import RestTuning

ZERO: Triple = (0.0, 0.0, 0.0)


class FieldStillness:
    """Compares the field of the moment with that at the beginning of a spell.

    Parameters
    ----------
    tuning : RestTuning
        What is taken for granted.

    Attributes
    ----------
    mean : tuple of float
        The field of the moment, averaged over some tenths of a second.
    """

    def __init__(self, tuning: RestTuning) -> None:
        self._tuning = tuning
        self._stamp = -math.inf
        self._last = self.mean = ZERO
        self._noise = 0.0
        self._begin()

    def _begin(self) -> None:
        self._first = ZERO
        self._first_count = 0
        self._since = math.inf

    def begin(self) -> None:
        """Begin a new spell with the next field sample."""
        if self._first_count:
            self._begin()

    def add(self, stamp: float, field: Triple) -> None:
        """Take a raw field sample (tesla, or any unit) at a stamp in seconds."""
        seconds = stamp - self._stamp
        self._stamp = stamp
        if not 0.0 < seconds < self._tuning.field_lasts:
            self.mean, self._noise = field, 0.0
            self._begin()
        else:
            share = min(1.0, seconds / self._tuning.field_mean)
            self.mean = between(self.mean, field, share)
            # Half the square of a difference is the noise.
            square = distance(field, self._last) ** 2 / 6.0
            self._noise += 0.2 * share * (square - self._noise)
        self._last = field
        if not self._first_count:
            self._since = stamp
        if stamp - self._since < self._tuning.field_mean:
            self._first_count += 1
            self._first = between(self._first, field, 1.0 / self._first_count)

    def is_heard(self, stamp: float) -> bool:
        """Whether the field still came shortly before a stamp."""
        return abs(stamp - self._stamp) < self._tuning.field_lasts

    def has_turned(self, rate: float) -> bool | None:
        """Whether the robot really turns at a rate; None while the field cannot tell.

        Parameters
        ----------
        rate : float
            rad/s about up that the gyro reads beyond its known bias.
        """
        seconds = self._stamp - self._since
        if not seconds > 2.0 * self._tuning.field_mean:
            return None
        bound = self._tuning.level_share * length(self._last) * min(1.0, abs(rate) * seconds)
        change = distance(self.mean, self._first)
        noise = self._tuning.clear * math.sqrt(2.0 * self._noise / self._first_count)
        if change + noise < bound:
            return False
        return True if change - noise > bound else None
