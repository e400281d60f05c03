"""Recordings with a truth, their windows, and the fits of usual methods.

The truth is a yaw over time: of motion capture, or the course of a GPS at 1 Hz. A course is late,
and off by one constant (declination, mounting): the delay is found against the gyro's yaw, and the
constant is taken off before anything is counted.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from magcal_ros.core.calibrate import calibrate_drive, predicted_sigma
from magcal_ros.core.calibration.calibration import Calibration
from magcal_ros.core.errors import MagcalError
from magcal_ros.core.geometry.arrays import FloatArray, runs
from magcal_ros.core.geometry.attitude import wrap_angle, yaw_from_up_and_field
from magcal_ros.core.geometry.rotations import minimal_rotation
from magcal_ros.core.geometry.shapes import QuadricFit, fit_circle, fit_quadric
from magcal_ros.core.knowledge import Knowledge, knowledge_of
from magcal_ros.core.samples.bursts import spread_bursts
from magcal_ros.core.samples.drive_log import log_of
from magcal_ros.core.samples.rest import GyroAtRest
from magcal_ros.core.samples.samples_tuning import STREAMS
from magcal_ros.core.samples.streams import ImuSample, Pair, Pairer, Streams
from magcal_ros.core.samples.window import Window
from magcal_ros.core.session.session import Limits, Session, Stage
from magcal_ros.core.up.follower import UpFollower, propagated_up
from magcal_ros.files.recording import Recording, read_csv_folder

PLACES = (("Boston", 51.3, 66.3), ("Northeastern", 51.3, 66.3), ("BROAD", 44.3, 69.6))
"""Words of a README that give the place of a recording: µT and degrees of dip."""
TURNING_RATE = math.radians(5.0)
TURNING_MEAN = 10.0
"""A robot circles where its rate, averaged over so many seconds, is larger."""
STEEPEST = math.radians(45.0)
"""A lean beyond which a heading is not scored."""
LEAST_SCORED = 15
LOOK_EVERY, PREVIEW_EVERY = 0.5, 3.0

Heading = Callable[[FloatArray, FloatArray], FloatArray]
"""From up (n, 3) and raw field (n, 3) to yaw (n,), radians."""


@dataclass(frozen=True)
class Score:
    """Yaw against truth after one constant is taken off: degrees, RMS and median of the size."""

    rms: float
    median: float


@dataclass(frozen=True, eq=False)
class Truth:
    """Stamps (s), yaw (rad); `is_course` where it comes late, from positions."""

    time: FloatArray
    yaw: FloatArray
    is_course: bool


@dataclass(frozen=True, eq=False)
class Drive:
    """One recording."""

    name: str
    recording: Recording
    truth: Truth | None
    knowledge: Knowledge

    @cached_property
    def pairs(self) -> list[Pair]:
        """Field samples with the IMU at their stamps, cleaned as in the node."""
        streams = Streams(STREAMS.max_gap)
        pairer = Pairer(streams)
        found: list[Pair] = []
        for sample in self.recording.samples():
            if isinstance(sample, ImuSample):
                streams.add_imu(sample)
            elif streams.add_field(sample) and not streams.is_repeated:
                pairer.offer(sample)
                found += pairer.take()
        return found + pairer.take()

    @cached_property
    def everything(self) -> Window:
        """All pairs whose stamps increase."""
        time = np.array([pair.field.stamp for pair in self.pairs])
        rows = np.flatnonzero(np.diff(np.maximum.accumulate(time), prepend=-math.inf) > 0.0)
        pairs = [self.pairs[row] for row in rows]
        rate = np.array([pair.imu.rate for pair in pairs])
        return Window(
            time[rows],
            np.array([pair.field.field for pair in pairs]),
            np.array([pair.imu.force for pair in pairs]),
            rate if np.isfinite(rate).all() else None,
        )

    @cached_property
    def up(self) -> FloatArray:
        """Up at every pair, shape (n, 3)."""
        return propagated_up(self.everything)

    @cached_property
    def gyro_yaw(self) -> FloatArray | None:
        """The gyro's turn about up, radians, shape (n,); None without a gyro."""
        window = self.everything
        if window.angular_rate is None:
            return None
        rate = np.sum(window.angular_rate * self.up, axis=1)
        steps = 0.5 * (rate[1:] + rate[:-1]) * np.diff(window.time)
        return np.concatenate([[0.0], np.cumsum(steps)])

    @cached_property
    def delay(self) -> float:
        """Latency of the truth, seconds: the one with the smallest residual of the gyro's yaw."""
        if self.truth is None or not self.truth.is_course or self.gyro_yaw is None:
            return 0.0
        delays = np.arange(0.0, 1.6, 0.05)
        return float(min(delays, key=lambda delay: np.median(np.abs(self._drifted(delay)))))

    def floor(self) -> Score | None:
        """Return the error of the gyro alone, without a linear drift."""
        if self.truth is None or self.gyro_yaw is None:
            return None
        return _score(self._drifted(self.delay))

    def score(
        self, heading: Heading, up: FloatArray | None = None, since: float = -math.inf
    ) -> Score | None:
        """Return the error of a heading by an up (n, 3) from a stamp on, by default of all."""
        if self.truth is None:
            return None
        yaw = heading(self.up if up is None else up, self.everything.field)
        gap, _ = self._gap(np.unwrap(yaw), self.delay, since)
        return _score(gap) if len(gap) >= LEAST_SCORED else None

    def _gap(
        self, yaw: FloatArray, delay: float, since: float = -math.inf
    ) -> tuple[FloatArray, FloatArray]:
        """Return yaw minus truth without its mean, and its stamps, which are after `since`."""
        assert self.truth is not None
        stamps = self.everything.time
        time = self.truth.time - delay
        lean = np.interp(time, stamps, np.arccos(np.clip(self.up[:, 2], -1.0, 1.0)))
        seen = (time > max(stamps[0], since)) & (time < stamps[-1]) & (lean < STEEPEST)
        gap = np.interp(time[seen], stamps, yaw) - self.truth.yaw[seen]
        return wrap_angle(gap - np.angle(np.mean(np.exp(1j * gap)))), time[seen]

    def _drifted(self, delay: float) -> FloatArray:
        assert self.gyro_yaw is not None
        gap, time = self._gap(self.gyro_yaw, delay)
        gap = np.unwrap(gap)
        rows = np.column_stack([np.ones_like(time), time - time.mean()])
        weight = np.ones_like(gap)
        for _ in range(10):
            found = np.linalg.lstsq(rows * weight[:, None], gap * weight, rcond=None)[0]
            left = gap - rows @ found
            weight = 1.0 / np.sqrt(1.0 + (left / (2.0 * np.median(np.abs(left)) + 1e-6)) ** 2)
        return np.asarray(left)


