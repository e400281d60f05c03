"""Collects the samples of one turn and decides when the turn is over; time is passed in.

A session takes pairs of samples and computes the coverage, and the reason for the end. It does not
fit: its owner passes the window to a method.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum

import numpy as np

from magcal_ros.core.errors import Reason, Refusal
from magcal_ros.core.geometry.arrays import FloatArray, IntArray
from magcal_ros.core.knowledge import Knowledge, Mounting
from magcal_ros.core.samples.coverage import Coverage, thin_to_equal_angles, yaw_progress
from magcal_ros.core.samples.rest import (
    COLUMNS,
    FIELD,
    FORCE,
    RATE,
    SPAN,
    SPEED,
    GyroAtRest,
    without_rests,
)
from magcal_ros.core.samples.samples_tuning import COVERAGE, STREAMS
from magcal_ros.core.samples.streams import Pair
from magcal_ros.core.samples.window import Window, steps_of
from magcal_ros.core.session.session_tuning import SESSION

NO_SPAN = (math.nan,) * 7

SET_BACK = "the time was set back during the turn; earlier samples were left out"
SET_AHEAD = (
    "the time was set ahead by more than an hour during the turn; earlier samples were left out"
)


TURN_NOT_MEASURED = (
    "; if the robot did turn, `magcal doctor` finds the sensor that does not measure it: the field "
    "may be too steep for a compass here, the magnetometer may not measure it, or the gyro has "
    "another axis"
)


@dataclass(frozen=True)
class Limits:
    """Limits at which a session ends automatically."""

    timeout: float = 90.0  # steady-clock seconds after which the samples so far are used
    silence: float = 10.0  # seconds without a usable pair after which the session ends
    smallest_arc: float = math.radians(45.0)  # radians below which a turn is refused without a fit
    target_sigma: float = math.radians(0.5)  # predicted heading sigma at which a turn ends, radians


@dataclass(frozen=True)
class TurnRequest:
    """The request for a turn."""

    limits: Limits
    knowledge: Knowledge
    method: str
    """One of `magcal_ros.core.calibrate.METHODS`."""
    accumulate: bool
    speed: float | None = None  # rad/s of a robot that turns itself; None if the user turns it
    gyro: GyroAtRest | None = None  # bias of the gyro from a rest before the turn


class Stage(str, Enum):
    """The stage of a session."""

    COLLECTING = "collecting"
    COMPLETE = "complete"
    TIMED_OUT = "timed_out"
    SILENT = "silent"


@dataclass(frozen=True)
class Progress:
    """The progress of a session."""

    stage: Stage  # whether the session is over, and why
    coverage: Coverage
    samples: int
    elapsed: float  # seconds since the start on a steady clock
    turn_rate: float  # rad/s over the last two seconds, left positive; zero if not known
    heading_sigma: float = math.inf  # predicted, radians; infinite without a prediction

    @property
    def in_words(self) -> str:
        """The progress in one line for the user."""
        arc = math.degrees(self.coverage.arc)
        line = f"{arc:.0f}° of the turn measured, {self.samples} samples"
        if math.isfinite(self.heading_sigma):
            line += f", heading ±{math.degrees(self.heading_sigma):.2f}°"
        hole = self.coverage.hole_in_words
        return f"{line}; {hole}" if hole else line

    def require_arc(self, smallest: float) -> None:
        """Raise a Refusal for a turn of less than `smallest` radians."""
        if self.coverage.arc < smallest:
            stood = not self.coverage.has_turned
            raise Refusal(
                Reason.NO_MOTION if stood else Reason.ARC_TOO_SHORT,
                f"the turn is too short: {self.in_words}. Turn the robot a full circle"
                f"{TURN_NOT_MEASURED if stood else ''}",
            )


class Session:
    """Collects one turn.

    `mounting` is needed for the angle about the up vector, `now` is in seconds on a steady clock,
    and `gyro` is from a rest before the turn. `longer` multiplies the size of the buffer.
    `restarted` says how the stamps jumped, if they did; the samples before that are left out.
    """

    def __init__(
        self,
        limits: Limits,
        mounting: Mounting,
        now: float,
        gyro: GyroAtRest | None = None,
        longer: int = 1,
    ) -> None:
        self.limits, self._gyro = limits, gyro
        self._to_body = mounting.to_body
        self._started = self._last_pair = self._last_turning = now
        # The system provides the memory of a row when it is used.
        self._buffer = np.empty((longer * SESSION.largest_buffer, COLUMNS))
        self._currents: list[tuple[float, float]] = []
        self._size = 0
        self._sigma, self._seen = math.inf, 0.0
        self.restarted = ""

    @property
    def has_samples(self) -> bool:
        """Whether there is a pair."""
        return self._size > 0

    @property
    def newest(self) -> float:
        """Stamp of the newest pair, seconds; minus infinity before the first."""
        return float(self._buffer[self._size - 1, 0]) if self._size else -math.inf

    def jump(self, stamp: float) -> str:
        """Say how the time was set between the newest pair and a stamp; empty if it was not."""
        if stamp < self.newest:
            return SET_BACK
        is_ahead = self._size > 0 and stamp - self.newest > STREAMS.longest_pause
        return SET_AHEAD if is_ahead else ""

    def add(self, pair: Pair, now: float, speed: float = math.nan) -> None:
        """Take a pair, and the speed of the wheels, m/s ahead; NaN if it is not measured.

        A pair with the newest stamp is left out. After a jump of the stamps, by a clock or a
        looping bag, the robot may have moved in between, so the turn starts again.
        """
        stamp, newest = pair.field.stamp, self.newest
        if stamp == newest:
            return
        if jump := self.jump(stamp):
            self._size = 0
            self._currents.clear()
            self._sigma, self._seen = math.inf, 0.0
            self.restarted = jump
        if self._size == len(self._buffer):
            self._thin_out()
        imu, span = pair.imu, pair.span
        since = NO_SPAN if span is None else (*span.angle, *span.velocity, span.intervals)
        self._buffer[self._size] = (stamp, *pair.field.field, *imu.force, *imu.rate, *since, speed)
        self._size += 1
        self._last_pair = now

    def note_currents(self, *messages: tuple[float, float]) -> None:
        """Take the battery's stamps (s) and currents (A); a repeated message counts once."""
        self._currents += [each for each in messages if each not in self._currents[-1:]]

    def note_sigma(self, sigma: float, turned: float) -> None:
        """Take the heading sigma that a fit predicts, and the angle that was turned before it.

        Both are in radians.
        """
        self._sigma, self._seen = sigma, abs(turned)

    @property
    def covers_whole_turn(self) -> bool:
        """Whether a predicted sigma is of a whole turn."""
        return self._seen >= math.tau - COVERAGE.largest_gap

    def progress(self, now: float) -> Progress:
        """Return the progress at `now`, seconds on the same steady clock as the start."""
        rows = self._buffer[: self._size : 1 + self._size // SESSION.enough_for_progress]
        angle = self._angle(rows)
        coverage = Coverage.nothing() if angle is None else Coverage.of(angle)
        flows = self.has_samples and now - self._last_pair < SESSION.rest
        rate = _turn_rate(rows[:, 0], angle) if angle is not None and flows else 0.0
        if abs(rate) > SESSION.slowest_turn:
            self._last_turning = now
        stage = self._stage(coverage, now)
        elapsed = now - self._started
        return Progress(stage, coverage, self._size, elapsed, rate, self._sigma)

    def window(self) -> Window:
        """Return the samples of the turn, thinned to equal angles, and its rests."""
        if not self._size:
            raise Refusal(
                Reason.TOO_FEW_SAMPLES,
                "no pair of field and acceleration samples has arrived; check both topics",
            )
        rows = np.array(self._buffer[: self._size])
        if _rate_if_any(rows) is None:
            rows, rests, _ = without_rests(rows)
            rows = rows[self._kept(rows)]
            window = Window(rows[:, 0], rows[:, FIELD], rows[:, FORCE], rests=rests)
            return window.with_battery(self._currents)
        rows = rows[np.isfinite(rows[:, RATE]).all(axis=1)]
        rows, rests, sigma = without_rests(rows, self._gyro)
        steps, kept = steps_of(rows), self._kept(rows)
        gaps = [np.diff(rows[each, 0]).max(initial=0.0) for each in (kept, slice(None))]
        if gaps[0] > max(STREAMS.longest_gyro_step, 2.0 * gaps[1]):
            # On long straights of a drive thinning would lose samples of the specific force.
            kept = np.arange(len(rows))
        rows = rows[kept]
        sensors = rows[:, FIELD], rows[:, FORCE], rows[:, RATE]
        speed = rows[:, SPEED] if np.isfinite(rows[:, SPEED]).any() else None
        window = Window(rows[:, 0], *sensors, rests=rests, sigma_before=sigma, speed=speed)
        return window.with_steps(steps.over(kept)).with_battery(self._currents)

    def _kept(self, rows: FloatArray, most: int | None = None) -> IntArray:
        """Return the rows that remain after thinning to equal angles.

        If the angles are unknown, all remain, or at most `most` at equal times.
        """
        angle, time = self._angle(rows), rows[:, 0]
        if angle is not None:
            return thin_to_equal_angles(angle, most)
        if most is None:
            return np.arange(len(rows))
        return np.unique(np.searchsorted(time, np.linspace(time[0], time[-1], most)))

    def _angle(self, rows: FloatArray) -> FloatArray | None:
        field = rows[:, FIELD] @ self._to_body.T
        return yaw_progress(rows[:, 0], field, rows[:, FORCE], _rate_if_any(rows))

    def _stage(self, coverage: Coverage, now: float) -> Stage:
        if coverage.is_complete and self._is_enough(coverage, now):
            return Stage.COMPLETE
        if now - self._last_pair > self.limits.silence:
            return Stage.SILENT
        if now - self._started > self.limits.timeout:
            return Stage.TIMED_OUT
        return Stage.COLLECTING

    def _is_enough(self, coverage: Coverage, now: float) -> bool:
        """Whether a complete turn can end: at the target sigma, after more turning, or at rest."""
        target, turns = self.limits.target_sigma, abs(coverage.turned) / math.tau
        is_near = self._sigma <= SESSION.near * target
        return (
            self._sigma <= target
            or ((is_near or not self.covers_whole_turn) and turns >= SESSION.once_more)
            or turns >= SESSION.most_turns
            or now - self._last_turning > SESSION.rest
        )

    def _thin_out(self) -> None:
        kept = self._kept(self._buffer, most=len(self._buffer) // 2)
        rows = self._buffer[kept]
        rows[1:, SPAN] = np.column_stack(steps_of(self._buffer).over(kept))
        self._buffer[: len(rows)] = rows
        self._size = len(rows)


def _turn_rate(stamps: FloatArray, angle: FloatArray) -> float:
    """Return the mean rate over the last two seconds, rad/s; zero if it is not known."""
    first = int(np.searchsorted(stamps, stamps[-1] - 2.0))
    span = float(stamps[-1] - stamps[first])
    return float(angle[-1] - angle[first]) / span if span > 0.2 else 0.0


def _rate_if_any(rows: FloatArray) -> FloatArray | None:
    """Return the angular rates, zero if missing; None without a gyro (absent or only zeros)."""
    rate = rows[:, RATE]
    finite = np.asarray(np.isfinite(rate).all(axis=1))
    if not len(rate) or finite.mean() < 0.9 or not rate[finite].any():
        return None
    return np.where(finite[:, None], rate, 0.0)
