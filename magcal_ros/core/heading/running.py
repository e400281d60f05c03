"""Whether a robot moves at the moment, from its gyro and wheels: what its motors do."""

from __future__ import annotations

import math
from dataclasses import dataclass

from magcal_ros.core.calibration.motors import Running
from magcal_ros.core.geometry.vec3 import Triple, length


@dataclass(frozen=True)
class RunningTuning:
    """When a robot moves."""

    rate: float = 0.03
    """rad/s from which it turns, as for the smoother (`Lengths.moving`)."""
    speed: float = 0.01
    """m/s from which it drives: below a step of a wheel's encoder."""
    turning: float = 0.1
    """rad/s at which it surely turns to one side."""
    slow_rate: float = 0.06
    slow: float = 0.05
    """rad/s and m/s below which it is about to stop."""
    edge: float = 0.1
    slowing: float = 0.3
    """Seconds after a start or stop is seen, and after it got slow, in which nobody knows whether
    the motors run."""
    settles: float = 0.7
    idle: float = 5.0
    """Seconds at rest after which the current is that of rest, and over which that is averaged."""


class MotionSense:
    """Follows whether a robot moves.

    Attributes
    ----------
    newest : Running
        What the motors did when it was asked last.
    """

    def __init__(self, tuning: RunningTuning = RunningTuning()) -> None:
        self.tuning = tuning
        self._moves: bool | None = None
        self._is_slow = True
        self._since = self._slow_since = -math.inf
        self._stamp = self._idle = math.nan
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
            m/s and amperes; NaN where they are unknown. Of the current only what is beyond that at
            rest counts: the calibration is that of the robot at rest.
        """
        if stamp == self._stamp:
            return self.newest
        seconds, self._stamp = stamp - self._stamp, stamp
        moves = self._judged(rate, is_at_rest, speed)
        if moves is not self._moves:
            # What is not known at first was as it is now.
            self._since = -math.inf if self._moves is None else stamp
            self._moves = moves
        is_slow = self._goes_slowly(rate, speed)
        if is_slow and not self._is_slow:
            self._slow_since = stamp
        self._is_slow = is_slow
        is_edge = 0.0 <= stamp - self._since < self.tuning.edge
        is_edge = is_edge or (
            moves is True and 0.0 <= stamp - self._slow_since < self.tuning.slowing
        )
        share = 0.5 if moves is None or is_edge else float(moves)
        turn_rate = math.nan if rate is None else rate[2] * float(moves is not False)
        driven = speed * float(moves is not False)
        side = max(-1.0, min(1.0, turn_rate / self.tuning.turning))
        if is_edge and moves is False:
            # Motors of a turn that has just ended may still run to its side.
            side = self.newest.side
        beyond = self._beyond_rest(moves, seconds, current)
        self.newest = Running(share, turn_rate, driven, beyond, side)
        return self.newest

    def _beyond_rest(self, moves: bool | None, seconds: float, current: float) -> float:
        """Return by how much a current is beyond that at rest, and follow the latter."""
        rests = moves is False and self._stamp - self._since > self.tuning.settles
        if rests and not math.isnan(current):
            share = min(max(seconds, 0.0) / self.tuning.idle, 1.0)
            old = current if math.isnan(self._idle) else self._idle
            self._idle = old + share * (current - old)
        return 0.0 if moves is False else current - self._idle

    def _goes_slowly(self, rate: Triple | None, speed: float) -> bool:
        turns = 0.0 if rate is None else length(rate)
        drives = 0.0 if math.isnan(speed) else abs(speed)
        return turns < self.tuning.slow_rate and drives < self.tuning.slow

    def _judged(self, rate: Triple | None, is_at_rest: bool, speed: float) -> bool | None:
        """Return whether it moves; None where that is not known."""
        if rate is not None and length(rate) > self.tuning.rate:
            return True
        if not math.isnan(speed):
            # Wheels that stand do not show a turn on the spot; the gyro would.
            return abs(speed) > self.tuning.speed or (None if rate is None else False)
        return False if is_at_rest else None