def _score(gap: FloatArray) -> Score:
    rms = math.degrees(math.sqrt(float(np.mean(gap**2))))
    return Score(rms, math.degrees(float(np.median(np.abs(gap)))))


def read_drive(folder: Path, field: tuple[float, float] | None) -> Drive:
    """Read a folder with imu.csv, mag.csv and, where there is a truth, truth.csv."""
    text = (folder / "README.md").read_text() if (folder / "README.md").exists() else ""
    if field is None:
        field = next((place[1:] for place in PLACES if place[0] in text), None)
    known = Knowledge() if field is None else knowledge_of(field[0], inclination_deg=field[1])
    path, recording = folder / "truth.csv", read_csv_folder(folder)
    for table in (recording.imu, recording.field):
        even = spread_bursts(table[:, 0])
        table[:, 0] = table[:, 0] if even is None else even
    return Drive(folder.name, recording, _read_truth(path) if path.exists() else None, known)


def _read_truth(path: Path) -> Truth:
    table = np.genfromtxt(path, delimiter=",", names=True, dtype=None, encoding="utf-8")
    keep = np.asarray(table["valid"], dtype=bool)
    is_course = "speed" in (table.dtype.names or ())
    if is_course:
        keep &= table["speed"] > 2.0
    return Truth(table["t"][keep].astype(float), table["yaw"][keep].astype(float), is_course)


def windows(drive: Drive) -> Iterator[tuple[str, Window | MagcalError]]:
    """Yield the windows to be fitted: the whole file, its circles, and what the node would take."""
    yield "whole", _session_window(drive.pairs)
    span = turning_span(drive)
    if span is not None:
        yield "circles", _session_window([p for p in drive.pairs if _within(p, span)])
    yield "live", _live_window(drive.pairs, drive.knowledge)


def asked_on_the_way(drive: Drive, every: float) -> Iterator[tuple[str, Window | MagcalError]]:
    """Yield the windows of the node in repeated turns, with seconds from the start."""
    stamps = np.array([pair.field.stamp for pair in drive.pairs])
    up, received = UpFollower(), 0
    for moment in np.arange(0.0, float(np.ptp(stamps)) if len(stamps) else 0.0, every):
        first = int(np.searchsorted(stamps, stamps[0] + moment))
        for pair in drive.pairs[received:first]:
            up.add(pair.imu)
            up.add_field(pair.field.stamp, pair.field.field)
        received = first
        yield "asked", _live_window(drive.pairs[first:], drive.knowledge, up.gyro_at_rest)


def _within(pair: Pair, span: tuple[float, float]) -> bool:
    return span[0] <= pair.field.stamp <= span[1]


def _session_window(pairs: list[Pair]) -> Window | MagcalError:
    session = Session(Limits(), Knowledge().mounting, 0.0)
    for pair in pairs:
        session.add(pair, 0.0)
    return _taken(session)


