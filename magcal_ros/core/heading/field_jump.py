"""Two hypotheses of a yaw that the field has overruled: a wrong yaw, or added iron.

While the robot does not turn, they cannot be separated. The field of iron on the robot turns with
the robot and the Earth's field does not: the next turn decides.
"""

from __future__ import annotations

import cmath
import math
from typing import NamedTuple

MOST = 30.0  # largest log odds


class LevelField(NamedTuple):
    """The level field at a moment against that of the Earth by the overruled yaw."""

    measured: complex  # tesla; its phase is the yaw by the field minus that by the gyro alone
    yaw: float  # by the gyro alone since the yaw was overruled, radians
    level: float  # level field of the Earth, tesla
    variance: float  # of the field by places and the gyro, per axis, tesla²


class FieldJump:
    """Two hypotheses of a field that turned by `angle` radians against the gyro at `stamp`."""

    def __init__(self, stamp: float, angle: float, seen: LevelField, log_odds: float = 0.0) -> None:
        self.stamp, self.angle = stamp, angle
        self._log_odds = log_odds  # of iron against a yaw that was wrong
        self._iron = (seen.measured - seen.level) * cmath.rect(1.0, seen.yaw)  # on the robot

    @property
    def variance(self) -> float:
        """Variance of the yaw that follows the field, rad²: with iron its error is `angle`."""
        return self.angle**2 / (1.0 + math.exp(-self._log_odds))

    def add(self, seen: LevelField, share: float) -> None:
        """Add a measurement that counts as a fraction of an independent measurement."""
        off_iron = abs(seen.measured - seen.level - self._iron * cmath.rect(1.0, -seen.yaw))
        off_earth = abs(seen.measured - cmath.rect(seen.level, self.angle))
        # A Cauchy distribution in the level plane: passing iron must not decide.
        ratio = (seen.variance + off_earth**2) / (seen.variance + off_iron**2)
        odds = self._log_odds + share * 1.5 * math.log(ratio)
        self._log_odds = max(-MOST, min(MOST, odds))

    def after(self, angle: float, variance: float) -> float:
        """Return the log odds of iron after the field has turned again, by `angle` radians.

        `variance` is the variance of the angle, rad². If the iron is removed, the field turns back
        by the same angle; other iron turns it by any angle.
        """
        off = math.remainder(self.angle + angle, math.tau)
        density = math.exp(-0.5 * off**2 / variance) / math.sqrt(math.tau * variance)
        came = 1.0 / (1.0 + math.exp(-self._log_odds))
        return -math.log1p(math.tau * density * came / max(1.0 - came, math.exp(-MOST)))

    @property
    def in_words(self) -> str:
        """The two hypotheses in one sentence."""
        return (
            f"at {self.stamp:.1f} s the field turned by {abs(math.degrees(self.angle)):.0f}° "
            "against the gyro: either iron was added or removed, or the yaw was wrong; the next "
            "turn of the robot shows which"
        )
