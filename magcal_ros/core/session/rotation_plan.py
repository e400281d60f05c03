"""The plan of a robot that turns itself: one turn out, one back, and when to stop.

Time and what the sensors show are passed in; out comes the yaw rate to command. A turn each way
winds no cable, and delays between gyro and compass cancel.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum


@dataclass(frozen=True)
class RotationTuning:
    """How a robot turns itself, and how a fault is recognised."""

    acceleration: float = 0.5
    """rad/s² of the ramps."""
    pause: float = 0.5
    """Seconds at rest between the two ways."""
    longest_step: float = 0.2
    """Seconds. After a longer delay between two looks the ramp goes on as after this one."""
    least_share: float = 0.3
    """A robot that turns with less of the commanded rate does not turn."""
    most_share: float = 1.75
    """A robot that turns with more than so many times the commanded rate, and `most_more` on top,
    is far too fast."""
    most_more: float = 0.1
    """rad/s on top of `most_share`."""
    leeway: float = 1.5
    """The two turns may take so many times as long as planned, and be commanded so many times as
    far: wheels slip."""
    farthest_beyond: float = math.radians(45.0)
    """Radians that a robot may stand beyond either end of its full turn, by the gyro: it coasts."""


TUNING = RotationTuning()


class Phase(Enum):
    """The phase of the plan."""

    OUT = "out"
    PAUSE = "pause"
    BACK = "back"
    ENDED = "ended"


class Fault(str, Enum):
    """Why the robot must stop: it does not follow its commands."""

    NOT_TURNING = "not_turning"
    WRONG_WAY = "wrong_way"
    TOO_FAST = "too_fast"


@dataclass(frozen=True)
class Seen:
    """What the sensors show of the turn."""

    turned: float
    """Radians since the start, left positive."""
    rate: float
    """rad/s over the last moments, left positive."""
    by_gyro: bool
    """Whether the gyro shows it; the compass alone is slower, and shows nothing at first."""
    is_complete: bool
    """Whether every heading was seen."""


def patience(by_gyro: bool, speed: float) -> dict[Fault, float]:
    """Return the seconds that faults must last; the compass shows nothing before an arc."""
    if by_gyro:
        return {Fault.NOT_TURNING: 2.5, Fault.WRONG_WAY: 0.5, Fault.TOO_FAST: 0.5}
    slow = max(5.0, 1.5 / speed)
    return {Fault.NOT_TURNING: slow, Fault.WRONG_WAY: 4.0, Fault.TOO_FAST: 3.0}


def planned_duration(speed: float) -> float:
    """Return seconds that a turn each way takes at `speed`, rad/s."""
    return 2.0 * (math.tau / speed + speed / TUNING.acceleration) + TUNING.pause


class RotationPlan:
    """A turn to the left until every heading was seen or the turn is full, and as far back.

    Speed and commands are in rad/s; `now` is in seconds on a steady clock. `fault` says why the
    plan was broken off, if it was.
    """

    def __init__(self, speed: float, now: float) -> None:
        self.phase = Phase.OUT
        self.fault: Fault | None = None
        self.command = 0.0
        self._speed = speed
        self._last = now
        self._from = 0.0
        self._target = math.tau
        self._brakes = False
        self._paused_at = now
        self._suspected: dict[Fault, float] = {}

    @property
    def direction(self) -> float:
        """+1 on the way out, to the left; -1 on the way back."""
        return -1.0 if self.phase is Phase.BACK else 1.0

    def step(self, now: float, seen: Seen) -> float:
        """Return the yaw rate to command at `now`, rad/s, left positive."""
        elapsed, self._last = min(now - self._last, TUNING.longest_step), now
        if self.phase is not Phase.ENDED:
            self.fault = self._find_fault(now, seen)
        if self.phase is Phase.ENDED or self.fault is not None:
            self.phase, self.command = Phase.ENDED, 0.0
        elif self.phase is Phase.PAUSE:
            self._wait(now, seen)
        else:
            self._drive(now, elapsed, seen)
        return self.command

    def _wait(self, now: float, seen: Seen) -> None:
        if now - self._paused_at >= TUNING.pause:
            self._target = abs(seen.turned - self._from)
            self.phase, self._from, self._brakes = Phase.BACK, seen.turned, False
            self._suspected.clear()

    def _drive(self, now: float, elapsed: float, seen: Seen) -> None:
        size = abs(self.command)
        covered = self.direction * (seen.turned - self._from)
        braking_arc = size * size / (2.0 * TUNING.acceleration)
        if covered + braking_arc >= self._target or (self.phase is Phase.OUT and seen.is_complete):
            self._brakes = True
        change = TUNING.acceleration * elapsed
        size = max(size - change, 0.0) if self._brakes else min(size + change, self._speed)
        self.command = self.direction * size
        if self._brakes and size == 0.0:
            self.phase = Phase.PAUSE if self.phase is Phase.OUT else Phase.ENDED
            self._paused_at = now

    def _find_fault(self, now: float, seen: Seen) -> Fault | None:
        """Return a fault that has lasted longer than is tolerated."""
        along = self.direction * seen.rate
        commanded = 0.0 if self._brakes else abs(self.command)
        shows = {
            Fault.TOO_FAST: abs(seen.rate) > TUNING.most_share * self._speed + TUNING.most_more,
            Fault.WRONG_WAY: commanded > 0.0 and along < -TUNING.least_share * self._speed,
            Fault.NOT_TURNING: commanded > 0.0 and along < TUNING.least_share * commanded,
        }
        longest = patience(seen.by_gyro, self._speed)
        for fault, shown in shows.items():
            if not shown:
                self._suspected.pop(fault, None)
            elif now - self._suspected.setdefault(fault, now) > longest[fault]:
                return fault
        return None


class RotationLimits:
    """Limits of a robot's turn by the gyro, by the commanded angle, and by time.

    The first of them that is reached ends the motion. The robot starts at `now` (steady clock, s)
    and may take `longest` seconds. `objection` says why it must not turn on; it is empty while it
    may.
    """

    def __init__(self, speed: float, now: float, longest: float = math.inf) -> None:
        self.objection = ""
        self._deadline = now + min(longest, TUNING.leeway * planned_duration(speed))
        self._noted = now
        self._commanded = self._path = 0.0

    def is_late(self, now: float) -> bool:
        """Whether the time for the turn is up."""
        return now > self._deadline

    def note(self, now: float, command: float, seen: Seen) -> None:
        """Take the command (rad/s) that was in force until `now`, and what the sensors show."""
        step, self._noted = (now - self._noted) * command, now
        self._commanded += step
        self._path += abs(step)
        if self.objection:
            return
        beyond = TUNING.farthest_beyond
        if seen.by_gyro and not -beyond <= seen.turned <= math.tau + beyond:
            self.objection = (
                f"by the gyro it is at {math.degrees(seen.turned):+.0f}° of a turn that goes "
                "from 0° to 360°"
            )
        elif max(abs(self._commanded), 0.5 * self._path) > TUNING.leeway * math.tau:
            self.objection = (
                f"{math.degrees(self._path):.0f}° were commanded, and its turn is not complete"
            )
