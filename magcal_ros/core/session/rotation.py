"""Control of a robot that turns itself once each way, and its supervision by the sensors.

The plan takes the time and the measured turn, and returns the yaw rate to command. With a turn each
way, cables are not twisted, and delays between gyro and compass cancel.

A frozen or saturated gyro still publishes numbers. While the robot turns by an angle, the level
field moves by the same angle on an unknown circle. The angles by the gyro and by the commands are
both fitted to the field, each with a free scale for wheel slip and a distorted field. The gyro is
rejected if only the commanded angle fits.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum

import numpy as np

from magcal_ros.core.geometry.arrays import FloatArray
from magcal_ros.core.geometry.vec3 import Triple, dot, length
from magcal_ros.core.knowledge import level_rotation
from magcal_ros.core.samples.samples_tuning import STREAMS
from magcal_ros.core.samples.streams import Pair
from magcal_ros.core.session.session import Progress
from magcal_ros.core.session.session_tuning import ROTATION


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
class MeasuredTurn:
    """The turn as measured by the sensors."""

    turned: float  # radians since the start, left positive
    rate: float  # recent mean rate, rad/s, left positive
    by_gyro: bool
    """Whether the gyro measures the turn. The compass is slower and needs an arc first."""
    is_complete: bool  # whether there are samples at every heading


def planned_duration(speed: float) -> float:
    """Return the duration in seconds of a turn each way at `speed`, rad/s."""
    return 2.0 * (math.tau / speed + speed / ROTATION.acceleration) + ROTATION.pause


class RotationPlan:
    """A turn to the left until all headings are measured, at most a full circle, and back.

    Speed and commands are in rad/s; `now` is in seconds on a steady clock. `fault` is the reason
    for an early end, or None.
    """

    def __init__(self, speed: float, now: float, longest: float = math.inf) -> None:
        self.phase = Phase.OUT
        self.fault: Fault | None = None
        self.command = 0.0
        self._speed = speed
        self._last = now
        self._from = 0.0
        self._target = math.tau
        self._brakes = False
        self._paused_at = now
        self._missing = self._excess = 0.0  # radians, see `_find_fault`
        self._deadline = now + min(longest, ROTATION.leeway * planned_duration(speed))
        self._commanded = self._path = 0.0  # radians, left positive and without a sign

    def is_late(self, now: float) -> bool:
        """Whether the time limit of the turn is exceeded."""
        return now > self._deadline

    def objection(self, measured: MeasuredTurn) -> str:
        """Return why the robot has turned too far; empty if it has not."""
        beyond = ROTATION.farthest_beyond
        if measured.by_gyro and not -beyond <= measured.turned <= math.tau + beyond:
            return (
                f"the gyro measured {math.degrees(measured.turned):+.0f}°, outside the planned "
                "turn from 0° to 360°"
            )
        if max(abs(self._commanded), 0.5 * self._path) > ROTATION.leeway * math.tau:
            return (
                f"{math.degrees(self._path):.0f}° were commanded, but the turn is not complete: "
                f"{math.degrees(measured.turned):+.0f}° were measured"
            )
        return ""

    @property
    def direction(self) -> float:
        """+1 for the turn to the left, -1 for the turn back."""
        return -1.0 if self.phase is Phase.BACK else 1.0

    def step(self, now: float, measured: MeasuredTurn) -> float:
        """Return the yaw rate to command at `now`, rad/s, left positive."""
        since, self._last = now - self._last, now
        self._commanded += since * self.command
        self._path += since * abs(self.command)
        elapsed = min(since, ROTATION.longest_step)
        if self.phase is not Phase.ENDED:
            self.fault = self._find_fault(elapsed, measured)
        if self.fault is not None or self.phase is Phase.ENDED:
            self.phase, self.command = Phase.ENDED, 0.0
        elif self.phase is Phase.PAUSE:
            self._wait(now, measured)
        else:
            self._drive(now, elapsed, measured)
        return self.command

    def _wait(self, now: float, measured: MeasuredTurn) -> None:
        if now - self._paused_at >= ROTATION.pause:
            self._target = abs(measured.turned - self._from)
            self.phase, self._from, self._brakes = Phase.BACK, measured.turned, False

    def _drive(self, now: float, elapsed: float, measured: MeasuredTurn) -> None:
        size = abs(self.command)
        covered = self.direction * (measured.turned - self._from)
        braking_arc = size * size / (2.0 * ROTATION.acceleration)
        if covered + braking_arc >= self._target or (
            self.phase is Phase.OUT and measured.is_complete
        ):
            self._brakes = True
        change = ROTATION.acceleration * elapsed
        size = max(size - change, 0.0) if self._brakes else min(size + change, self._speed)
        self.command = self.direction * size
        if self._brakes and size == 0.0:
            self.phase = Phase.PAUSE if self.phase is Phase.OUT else Phase.ENDED
            self._paused_at = now

    def _find_fault(self, elapsed: float, measured: MeasuredTurn) -> Fault | None:
        """Return the fault by which the measured angle is far from the commanded one.

        Two cumulative sums (CUSUM) count the missing and the excess angle. They return to zero when
        the robot turns as it should, so that short deviations and wheel slip are no fault.
        """
        along = self.direction * measured.rate
        commanded = 0.0 if self._brakes else abs(self.command)
        missing = ROTATION.least_share * commanded - along
        excess = abs(measured.rate) - ROTATION.most_share * self._speed
        self._missing = max(0.0, self._missing + elapsed * missing) if commanded else 0.0
        self._excess = max(0.0, self._excess + elapsed * excess)
        allowed = ROTATION.off_by_gyro if measured.by_gyro else ROTATION.off_by_compass
        if self._excess > allowed:
            return Fault.TOO_FAST
        if self._missing > allowed:
            backwards = along < -ROTATION.least_share * commanded
            return Fault.WRONG_WAY if backwards else Fault.NOT_TURNING
        return None


def objection_to_gyro(turned: FloatArray, commanded: FloatArray, level: FloatArray) -> str:
    """Return how the field contradicts the gyro; empty if it does not or the turn is too short.

    `turned` by the gyro and `commanded` are (n,), radians to the left. `level` is the field in two
    level axes, (n, 2), tesla. The newest samples of several spans are tested.
    """
    for span in ROTATION.spans:
        spans = np.maximum(_spans_to_the_end(turned), _spans_to_the_end(commanded))
        newest = slice(int(np.count_nonzero(spans >= span)) - 1, None)
        if newest.start < 0:
            return ""
        by_gyro, by_command, field = (each[newest] for each in (turned, commanded, level))
        gyro_span, commanded_span = float(np.ptp(by_gyro)), float(np.ptp(by_command))
        shown, asked = math.degrees(gyro_span), math.degrees(commanded_span)
        if gyro_span >= span and _best_fit(by_gyro, field)[1] < ROTATION.smallest_radius:
            return f"the gyro measured a turn of {shown:.0f}°, but the field did not change"
        differ = np.ptp(by_gyro - by_command) >= ROTATION.disagree * max(gyro_span, commanded_span)
        if differ and _turns_rather_by(by_command, by_gyro, field):
            return (
                f"the gyro measured {shown:.0f}°, but the field turned by the commanded "
                f"{asked:.0f}°"
            )
    return ""


def _turns_rather_by(one: FloatArray, other: FloatArray, level: FloatArray) -> bool:
    """Return whether the field turns by angle `one` and not by angle `other`."""
    if not len(level):
        return False
    misfit, radius = _best_fit(one, level)
    is_clear = _best_fit(other, level)[0] > ROTATION.clearly_worse * misfit
    return is_clear and radius > ROTATION.smallest_radius


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
    total, radius = min(fit_circle_by_angle(factor * turned, level) for factor in ROTATION.factors)
    return total / (2.0 * len(turned)), radius


def _spans_to_the_end(angle: FloatArray) -> FloatArray:
    """Return the range of an angle (n,) from each row to the last."""
    backward = angle[::-1]
    return np.asarray(np.maximum.accumulate(backward) - np.minimum.accumulate(backward))[::-1]


class TurnMonitor:
    """Integrates the gyro over one turn and tests it by the field.

    `to_body` (3, 3) rotates the raw field to nominal body axes.
    """

    def __init__(self, to_body: FloatArray) -> None:
        self._to_body = to_body
        self._turned = self._commanded = self._rate = 0.0
        self._newest = -math.inf, 0.0  # stamp, and rate about up
        self._has_gyro = False
        self._rows: list[tuple[float, float, Triple, Triple]] = []
        """Radians by gyro and by commands, raw field (tesla) and force (m/s²), spaced in angle."""
        self._tested = 0  # number of rows at the last test

    def add(self, pair: Pair, command: float = 0.0) -> None:
        """Take the next sample, and the commanded rate (rad/s) at its stamp."""
        stamp, force, rate = pair.field.stamp, pair.imu.force, pair.imu.rate
        if not all(map(math.isfinite, rate)):
            return
        self._has_gyro = self._has_gyro or any(rate)
        about_up = dot(force, rate) / length(force)
        step = stamp - self._newest[0]
        if 0.0 < step <= STREAMS.longest_gyro_step:
            self._turned += 0.5 * step * (about_up + self._newest[1])
            self._commanded += step * command
            self._rate += (about_up - self._rate) * min(step / ROTATION.smoothed, 1.0)
        self._newest = (stamp, about_up)
        angles = self._turned, self._commanded
        gaps = (
            abs(a - b) for last in self._rows[-1:] for a, b in zip(angles, last[:2], strict=True)
        )
        if max(gaps, default=math.inf) >= ROTATION.spacing:
            self._rows.append((*angles, pair.field.field, force))

    def measured(self, progress: Progress) -> MeasuredTurn:
        """Return the turn by the gyro, or without a gyro by the session's compass."""
        coverage = progress.coverage
        if self._has_gyro:
            return MeasuredTurn(self._turned, self._rate, True, coverage.is_complete)
        return MeasuredTurn(coverage.turned, progress.turn_rate, False, coverage.is_complete)

    def objection(self) -> str:
        """Return how the field contradicts the gyro, if so; tests once the robot turned further."""
        if not self._has_gyro or self._tested == len(self._rows):
            return ""
        self._tested = len(self._rows)
        found = objection_to_gyro(*self._angles_and_field())
        why = "the gyro is frozen, or the robot turns faster than the gyro's range"
        return f"{found}: {why}" if found else ""

    def explain(self, fault: Fault, measured: MeasuredTurn, command: float) -> str:
        """Describe a fault at a command in rad/s, with what to check."""
        shown, commanded = math.degrees(measured.rate), math.degrees(command)
        sensor = "gyro" if measured.by_gyro else "compass"
        rates = f"the {sensor} measures {shown:+.0f}°/s at a command of {commanded:+.0f}°/s"
        if fault is Fault.TOO_FAST:
            return f"the robot turns far too fast: {rates}"
        if fault is Fault.WRONG_WAY:
            base = "the base turns the wrong way (angular.z is positive to the left)"
            if not measured.by_gyro:
                return f"{rates}: {base}, or the magnetometer's axes are mirrored"
            short = "the arc is too short to decide by the compass"
            cause = {
                1: f"{base}; the compass agrees with the gyro",
                -1: "the gyro is mirrored, because the compass agrees with the commands",
                0: f"{base}, or the gyro is mirrored; {short}",
            }[self.compass_sense()]
            return f"{rates}: {cause}"
        turned, asked, level = self._angles_and_field()
        if measured.by_gyro and _turns_rather_by(asked, turned, level):
            return f"{rates}, but the field turns: the gyro does not measure the turn"
        remedy = "check the emergency stop, and that the base obeys cmd_vel"
        return f"the robot does not turn: {rates}; {remedy}"

    def compass_sense(self) -> int:
        """Return +1 if the field turns like the gyro, -1 if opposite, 0 if it is unknown.

        The arc may be short.
        """
        turned, _, level = self._angles_and_field()
        with_gyro = _turns_rather_by(turned, -turned, level)
        return with_gyro - _turns_rather_by(-turned, turned, level)

    def _angles_and_field(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return the angles by gyro and commands (n,), and the field in two level axes (n, 2)."""
        if len(self._rows) < 10:
            return np.zeros(0), np.zeros(0), np.zeros((0, 2))
        turned, commanded, field, force = map(np.array, zip(*self._rows, strict=True))
        level = level_rotation(force.mean(axis=0))[:2]
        return turned, commanded, field @ self._to_body.T @ level.T
