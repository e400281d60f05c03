"""Whether a robot moves at the moment, from its gyro and wheels: what its motors do."""

from __future__ import annotations

import math
from dataclasses import dataclass

from magcal_ros.core.calibration.motors import Running
from magcal_ros.core.geometry.vec3 import Triple, length


@dataclass(frozen=True)
class RunningTuning:
    """When a robot moves.

    Parameters
    ----------
    rate : float
        rad/s from which it turns, as for the smoother (`Lengths.moving`).
    speed : float
        m/s from which it drives: below a step of a wheel's encoder.
    turning : float
        rad/s at which it surely turns to one side.
    edge : float
        Seconds after a start or stop is seen in which nobody knows whether the motors run.
    """

    rate: float = 0.03
    speed: float = 0.01
    turning: float = 0.1
    edge: float = 0.1


class MotionSense:
    """Follows whether a robot moves.

    Parameters
    ----------
    tuning : RunningTuning, optional

    Attributes
    ----------
    newest : Running
        What the motors did when it was asked last.
    """

    def __init__(self, tuning: RunningTuning = RunningTuning()) -> None:
        self.tuning = tuning
        self._moves: bool | None = None
        self._since = -math.inf
        self._stamp = math.nan
        self.newest = Running(0.5, math.nan, math.nan, math.nan, math.nan)

    def at(
        self, stamp: float, rate: Triple | None, is_at_rest: bool, speed: float, current: float
    ) -> Running:
        """Return what the motors do at a stamp, seconds; stamps go on or jump.

        Parameters
        ----------
        stamp : float
        rate : tuple of float or None
            Turn rate less the gyro's bias, rad/s, body axes; None where there is no gyro.
        is_at_rest : bool
            Whether the IMU shows that the robot stands, or rolls on evenly.
        speed, current : float
            m/s and amperes; NaN where nobody tells.
        """
        if stamp == self._stamp:
            return self.newest
        self._stamp = stamp
        moves = self._judged(rate, is_at_rest, speed)
        if moves is not self._moves:
            # What is not known at first was as it is now.
            self._since = -math.inf if self._moves is None else stamp
            self._moves = moves
        is_edge = 0.0 <= stamp - self._since < self.tuning.edge
        share = 0.5 if moves is None or is_edge else float(moves)
        turn_rate = math.nan if rate is None else rate[2] * float(moves is not False)
        driven = speed * float(moves is not False)
        side = max(-1.0, min(1.0, turn_rate / self.tuning.turning))
        self.newest = Running(share, turn_rate, driven, current, side)
        return self.newest

    def _judged(self, rate: Triple | None, is_at_rest: bool, speed: float) -> bool | None:
        """Return whether it moves; None where nobody knows."""
        if rate is not None and length(rate) > self.tuning.rate:
            return True
        if not math.isnan(speed):
            # Wheels that stand do not show a turn on the spot; the gyro would.
            return abs(speed) > self.tuning.speed or (None if rate is None else False)
        return False if is_at_rest else None
