"""Collects the samples of one turn and decides when it is over; time is passed in.

Paired samples enter, coverage answers how far the turn is, and the session says when it is over
and why. It does not fit: its owner passes the window to a method.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum

import numpy as np

from magcal_ros.core.errors import Reason, Refusal
from magcal_ros.core.geometry.arrays import FloatArray, IntArray
from magcal_ros.core.knowledge import Knowledge, Mounting
from magcal_ros.core.samples.coverage import COVERAGE, Coverage, thin_to_equal_angles, yaw_progress
from magcal_ros.core.samples.rest import (
    COLUMNS,
    FIELD,
    FORCE,
    RATE,
    SPAN,
    SPEED,
    GyroAtRest,
    apart_from_rests,
)
from magcal_ros.core.samples.streams import STREAMS, Pair
from magcal_ros.core.samples.window import Window, steps_of


@dataclass(frozen=True)
class SessionTuning:
    """What a session keeps, and when a turn is taken to be complete."""

    largest_buffer: int = 20_000
    """Pairs. A full buffer is thinned to equal angles, or to equal times without known angles. So
    its size is bounded, however long the robot waits or turns."""
    enough_for_progress: int = 2_000
    """Rows beyond which progress looks at every second, third ... row: it is asked ten times a
    second, between the messages."""
    most_turns: float = 2.0  # full turns after which more hardly shows anything
    near: float = 2.0
    """Times the target up to which turning may end before the target is reached. Far from it the
    surroundings are at fault, and a second round is useful."""
    once_more: float = 1.2  # full turns at which it ends, unless a whole one was beyond `near`
    stands_still: float = 3.0  # seconds at rest, after a complete turn, that end it
    slowest_turn: float = math.radians(3.0)  # rad/s. Slower than this the robot stands.
    preview_arc: float = math.radians(120.0)  # radians of arc for a first prediction
    preview_share: float = 0.25  # share of one core that predictions may take


TUNING = SessionTuning()

NO_SPAN = (math.nan,) * 7


UNSEEN = (
    "; if it did turn, `magcal doctor` finds the sensor that misses it: the field may be too "
    "steep for a compass here, the magnetometer may not measure it, or the gyro has another axis"
)


@dataclass(frozen=True)
class Limits:
    """When a session ends by itself."""

    timeout: float = 90.0  # seconds on a steady clock until whatever was seen is used or refused
    silence: float = 10.0  # seconds without a usable pair after which waiting longer is pointless
    smallest_arc: float = math.radians(45.0)  # radians below which a turn is refused without a fit
    target_sigma: float = math.radians(0.5)  # radians at which a turn is enough


@dataclass(frozen=True)
class Brief:
    """What a turn is opened with."""

    limits: Limits
    knowledge: Knowledge
    method: str
    """One of `magcal_ros.core.calibrate.METHODS`."""
    accumulate: bool
    speed: float | None = None  # rad/s of a robot that turns itself; None if a person turns it
    gyro: GyroAtRest | None = None  # what a rest before the turn has shown of the gyro


class Stage(str, Enum):
    """The stage of a session."""

    COLLECTING = "collecting"
    COMPLETE = "complete"
    TIMED_OUT = "timed_out"
    SILENT = "silent"


@dataclass(frozen=True)
class Progress:
    """How far a session is."""

    stage: Stage  # whether it is over, and why
    coverage: Coverage
    samples: int
    elapsed: float  # seconds since the start on a steady clock
    turn_rate: float  # rad/s over the last seconds, left positive; zero when not known
    heading_sigma: float = math.inf  # radians, as predicted; infinite while not

    @property
    def in_words(self) -> str:
        """One line for a person."""
        arc = math.degrees(self.coverage.arc)
        line = f"{arc:.0f}° of the turn seen, {self.samples} samples"
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
                f"too little of a turn: {self.in_words}. Turn the robot a full circle"
                f"{UNSEEN if stood else ''}",
            )


class Session:
    """Collects one turn.

    `mounting` is needed for the phase about the up vector, `now` is in seconds on a steady clock,
    `gyro` is from a rest before it. The buffer may be `longer` times that of a turn. `was_set_back`
    says whether stamps went back, and what came before was left out.
    """

    def __init__(
        self,
        limits: Limits,
        mounting: Mounting,
        now: float,
        gyro: GyroAtRest | None = None,
        longer: int = 1,
    ) -> None:
        self.limits, self._gyro, self._longer = limits, gyro, longer
        self._to_body = mounting.to_body
        self._started = self._last_pair = self._last_turning = now
        self._buffer = np.empty((1024, COLUMNS))
        self._currents: list[tuple[float, float]] = []
        self._size = 0
        self._turned = self._looked_at = 0.0
        self._sigma, self._seen = math.inf, 0.0
        self.was_set_back = False

    @property
    def has_samples(self) -> bool:
        """Whether any pair has come."""
        return self._size > 0

    @property
    def newest(self) -> float:
        """Stamp of the newest pair, seconds; minus infinity before the first."""
        return float(self._buffer[self._size - 1, 0]) if self._size else -math.inf

    def add(self, pair: Pair, now: float, speed: float = math.nan) -> None:
        """Take a pair, and the speed of the wheels, m/s ahead; NaN where it is not measured.

        One with the stamp of the newest is left out. An older stamp means that time was set back,
        by a clock or by a bag that loops. The robot may have moved meanwhile, so the turn starts
        again.
        """
        stamp, newest = pair.field.stamp, self.newest
        if stamp == newest:
            return
        if stamp < newest:
            self._size, self._turned = 0, 0.0
            self._currents.clear()
            self._sigma, self._seen = math.inf, 0.0
            self.was_set_back = True
        if self._size == len(self._buffer):
            self._thin_out()
        imu, span = pair.imu, pair.span
        since = NO_SPAN if span is None else (*span.angle, *span.velocity, span.intervals)
        self._buffer[self._size] = (stamp, *pair.field.field, *imu.force, *imu.rate, *since, speed)
        self._size += 1
        self._last_pair = now

    def note_currents(self, *messages: tuple[float, float]) -> None:
        """Take messages of the battery, a repeated one once: stamp, seconds, and amperes."""
        self._currents += [each for each in messages if each not in self._currents[-1:]]

    def look(self) -> Window:
        """Return `window`; the heading sigma that its fit predicts comes to `note_sigma`."""
        self._looked_at = self._turned
        return self.window()

    def note_sigma(self, sigma: float) -> None:
        """Take the heading sigma (radians) that a fit of the last look predicts."""
        self._sigma, self._seen = sigma, self._looked_at

    @property
    def was_seen_whole(self) -> bool:
        """Whether a fit has looked at a whole turn."""
        return self._seen >= math.tau - COVERAGE.largest_gap

    def progress(self, now: float) -> Progress:
        """Return how far the turn is at `now`, seconds on the steady clock of the start."""
        rows = self._buffer[: self._size : 1 + self._size // TUNING.enough_for_progress]
        angle = self._angle(rows)
        coverage = Coverage.nothing() if angle is None else Coverage.of(angle)
        self._turned = abs(coverage.turned)
        flows = self.has_samples and now - self._last_pair < TUNING.stands_still
        rate = _turn_rate(rows[:, 0], angle) if angle is not None and flows else 0.0
        if abs(rate) > TUNING.slowest_turn:
            self._last_turning = now
        stage = self._stage(coverage, now)
        elapsed = now - self._started
        return Progress(stage, coverage, self._size, elapsed, rate, self._sigma)

    def window(self) -> Window:
        """Return what was collected of the turn, thinned to equal angles, and its rests."""
        if not self._size:
            raise Refusal(
                Reason.TOO_FEW_SAMPLES,
                "no pair of field and acceleration samples has arrived; check both topics",
            )
        rows = np.array(self._buffer[: self._size])
        if _rate_if_any(rows) is None:
            rows, rests, _ = apart_from_rests(rows)
            rows = rows[self._kept(rows)]
            window = Window(rows[:, 0], rows[:, FIELD], rows[:, FORCE], rests=rests)
            return window.with_battery(self._currents)
        rows = rows[np.isfinite(rows[:, RATE]).all(axis=1)]
        rows, rests, sigma = apart_from_rests(rows, self._gyro)
        steps, kept = steps_of(rows), self._kept(rows)
        gaps = [np.diff(rows[each, 0]).max(initial=0.0) for each in (kept, slice(None))]
        if gaps[0] > max(STREAMS.longest_gyro_step, 2.0 * gaps[1]):
            # A drive is straight for long: of the force there, nothing may be left out.
            kept = np.arange(len(rows))
        rows = rows[kept]
        sensors = rows[:, FIELD], rows[:, FORCE], rows[:, RATE]
        speed = rows[:, SPEED] if np.isfinite(rows[:, SPEED]).any() else None
        window = Window(rows[:, 0], *sensors, rests=rests, sigma_before=sigma, speed=speed)
        return window.with_steps(steps.over(kept)).with_battery(self._currents)

    def _kept(self, rows: FloatArray) -> IntArray:
        """Return which rows stay when they are thinned to equal angles."""
        angle = self._angle(rows)
        if angle is None:
            return np.arange(len(rows))
        return thin_to_equal_angles(angle)

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
        """Whether the turn can end: certain enough, or no longer getting more certain."""
        target, turns = self.limits.target_sigma, abs(coverage.turned) / math.tau
        is_near = self._sigma <= TUNING.near * target
        return (
            self._sigma <= target
            or ((is_near or not self.was_seen_whole) and turns >= TUNING.once_more)
            or turns >= TUNING.most_turns
            or now - self._last_turning > TUNING.stands_still
        )

    def _thin_out(self) -> None:
        largest = self._longer * TUNING.largest_buffer
        if self._size < largest:
            more = np.empty((min(self._size, largest - self._size), COLUMNS))
            self._buffer = np.concatenate([self._buffer, more])
            return
        most = largest // 2
        angle = self._angle(self._buffer)
        if angle is None:
            stamps = self._buffer[:, 0]
            evenly = np.linspace(stamps[0], stamps[-1], most)
            kept = np.unique(np.searchsorted(stamps, evenly))
        else:
            kept = thin_to_equal_angles(angle, most=most)
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
    """Return the angular rates, zero where missing; None without a gyro, absent or unfilled."""
    rate = rows[:, RATE]
    finite = np.asarray(np.isfinite(rate).all(axis=1))
    if not len(rate) or finite.mean() < 0.9 or not rate[finite].any():
        return None
    return np.where(finite[:, None], rate, 0.0)
