"""The record of a drive: sensors averaged over a tenth of a second."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from operator import add

import numpy as np

from magcal_ros.core.geometry.arrays import FloatArray, accumulated, block_means, interpolated
from magcal_ros.core.geometry.vec3 import plus, scaled
from magcal_ros.core.samples.rest import (
    ANGLE,
    COLUMNS,
    FIELD,
    FORCE,
    RATE,
    SPAN,
    SPEED,
    GyroAtRest,
)
from magcal_ros.core.samples.samples_tuning import RECORDER, STREAMS
from magcal_ros.core.samples.streams import ImuSample, ImuSpan, Pair
from magcal_ros.core.samples.window import Steps, Window, steps_of


def log_of(window: Window) -> Window:
    """Average a window with a gyro, as `DriveRecorder` does."""
    assert window.angular_rate is not None
    block = ((window.time - window.time[0]) / RECORDER.row).astype(int)
    first = np.flatnonzero(np.diff(block, prepend=-1))
    log = Window(
        block_means(window.time, first),
        block_means(window.field, first),
        block_means(window.specific_force, first),
        block_means(window.angular_rate, first),
        sigma_before=window.bias_sigma,
        speed=None if window.speed is None else block_means(window.speed, first),
        longest_step=STREAMS.longest_field_gap,
    )
    if window.missed is None:
        return log
    sums = (block_means(accumulated(each), first) for each in window.steps)
    return log.with_steps(Steps(*(np.diff(each, axis=0) for each in sums)))


RESTED, WIDTH = COLUMNS, COLUMNS + 1
"""Columns of the rows of a drive, in addition to those of all samples in rows."""

CHUNKS_OF_REST = 5  # chunks over which a rest is detected
LONGEST_SILENCE = CHUNKS_OF_REST * RECORDER.chunk * RECORDER.row  # seconds between two pairs


@dataclass
class _Rest:
    """The gyro's rate at rest."""

    clock: float  # of the drive when the rest began, minus infinity before any movement
    rate: FloatArray
    sigma: float  # of the rate when the rest began
    chunks: int  # in the mean rate


