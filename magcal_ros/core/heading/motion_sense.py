"""Whether a robot moves, and what its motors do."""

from __future__ import annotations

import math
from dataclasses import dataclass

from magcal_ros.core.calibration.correction import Running
from magcal_ros.core.geometry.vec3 import Triple, length


@dataclass(frozen=True)
class RunningTuning:
    """When a robot moves, and how well the inputs show what its motors add."""

    rate: float = 0.03  # rad/s from which it turns, as for the smoother (`Lengths.moving`)
    speed: float = 0.01  # m/s from which it drives: below a step of a wheel's encoder
    turning: float = 0.1  # rad/s at which it surely turns to one side
    slow: float = 0.05  # m/s below which it is about to stop, and twice `rate` likewise
    edge: float = 0.1  # seconds after a start or stop in which it is not known what runs
    slowing: float = 0.3  # the same after the robot got slow
    settles: float = 0.7  # seconds at rest after which the current is that of rest
    idle: float = 5.0  # seconds over which that is averaged
    body_length: float = 4.0  # seconds over which what no input shows is alike
    unseen: float = 0.1
    unseen_spread: float = 1.0
    """Share of what the inputs show by which the motors' field differs from it, along its
    direction: median, and standard deviation of its natural logarithm. Where nobody reports the
    currents of wheels, they vary by a fifth to a third, with the floor and bends; a field that is
    switched on with the motors hardly varies."""
    unseen_lasts: float = 300.0  # seconds of motion over which it is the same
    late_share: float = 0.03  # of the time in which motors run unseen, or do not
    longest: float = 0.5  # seconds that this lasts at most
    latency: float = 0.2  # seconds by which a speed or a current may be late


RUNNING = RunningTuning()


class MotionSense:
    """Follows whether a robot moves; `newest` is what the motors did when it was asked last."""

    def __init__(self) -> None:
        self._moves: bool | None = None
        self._is_slow = True
        self._since = self._slow_since = -math.inf
        self._stamp = self._idle = math.nan
        self.newest = Running(0.5, math.nan, math.nan, math.nan, math.nan)

    def at(
        self,
        stamp: float,
        rate: Triple | None,
        is_at_rest: bool,
        speed: float,
        current: float,
        reference: float = math.nan,
    ) -> Running:
        """Return what the motors do at a stamp, seconds; stamps go on or jump.

        `rate` is less the gyro's bias, rad/s, body axes; None without a gyro. `is_at_rest` is
        whether the IMU shows that the robot stands, or rolls on evenly. `speed` and `current` are
        in m/s and amperes, NaN where they are unknown. Of the current only what is beyond a
        `reference` counts, by default beyond that at rest: that of the calibration
        (`MotorField.reference`). Several calibrations may ask at one stamp.
        """
        if stamp != self._stamp:
            self.newest = self._seen(stamp, rate, is_at_rest, speed, current)
        if math.isnan(reference):
            return self.newest
        return self.newest._replace(current=current - reference)

    def _seen(
        self, stamp: float, rate: Triple | None, is_at_rest: bool, speed: float, current: float
    ) -> Running:
        """Return what the motors do at another stamp, and the current beyond that at rest."""
        seconds, self._stamp = stamp - self._stamp, stamp
        turns = 0.0 if rate is None else length(rate)
        drives = 0.0 if math.isnan(speed) else abs(speed)
        moves: bool | None = False if is_at_rest else None
        if turns > RUNNING.rate or drives > RUNNING.speed:
            moves = True
        elif not math.isnan(speed):
            # Wheels that stand do not show a turn on the spot; the gyro would.
            moves = None if rate is None else False
        if moves is not self._moves:
            # What is not known at first was as it is now.
            self._since = -math.inf if self._moves is None else stamp
            self._moves = moves
        is_slow = turns < 2.0 * RUNNING.rate and drives < RUNNING.slow
        if is_slow and not self._is_slow:
            self._slow_since = stamp
        self._is_slow = is_slow
        is_edge = 0.0 <= stamp - self._since < RUNNING.edge
        is_edge = is_edge or (moves is True and 0.0 <= stamp - self._slow_since < RUNNING.slowing)
        share = 0.5 if moves is None or is_edge else float(moves)
        turn_rate = math.nan if rate is None else rate[2] * float(moves is not False)
        driven = speed * float(moves is not False)
        side = max(-1.0, min(1.0, turn_rate / RUNNING.turning))
        if is_edge and moves is False:
            # Motors of a turn that has just ended may still run to its side.
            side = self.newest.side
        return Running(share, turn_rate, driven, self._beyond_rest(moves, seconds, current), side)

    def _beyond_rest(self, moves: bool | None, seconds: float, current: float) -> float:
        """Return by how much a current, if known, is beyond that at rest, and follow the latter."""
        rests = moves is False and self._stamp - self._since > RUNNING.settles
        if rests and not math.isnan(current):
            share = min(max(seconds, 0.0) / RUNNING.idle, 1.0)
            old = current if math.isnan(self._idle) else self._idle
            self._idle = old + share * (current - old)
        return 0.0 * current if moves is False else current - self._idle