def _taken(session: Session) -> Window | MagcalError:
    try:
        window = session.window()
        session.progress(0.0).require_arc(session.limits.smallest_arc)
    except MagcalError as refusal:
        return refusal
    return window


def turning_span(drive: Drive) -> tuple[float, float] | None:
    """Return first and last stamp of the longest stretch of circles; None if all of it is one."""
    if drive.gyro_yaw is None or len(drive.pairs) < 20:
        return None
    time = drive.everything.time
    half = 0.5 * TURNING_MEAN
    ahead, behind = (np.interp(time + way, time, drive.gyro_yaw) for way in (half, -half))
    turning = np.abs(ahead - behind) > TURNING_RATE * TURNING_MEAN
    found = [(begin, end - 1) for begin, end in runs(turning)]
    longest = max(found, key=lambda run: time[run[1]] - time[run[0]], default=None)
    if longest is None:
        return None
    first, last = float(time[longest[0]]), float(time[longest[1]])
    turned = abs(float(drive.gyro_yaw[longest[1]] - drive.gyro_yaw[longest[0]]))
    covers = last - first > 0.95 * (time[-1] - time[0])
    return None if turned < math.tau or covers else (first, last)


def _live_window(
    pairs: list[Pair], knowledge: Knowledge, gyro: GyroAtRest | None = None
) -> Window | MagcalError:
    """Return the window of a calibration that starts with the first of the samples."""
    if not pairs:
        return _session_window([])
    start = pairs[0].field.stamp
    session = Session(Limits(), knowledge.mounting, start, gyro)
    look = preview = start
    for pair in pairs:
        now = pair.field.stamp
        session.add(pair, now)
        if now < look + LOOK_EVERY:
            continue
        look = now
        progress = session.progress(now)
        if progress.stage is not Stage.COLLECTING:
            break
        if progress.coverage.is_complete and now >= preview + PREVIEW_EVERY:
            preview = now
            sigma = predicted_sigma(session.window(), knowledge)
            session.note_sigma(sigma, progress.coverage.turned)
    return _taken(session)


def peers(window: Window) -> dict[str, Heading | None]:
    """Fit the usual methods to the same samples with the same up; None if a fit fails."""
    up = propagated_up(window)
    ways: dict[str, Callable[[FloatArray, FloatArray], Heading]] = {
        "minmax2": _min_max_level,
        "minmax3": _min_max,
        "sphere": lambda _, field: _quadric(field, QuadricFit.SPHERE),
        "circle": _levelled_circle,
        "ellipsoid": lambda _, field: _quadric(field, QuadricFit.ROTATED),
    }
    return {name: _or_none(way, up, window.field) for name, way in ways.items()}


def _or_none(
    way: Callable[[FloatArray, FloatArray], Heading], up: FloatArray, field: FloatArray
) -> Heading | None:
    try:
        return way(up, field)
    except (MagcalError, np.linalg.LinAlgError):
        return None


def levelled(up: FloatArray, field: FloatArray) -> FloatArray:
    """Return the field (n, 2) in the level plane, each sample turned the shortest way."""
    z = np.array([0.0, 0.0, 1.0])
    return np.array([(minimal_rotation(u, z) @ m)[:2] for u, m in zip(up, field, strict=True)])


def _around(centre: FloatArray, gains: FloatArray) -> Heading:
    def heading(up: FloatArray, field: FloatArray) -> FloatArray:
        x, y = ((levelled(up, field) - centre) * gains).T
        return np.asarray(np.arctan2(x, y))

    return heading


def _min_max_level(up: FloatArray, field: FloatArray) -> Heading:
    level = levelled(up, field)
    low, high = level.min(axis=0), level.max(axis=0)
    return _around(0.5 * (low + high), 2.0 / (high - low))


def _levelled_circle(up: FloatArray, field: FloatArray) -> Heading:
    return _around(fit_circle(levelled(up, field))[0], np.ones(2))


def _min_max(_: FloatArray, field: FloatArray) -> Heading:
    low, high = field.min(axis=0), field.max(axis=0)
    centre, gains = 0.5 * (low + high), 2.0 / (high - low)
    return lambda up, raw: yaw_from_up_and_field(up, (raw - centre) * gains)


def _quadric(field: FloatArray, shape: QuadricFit) -> Heading:
    found = fit_quadric(field, shape)
    return lambda up, raw: yaw_from_up_and_field(up, (raw - found.centre) @ found.to_unit_sphere.T)


def in_force(drive: Drive) -> Iterator[tuple[Calibration, str]]:
    """Yield possible calibrations in force: fitted to the whole drive."""
    found = calibrate_drive(log_of(drive.everything), drive.knowledge).calibration
    if found is not None:
        yield found, "its own in force"