class DriveRecorder:
    """Averages samples into rows, and keeps those of the last `seconds` of movement.

    Its clock runs while the robot moves: pauses are cut out. A jump of time, or a gap longer than
    it takes to detect a rest, ends a piece of the drive; the next piece follows on the clock. A
    piece too short to detect a rest is dropped. `start` is the clock's start, seconds, NaN before
    the first movement; `rests` is whether the robot rested in the last second.
    """

    def __init__(self, seconds: float) -> None:
        self._most = int(seconds / (RECORDER.row * RECORDER.chunk)) + 1
        self.begin_anew()

    def begin_anew(self) -> None:
        """Forget the drive."""
        self._chunks: deque[FloatArray] = deque(maxlen=self._most)
        self._recent: deque[FloatArray] = deque(maxlen=CHUNKS_OF_REST)
        self._held: deque[FloatArray] = deque()
        self._rested: deque[_Rest] = deque(maxlen=RECORDER.rests)
        self._newest, self._pause = -math.inf, 0.0
        self._begin_piece()

    def _begin_piece(self) -> None:
        # A piece that was too short to show a rest is dropped.
        if len(self._recent) < CHUNKS_OF_REST:
            for _ in self._recent:
                self._chunks.pop()
            if not self._chunks:
                self.start = math.nan
        self._rows: list[FloatArray] = []
        self._recent.clear()
        self._held.clear()
        self._samples: list[tuple[float, ...]] = []
        self._row = -math.inf  # stamp at which the row of these samples began
        self._imu: ImuSample | None = None
        self._path, self._path_of_row = [0.0] * 7, np.full(7, math.nan)
        self.rests = False

    @property
    def clock(self) -> float:
        """Time of the newest row that is kept, seconds; minus infinity before the first."""
        return float(self._chunks[-1][-1, 0]) if self._chunks else -math.inf

    @property
    def seconds(self) -> float:
        """Seconds of movement that are kept."""
        return self.clock - float(self._chunks[0][0, 0]) if self._chunks else 0.0

    @property
    def moved(self) -> float:
        """Seconds of movement since the beginning, including rows no longer kept."""
        return self.clock - self.start if self._chunks else 0.0

    def add(self, pair: Pair, speed: float = math.nan) -> bool:
        """Add a pair whose IMU has a rate, and the speed, m/s; NaN if it is not measured.

        Returns whether the log has grown.
        """
        stamp, imu = pair.field.stamp, pair.imu
        if not 0.0 <= stamp - self._newest <= LONGEST_SILENCE:
            self._begin_piece()
            # The remaining gap is too long for the gyro to be integrated across it.
            hole = 2.0 * STREAMS.longest_gyro_step
            self._pause = stamp - self.clock - hole if self._chunks else 0.0
        self._newest = stamp
        grown = False
        if stamp >= self._row + RECORDER.row:
            grown = self._close()
            self._row = stamp
        self._go_on(pair)
        row = (stamp, *pair.field.field, *imu.force, *imu.rate, *self._path, speed, 0.0)
        self._samples.append(row)
        return grown

    def _go_on(self, pair: Pair) -> None:
        """Integrate the IMU up to a pair, from the beginning of the piece."""
        last, imu, span = self._imu, pair.imu, pair.span
        self._imu = imu
        if last is None:
            return
        if span is None:
            half = 0.5 * (imu.stamp - last.stamp)
            angle = scaled(plus(last.rate, imu.rate), half)
            span = ImuSpan(angle, scaled(plus(last.force, imu.force), half), 1)
        step = (*span.angle, *span.velocity, float(span.intervals))
        self._path = list(map(add, self._path, step))

    def log(self) -> Window:
        """Return all rows that are kept, a tenth of a second each, by the drive's clock.

        The gyro's bias at the rests, interpolated between them, is subtracted from the rates.
        """
        rows = np.concatenate(list(self._chunks)) if self._chunks else np.zeros((0, WIDTH))
        time, rate, sigma = rows[:, 0], rows[:, RATE], math.inf
        if self._rested:
            # A rest before any movement counts from the start of the movement.
            first = time[0] if len(time) else 0.0
            clocks = np.maximum([rest.clock for rest in self._rested], first)
            biases = np.array([rest.rate for rest in self._rested])
            rate = rate - interpolated(time, clocks, biases)
            sigma = GyroAtRest(biases[-1].tolist(), self._rested[-1].sigma).later_sigma
            step = np.diff(time, prepend=first)[:, None]
            rows[:, ANGLE] -= (rows[:, RATE] - rate) * step
            rows[:, RATE] = rate
        log = Window(
            time,
            rows[:, FIELD],
            rows[:, FORCE],
            rows[:, RATE],
            sigma_before=sigma,
            speed=rows[:, SPEED] if np.isfinite(rows[:, SPEED]).any() else None,
            rested=rows[:, RESTED] > 0.0,
            longest_step=STREAMS.longest_field_gap,
        )
        return log.with_steps(steps_of(rows))

    def _close(self) -> bool:
        """Finish a row, and a full chunk; return whether the log has grown."""
        if self._samples:
            row = np.mean(self._samples, axis=0)
            path = row[SPAN].copy()
            row[SPAN] -= self._path_of_row
            self._rows.append(row)
            self._samples, self._path_of_row = [], path
        if len(self._rows) < RECORDER.chunk:
            return False
        chunk = np.array(self._rows)
        self._rows.clear()
        self._recent.append(chunk)
        rested, self.rests = self.rests, self._is_quiet(field_too=not self.rests)
        if self.rests:
            self._note_rest(chunk, begins=not rested)
            return False
        for each in self._held:
            self._keep(each)
        self._held.clear()
        self._keep(chunk)
        return True

    def _note_rest(self, chunk: FloatArray, *, begins: bool) -> None:
        """Add a chunk at rest; the beginning and the end of a rest are kept."""
        if begins:
            means = np.array([each[:, RATE].mean(axis=0) for each in self._recent])
            sigma = math.sqrt(float(np.mean(means.var(axis=0, ddof=1))) / len(means))
            self._rested.append(_Rest(self.clock, means.mean(axis=0), sigma, len(means)))
            for each in self._recent:
                each[:, RESTED] = 1.0
        else:
            # The mean is over the newest chunks, because a bias drifts.
            rest = self._rested[-1]
            rest.chunks = min(rest.chunks + 1, RECORDER.rest_chunks)
            rest.rate = rest.rate + (chunk[:, RATE].mean(axis=0) - rest.rate) / rest.chunks
            # A changing field, by a switch or added iron, is not marked as a rest.
            chunk[:, RESTED] = (_changes(chunk[:, FIELD]) < RECORDER.rest_field).all()
        self._held.append(chunk)
        if len(self._held) >= CHUNKS_OF_REST:
            gone = self._held.popleft()
            self._held[0][0, SPAN] = math.nan
            self._pause += float(gone[-1, 0] - gone[0, 0]) + RECORDER.row

    def _keep(self, chunk: FloatArray) -> None:
        """Store a chunk with stamps of the drive's clock."""
        stamps = chunk[:, 0] - self._pause
        if self._chunks:
            last = float(self._chunks[-1][-1, 0])
            # A pause that was cut out leaves no gap; missing samples leave one.
            early = last + RECORDER.row - float(stamps[0])
            if early > 0.0 or (self._pause > 0.0 and -early < STREAMS.longest_gyro_step):
                stamps = stamps + early
                self._pause -= early
        chunk[:, 0] = stamps
        if math.isnan(self.start):
            self.start = float(stamps[0])
        self._chunks.append(chunk)

    def _is_quiet(self, *, field_too: bool) -> bool:
        """Whether turn rate, force and speed were those of a rest in the last seconds."""
        if len(self._recent) < CHUNKS_OF_REST:
            return False
        rows = np.concatenate(list(self._recent))
        if (np.abs(rows[-RECORDER.chunk :, SPEED]) > RECORDER.rest_speed).any():
            return False
        # A rest begins with a constant field; later, iron may be added to the resting robot.
        return bool(
            (_changes(rows[:, RATE]) < RECORDER.rest_rate).all()
            and (rows[:, FORCE].std(axis=0) < RECORDER.rest_force).all()
            and (not field_too or (_changes(rows[:, FIELD]) < RECORDER.rest_field).all())
        )


def _changes(values: FloatArray) -> FloatArray:
    """Return the difference of both halves of values (n, 3) plus weighted spread, shape (3,)."""
    half = len(values) // 2
    gap = np.abs(values[:half].mean(axis=0) - values[half:].mean(axis=0))
    return np.asarray(gap + RECORDER.rest_noise * values.std(axis=0))
