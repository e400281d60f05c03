"""How a robot turns itself: one turn out, one back, when to stop, and what the sensors show of it.

Time and what the sensors show are passed in; out comes the yaw rate to command. A turn each way
winds no cable, and delays between gyro and compass cancel.

A gyro that hangs or is saturated still gives numbers. The level field of a robot that turned by an
angle moves as far on an unknown circle. The angles of the gyro and of the commands are both fitted
to it, each with a free scale that a slipping wheel or a distorted field explains. The gyro is
rejected if only the other one fits.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from enum import Enum

import numpy as np

from magcal_ros.core.geometry.arrays import FloatArray
from magcal_ros.core.geometry.attitude import unit
from magcal_ros.core.geometry.vec3 import dot, length
from magcal_ros.core.samples.streams import STREAMS, Pair
from magcal_ros.core.session.session import Progress


@dataclass(frozen=True)
class RotationTuning:
    """How a robot turns itself, what is a fault, and when the field contradicts the gyro."""

    acceleration: float = 0.5  # rad/s² of the ramps
    pause: float = 0.5  # seconds at rest between the two ways
    longest_step: float = 0.2  # seconds that a ramp goes on after any longer delay
    least_share: float = 0.3  # a robot that turns with less of the commanded rate does not turn
    most_share: float = 1.75  # times the commanded rate beyond which a robot is far too fast
    most_more: float = 0.1  # and rad/s on top
    leeway: float = 1.5  # times the planned time and angle that a turn may take: wheels slip
    farthest_beyond: float = math.radians(45.0)  # radians beyond either end: it coasts
    rate_span: float = 0.5  # seconds over which the gyro's rate is averaged
    kept: int = 2000  # samples kept to tell the compass's sense of rotation
    asked_every: float = 0.25  # seconds between two looks at the field
    spans: tuple[float, float, float] = (
        math.radians(75.0),
        math.radians(150.0),
        math.radians(300.0),
    )
    """Radians that gyro or commands have turned before a test; larger spans show more."""
    disagree: float = 0.38  # share by which gyro and commands differ before the field is tested
    factors: tuple[float, float, float] = (0.85, 1.0, 1.2)  # scales of an angle that may be true
    clearly_worse: float = 1.4  # times the squared misfit at which an angle is rejected
    smallest_radius: float = 1.5e-6  # tesla. A field on a smaller circle has not turned.
    most_rows: int = 200  # samples that are looked at, evenly over the span


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

    turned: float  # radians since the start, left positive
    rate: float  # rad/s over the last moments, left positive
    by_gyro: bool
    """Whether the gyro shows it; the compass alone is slower, and shows nothing at first."""
    is_complete: bool  # whether every heading was seen


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

    def __init__(self, speed: float, now: float, longest: float = math.inf) -> None:
        self.phase = Phase.OUT
        self.fault: Fault | None = None
        self.objection = ""
        self.command = 0.0
        self._speed = speed
        self._last = now
        self._from = 0.0
        self._target = math.tau
        self._brakes = False
        self._paused_at = now
        self._suspected: dict[Fault, float] = {}
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
                f"the gyro shows {math.degrees(seen.turned):+.0f}°, outside of the turn from 0° to "
                "360°"
            )
        elif max(abs(self._commanded), 0.5 * self._path) > TUNING.leeway * math.tau:
            self.objection = (
                f"{math.degrees(self._path):.0f}° were commanded, but the turn is not complete"
            )

    @property
    def direction(self) -> float:
        """+1 on the way out, to the left; -1 on the way back."""
        return -1.0 if self.phase is Phase.BACK else 1.0

    def step(self, now: float, seen: Seen) -> float:
        """Return the yaw rate to command at `now`, rad/s, left positive."""
        elapsed, self._last = min(now - self._last, TUNING.longest_step), now
        if self.phase is not Phase.ENDED:
            self.fault = self._find_fault(now, seen)
        if self.fault is not None or self.phase is Phase.ENDED:
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


def objection_to_gyro(turned: FloatArray, commanded: FloatArray, level: FloatArray) -> str:
    """Say how the field contradicts the gyro; empty if it does not, or it is too early to say.

    The angles by gyro and by commands are (n,), radians to the left; the field in two level axes is
    (n, 2), tesla.
    """
    for span in TUNING.spans:
        rows = _last(span, turned, commanded)
        if len(rows) < 10:
            return ""
        found = _objection(turned[rows], commanded[rows], level[rows], span)
        if found:
            return found
    return ""


def _objection(by_gyro: FloatArray, by_command: FloatArray, level: FloatArray, span: float) -> str:
    gyro_span, commanded_span = float(np.ptp(by_gyro)), float(np.ptp(by_command))
    shown, asked = math.degrees(gyro_span), math.degrees(commanded_span)
    if gyro_span >= span and _best_fit(by_gyro, level)[1] < TUNING.smallest_radius:
        return f"the gyro shows {shown:.0f}° of turn, but the field did not change"
    if np.ptp(by_gyro - by_command) < TUNING.disagree * max(gyro_span, commanded_span):
        return ""
    if _turns_rather_by(by_command, by_gyro, level):
        return (
            f"the gyro shows {shown:.0f}°, but the field turned with the {asked:.0f}° that were "
            "commanded"
        )
    return ""


def _turns_rather_by(one: FloatArray, other: FloatArray, level: FloatArray) -> bool:
    """Return whether the field turns by one angle and not by the other."""
    if not len(level):
        return False
    misfit, radius = _best_fit(one, level)
    is_clear = _best_fit(other, level)[0] > TUNING.clearly_worse * misfit
    return is_clear and radius > TUNING.smallest_radius


def fit_circle_by_angle(turned: FloatArray, level: FloatArray) -> tuple[float, float]:
    """Fit c + R(-turned) v to a level field by least squares, with c and v free.

    `turned` (n,) is in radians to the left, `level` (n, 2) in tesla. Returns the remaining sum of
    squares, T², and the length of v, T.
    """
    design = np.column_stack([np.ones(len(turned)), np.exp(-1j * turned)])
    observed = level[:, 0] + 1j * level[:, 1]
    found = np.linalg.lstsq(design, observed, rcond=None)[0]
    return float(np.sum(np.abs(observed - design @ found) ** 2)), float(abs(found[1]))


def _best_fit(turned: FloatArray, level: FloatArray) -> tuple[float, float]:
    """Return mean square misfit (T²) and radius (T) of the best of the allowed scales."""
    total, radius = min(fit_circle_by_angle(factor * turned, level) for factor in TUNING.factors)
    return total / (2.0 * len(turned)), radius


def _last(span: float, turned: FloatArray, commanded: FloatArray) -> FloatArray:
    """Return the newest rows in which either angle spans so much, evenly thinned; else none."""
    backward = slice(None, None, -1)
    spans = [
        np.maximum.accumulate(angle[backward]) - np.minimum.accumulate(angle[backward])
        for angle in (turned, commanded)
    ]
    enough = np.flatnonzero(np.maximum(*spans) >= span)
    if not len(enough):
        return np.empty(0, dtype=int)
    count = int(enough[0]) + 1
    rows = np.linspace(len(turned) - count, len(turned) - 1, min(count, TUNING.most_rows))
    return np.unique(rows.round().astype(int))


class RotationProof:
    """Follows one turn by its samples; `to_body` (3, 3) is from raw field to nominal body axes."""

    def __init__(self, to_body: FloatArray) -> None:
        self._to_body = to_body
        self._turned = 0.0
        self._newest: tuple[float, float] | None = None
        self._has_gyro = False
        self._commanded = 0.0
        self._asked = -math.inf
        self._rows: deque[tuple[float, ...]] = deque(maxlen=TUNING.kept)

    def add(self, pair: Pair, command: float = 0.0) -> None:
        """Take the next sample, and the rate (rad/s) that is commanded meanwhile."""
        stamp, force, rate = pair.field.stamp, pair.imu.force, pair.imu.rate
        if not all(map(math.isfinite, rate)):
            return
        self._has_gyro = self._has_gyro or any(rate)
        about_up = dot(force, rate) / length(force)
        if self._newest is not None:
            step = stamp - self._newest[0]
            if 0.0 < step <= STREAMS.longest_gyro_step:
                self._turned += 0.5 * step * (about_up + self._newest[1])
                self._commanded += step * command
        self._newest = (stamp, about_up)
        row = (self._turned, *pair.field.field, *force, stamp, self._commanded)
        self._rows.append(row)

    def seen(self, progress: Progress) -> Seen:
        """Return what the gyro shows, or without one what the session's compass shows."""
        coverage = progress.coverage
        if self._has_gyro:
            return Seen(self._turned, self._rate(), True, coverage.is_complete)
        return Seen(coverage.turned, progress.turn_rate, False, coverage.is_complete)

    def objection(self, now: float) -> str:
        """Say how the field contradicts the gyro; most calls return at once, without a test."""
        if not self._has_gyro or now - self._asked < TUNING.asked_every:
            return ""
        self._asked = now
        found = objection_to_gyro(*self._angles_and_field())
        why = "the gyro is frozen, or the robot turns faster than the gyro's range"
        return f"{found}: {why}" if found else ""

    def explain(self, fault: Fault, seen: Seen, command: float) -> str:
        """Return what is wrong and what to check, for a fault at a command in rad/s."""
        shown, commanded = math.degrees(seen.rate), math.degrees(command)
        sensor = "gyro" if seen.by_gyro else "compass"
        rates = f"the {sensor} shows {shown:+.0f}°/s where {commanded:+.0f}°/s were commanded"
        if fault is Fault.TOO_FAST:
            return f"the robot turns far too fast: {rates}"
        if fault is Fault.WRONG_WAY:
            return f"{rates}: {self._blame(seen)}"
        turned, asked, level = self._angles_and_field()
        if seen.by_gyro and _turns_rather_by(asked, turned, level):
            return f"{rates}, but the field turns: the gyro does not measure this turn"
        remedy = "check the emergency stop, and that the base obeys cmd_vel"
        return f"the robot does not turn: {rates}; {remedy}"

    def _blame(self, seen: Seen) -> str:
        base = "the base turns the wrong way (angular.z is positive to the left)"
        if not seen.by_gyro:
            return f"{base}, or the magnetometer's axes are mirrored"
        return {
            1: f"{base}; the compass agrees with the gyro",
            -1: "the gyro is mirrored, because the compass shows the turn as commanded",
            0: f"{base}, or the gyro is mirrored; the compass does not show which yet",
        }[self.compass_sense()]

    def compass_sense(self) -> int:
        """Return +1 if the field turns as the gyro does, -1 if the other way, 0 if unknown.

        The arc may be short.
        """
        turned, _, level = self._angles_and_field()
        with_gyro = _turns_rather_by(turned, -turned, level)
        return with_gyro - _turns_rather_by(-turned, turned, level)

    def _rate(self) -> float:
        """Return the mean rate over the last moments, rad/s."""
        first = last = self._rows[-1]
        for row in reversed(self._rows):
            if last[7] - row[7] > TUNING.rate_span:
                break
            first = row
        seconds = last[7] - first[7]
        return (last[0] - first[0]) / seconds if seconds > 0.0 else 0.0

    def _angles_and_field(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return the angles of gyro and commands (n,), and the field in two level axes (n, 2)."""
        if len(self._rows) < 10:
            return np.zeros(0), np.zeros(0), np.zeros((0, 2))
        rows = np.array(self._rows)
        up = unit(rows[:, 4:7].mean(axis=0))
        first = unit(np.cross(up, np.eye(3)[int(np.argmin(np.abs(up)))]))
        axes = np.array([first, np.cross(up, first)])
        return rows[:, 0], rows[:, 8], rows[:, 1:4] @ self._to_body.T @ axes.T
