"""Whether the motors run, by gyro, wheels and rests, and the inputs of their field."""

from __future__ import annotations

import math
from dataclasses import dataclass

from magcal_ros.core.calibration.correction import MotorState
from magcal_ros.core.geometry.vec3 import Triple, length


@dataclass(frozen=True)
class MotionDetectorTuning:
    """When a robot moves, and how well the inputs determine the motors' field."""

    rate: float = 0.03  # rad/s from which it turns
    speed: float = 0.01  # m/s from which it drives: below a step of a wheel's encoder
    edge: float = 0.1  # seconds after a start or stop in which the state of motors is unknown
    idle: float = 5.0  # seconds over which the current at rest is averaged
    body_length: float = 4.0  # correlation time of the motors' residual field, seconds
    unseen: float = 0.1
    """Relative residual of the motors' field along the field by the inputs, median. Without
    reported currents, those of wheels vary by a fifth to a third, with the floor and in curves; a
    field that is switched with the motors hardly varies."""
    unseen_time: float = 300.0  # correlation time of this ratio, seconds of motion
    late_share: float = 0.03  # fraction of the time in which motors start or stop undetected
    longest: float = 0.5  # longest such time, seconds
    latency: float = 0.2  # latency of a speed or a current, seconds


MOTION = MotionDetectorTuning()


class MotionDetector:
    """Detects motion; `newest` are the inputs of the motors' field at the last call."""

    def __init__(self) -> None:
        self._moves: bool | None = None
        self._since = -math.inf
        self._stamp = self._idle = math.nan
        self.newest = MotorState(0.5, math.nan, math.nan, math.nan, math.nan)

    def at(
        self,
        stamp: float,
        rate: Triple | None,
        is_at_rest: bool,
        speed: float,
        current: float,
        reference: float = math.nan,
    ) -> MotorState:
        """Return the inputs of the motors' field at a stamp, seconds.

        `rate` is without the gyro's bias, rad/s, body axes; None without a gyro. `is_at_rest` is
        whether the IMU shows a rest or steady motion. `speed` and `current` are in m/s and amperes,
        NaN if unknown. The current is counted from `reference` (`MotorField.reference`), by default
        from that at rest. Several calibrations may ask at one stamp.
        """
        if stamp != self._stamp:
            self.newest = self._inputs_at(stamp, rate, is_at_rest, speed, current)
        if math.isnan(reference):
            return self.newest
        return self.newest._replace(current=current - reference)

    def _inputs_at(
        self, stamp: float, rate: Triple | None, is_at_rest: bool, speed: float, current: float
    ) -> MotorState:
        """Return what the motors do at another stamp, and the current beyond that at rest."""
        seconds, self._stamp = stamp - self._stamp, stamp
        turns = 0.0 if rate is None else length(rate)
        drives = 0.0 if math.isnan(speed) else abs(speed)
        moves: bool | None = False if is_at_rest else None
        if turns > MOTION.rate or drives > MOTION.speed:
            moves = True
        elif not math.isnan(speed):
            # A turn on the spot may have no speed; only a gyro excludes it.
            moves = None if rate is None else False
        if moves is not self._moves:
            # The first known state counts from the beginning.
            self._since = -math.inf if self._moves is None else stamp
            self._moves = moves
        is_edge = 0.0 <= stamp - self._since < MOTION.edge
        share = 0.5 if moves is None or is_edge else float(moves)
        turn_rate = math.nan if rate is None else rate[2] * float(moves is not False)
        driven = speed * float(moves is not False)
        side = max(-1.0, min(1.0, turn_rate / MOTION.rate))
        if is_edge and moves is False:
            # Just after a turn, its motors may still run.
            side = self.newest.side
        return MotorState(
            share, turn_rate, driven, self._beyond_rest(moves, seconds, current), side
        )

    def _beyond_rest(self, moves: bool | None, seconds: float, current: float) -> float:
        """Return a current minus that at rest, which is updated at rest."""
        rests = moves is False and self._stamp - self._since > MOTION.edge
        if rests and not math.isnan(current):
            share = min(max(seconds, 0.0) / MOTION.idle, 1.0)
            old = current if math.isnan(self._idle) else self._idle
            self._idle = old + share * (current - old)
        return 0.0 * current if moves is False else current - self._idle
