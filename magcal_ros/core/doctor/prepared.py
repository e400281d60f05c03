"""Prepare a log for the comparison of its sensors, and average the part with the most turns."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass, replace

import numpy as np

from magcal_ros.core.doctor import health
from magcal_ros.core.doctor.doctor_tuning import HEALTH, TURN, WIDE
from magcal_ros.core.doctor.finding import Finding, ok_or_severe, ok_or_warning
from magcal_ros.core.geometry.arrays import (
    BoolArray,
    FloatArray,
    accumulated,
    block_means,
    integral,
    interpolated,
    runs,
)
from magcal_ros.core.geometry.attitude import usual_size
from magcal_ros.core.samples.bursts import bursts_in_words, spread_bursts, spread_each
from magcal_ros.core.samples.samples_tuning import COMPLAINTS, RECORDER, STREAMS
from magcal_ros.core.samples.units import NOT_NUMBERS, NOTHING_READ, gravity_size
from magcal_ros.core.samples.window import SensorLog, is_noiseless


def means_between(time: FloatArray, values: FloatArray, edges: FloatArray) -> FloatArray:
    """Return the means (k, 3) between neighbouring edges (k + 1,); NaN if there are no values."""
    total = accumulated(values)
    rows = np.searchsorted(time, edges)
    number = np.diff(rows)
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray(np.diff(total[rows], axis=0) / number[:, None])


@dataclass(frozen=True, eq=False)
class CleanLog:
    """A log of finite samples with increasing stamps, without duplicates, and its findings."""

    log: SensorLog  # the remaining samples
    findings: tuple[Finding, ...]  # faults of each stream by itself, and of the clocks
    restamped: bool  # whether stamps came in bursts and were spread evenly

    @property
    def is_short(self) -> bool:
        """Whether there are too few samples to compare the sensors."""
        return min(len(self.log.imu_time), len(self.log.field_time)) < 3


def prepare(log: SensorLog) -> CleanLog:
    """Check each stream of a log by itself, and clean the log."""
    log = _selected(log, np.isfinite(log.imu_time), np.isfinite(log.field_time))
    # A double of seconds since 1970 has few digits left for a gap.
    first = np.concatenate([log.imu_time, log.field_time]).min(initial=math.inf)
    log = replace(log, imu_time=log.imu_time - first, field_time=log.field_time - first)
    findings: list[Finding] = []
    burst = False
    imu, field = _numbers(log)
    for name, sensor, are_numbers in (("imu", "IMU", imu), ("field", "field", field)):
        time = getattr(log, f"{name}_time")
        increasing = np.unique(time)
        if are_numbers.sum() <= HEALTH.fewest or len(increasing) <= HEALTH.fewest:
            continue
        findings.append(health.stamps_finding(sensor, increasing))
        lost = 1.0 - float(are_numbers.mean())
        if lost > COMPLAINTS.worth_a_word:
            words = f"{lost:.0%} not finite", NOT_NUMBERS
            findings.append(ok_or_warning("not_finite", f"{sensor}: numbers", *words))
        if bursts_in_words(increasing):
            burst = True
            even = spread_bursts(time)
            log = replace(log, **{f"{name}_time": spread_each(time) if even is None else even})
    imu &= np.linalg.norm(log.force, axis=1) > 0.0
    field &= np.linalg.norm(np.where(field[:, None], log.field, 0.0), axis=1) > 0.0
    for sensor, usable in (("IMU", imu), ("field", field)):
        if usable.sum() <= HEALTH.fewest < len(usable):
            about = f"{sensor}: values", f"{usable.sum()} of {len(usable)} samples hold a value"
            findings.append(ok_or_severe("no_values", *about, NOTHING_READ))
    log = _selected(log, imu, field)
    clean = _without_duplicates(log)
    if len(log.field) > HEALTH.fewest:
        findings += [*health.field_findings(log.field), health.repeats_finding("field", log.field)]
    if len(log.force) > HEALTH.fewest:
        both = np.column_stack([log.force, np.nan_to_num(log.rate)])
        rate = clean.rate if clean.has_gyro else None
        size = gravity_size(clean.imu_time, clean.force, rate)
        findings.append(health.gravity_size_finding(clean.force, size))
        findings.append(health.repeats_finding("IMU", both))
        findings.append(health.alive_finding("accelerometer", log.force))
        if log.has_gyro and not is_noiseless(log.rate):
            findings.append(health.alive_finding("gyro", log.rate, log.force))
    if min(len(clean.force), len(clean.field)) > HEALTH.fewest:
        clean, clocks = on_one_clock(clean)
        findings += clocks
    clean, more = _without_frozen(clean)
    if more:
        findings = [f for f in findings if f.key != "frozen" or f.is_wrong] + more
    return CleanLog(clean, tuple(findings), burst)


def _numbers(log: SensorLog) -> tuple[BoolArray, BoolArray]:
    """Return which samples of IMU (n,) and field (m,) are finite; an absent gyro is no fault."""
    measured = np.column_stack([log.force, log.rate]) if log.has_gyro else log.force
    # Drivers mark invalid samples by enormous numbers, whose squares overflow.
    with np.errstate(over="ignore", invalid="ignore"):
        field = np.linalg.norm(log.field, axis=1)
    return np.asarray(np.isfinite(measured).all(axis=1)), np.isfinite(field)


def _selected(log: SensorLog, imu: BoolArray, field: BoolArray) -> SensorLog:
    return SensorLog(
        log.imu_time[imu], log.force[imu], log.rate[imu], log.field_time[field], log.field[field]
    )


def _without_duplicates(log: SensorLog) -> SensorLog:
    """Leave out repeated and saturated samples, and those whose stamps do not increase."""
    held = np.zeros(len(log.field), dtype=np.bool_)
    if len(log.field) > HEALTH.fewest:
        for axis in range(3):
            held |= health.saturated(log.field, axis)
    imu = _increasing(log.imu_time)
    field = _increasing(log.field_time) & ~held
    # The driver repeats a sample a few times; a frozen sensor, another fault, repeats it for long.
    field &= ~health.repeats(log.field) | health.in_long_runs(log.field)
    return _selected(log, imu, field)


def _increasing(time: FloatArray) -> BoolArray:
    """Return which rows have a later stamp than all rows before."""
    latest = np.maximum.accumulate(np.append(-np.inf, time))
    return np.asarray(time > latest[:-1])


def _without_frozen(log: SensorLog) -> tuple[SensorLog, list[Finding]]:
    """Find sensors that are frozen during a movement; keep the longest part without them."""
    found = []
    streams = [("accelerometer", log.imu_time, log.force), ("field", log.field_time, log.field)]
    if log.has_gyro and not is_noiseless(log.rate):
        streams.append(("gyro", log.imu_time, log.rate))
    stuck: list[tuple[float, float]] = []
    for name, time, values in streams:
        for first, end in runs(health.repeats(values)):
            span = float(time[first - 1]), float(time[end - 1])
            if span[1] - span[0] > HEALTH.frozen and _moves(log, name, span):
                words = f"one value for {span[1] - span[0]:.1f} s while the robot moved"
                remedy = f"the {name} is frozen: check its wiring, and its driver's error messages"
                found.append(ok_or_severe("frozen", f"{name}: alive", words, remedy))
                stuck.append(span)
                break
    if not stuck:
        return log, found
    ends = log.imu_time[[0, -1]].tolist()
    pieces = itertools.pairwise([ends[0], *sorted(t for span in stuck for t in span), ends[1]])
    free = [(a, b) for a, b in pieces if not any(s <= 0.5 * (a + b) <= e for s, e in stuck)]
    low, high = max(free, key=lambda piece: piece[1] - piece[0], default=(0.0, 0.0))
    imu = (log.imu_time >= low) & (log.imu_time <= high)
    field = (log.field_time >= low) & (log.field_time <= high)
    return _selected(log, imu, field), found


def _moves(log: SensorLog, name: str, span: tuple[float, float]) -> bool:
    """Return whether a sensor other than `name` measures a movement in the span, seconds."""
    if name != "gyro" and log.has_gyro:
        # The first rates are the bias of a robot at rest, unless it already turns.
        first = np.median(log.rate[:50], axis=0)
        turns = np.linalg.norm(first) > TURN.turns
        size = np.linalg.norm(log.rate - np.where(turns, 0.0, first), axis=1)
        inside = (log.imu_time > span[0]) & (log.imu_time < span[1])
        if inside.any() and float((size[inside] > TURN.turns).mean()) > HEALTH.moving:
            return True
    if name == "field" or not len(log.field):
        return False
    inside = (log.field_time > span[0]) & (log.field_time < span[1])
    least = HEALTH.moving * float(np.ptp(log.field, axis=0).max())
    return bool(inside.any() and np.ptp(log.field[inside], axis=0).max() > least)


ONE_CLOCK = (
    "the stamps of IMU and field come from two clocks: stamp both by the ROS clock when they are "
    "measured, and synchronise the clocks of all computers and boards"
)


def on_one_clock(log: SensorLog) -> tuple[SensorLog, tuple[Finding, ...]]:
    """Return the log with the field's stamps on the IMU's clock, and a finding if they changed."""
    (start, end), (first, last) = log.imu_time[[0, -1]], log.field_time[[0, -1]]
    # Streams of one recording begin at about the same time.
    off = 0.0 if start < last and first < end else float(first - start)
    off += _clock_shift(replace(log, field_time=log.field_time - off))
    if not off:
        return log, ()
    size = f"{abs(off):.1f} s" if abs(off) < 1e5 else f"{abs(off):.4g} s"
    evidence = f"the field's are {size} {'later' if off > 0.0 else 'earlier'} than the IMU's"
    line = ok_or_severe("clocks", "stamps: clocks", evidence, ONE_CLOCK)
    return replace(log, field_time=log.field_time - off), (line,)


def _clock_shift(log: SensorLog) -> float:
    """Return how much later the field's stamps are than the gyro's, s; zero for a mere latency."""
    first = min(log.imu_time[0], log.field_time[0])
    last = max(log.imu_time[-1], log.field_time[-1])
    steps = (last - first) / RECORDER.row
    # A wrong stamp far away would make most steps empty.
    if not log.has_gyro or steps > len(log.imu_time) + len(log.field_time):
        return 0.0
    edges = np.arange(first, last + RECORDER.row, RECORDER.row)
    # A frozen sensor does not show when the robot turned.
    fresh = ~health.in_long_runs(log.rate)
    gyro = np.linalg.norm(means_between(log.imu_time[fresh], log.rate[fresh], edges), axis=1)
    fresh = ~health.in_long_runs(log.field)
    field = means_between(log.field_time[fresh], log.field[fresh], edges)
    moved = np.zeros(len(gyro))
    moved[1:-1] = np.linalg.norm(field[2:] - field[:-2], axis=1)
    # Peaks are cut: single jolts of both sensors would correlate at some shift by chance.
    gyro, moved = (np.minimum(each, math.sqrt(np.nanmean(each**2))) for each in (gyro, moved))
    one, two = (np.nan_to_num(values - np.nanmean(values)) for values in (gyro, moved))
    power = float(np.linalg.norm(one) * np.linalg.norm(two))
    if not power > 0.0:
        return 0.0
    size = 2 * len(one)
    alike = np.fft.irfft(np.conj(np.fft.rfft(one, size)) * np.fft.rfft(two, size), size) / power
    lag = np.fft.fftfreq(size, 1.0 / size) * RECORDER.row
    near = max(float(alike[np.abs(lag) <= 2.0 * WIDE.lag].max()), 0.0)
    best = int(np.argmax(alike))
    return float(lag[best]) if alike[best] ** 2 - near**2 > HEALTH.alike else 0.0


LONGEST = 60.0  # seconds of a log that are used; the field of a longer drive is not constant
WIDEST_BLOCK = math.radians(4.0)  # radians of turn that are averaged


@dataclass(frozen=True, eq=False)
class Segment:
    """Averaged samples with the turns between them."""

    field: FloatArray  # over `size`, shape (n, 3)
    up: FloatArray  # specific force over its usual size. Shape (n, 3).
    turn: FloatArray
    """The gyro's rate integrated from each sample to the next, radians. Shape (n - 1, 3)."""
    coning: FloatArray
    """Second order of the rotation vectors (coning). Shape (n - 1, 3)."""
    seconds: FloatArray  # shape (n - 1,)
    rate: FloatArray  # the gyro's mean rate, rad/s. Shape (n, 3).
    size: float  # of the field's changing part, tesla
    time: FloatArray  # stamps of the IMU to which the samples belong, seconds. Shape (n,).


def segment_of_log(
    log: SensorLog, lag: float = 0.0, fewest: int = 120, most: int = 240
) -> Segment | None:
    """Average a log with a gyro, finite values and increasing stamps; None if it is too short.

    `lag`, the latency of the field in seconds, is subtracted from the field's stamps. The result
    has `fewest` to `most` averages.
    """
    field_time = log.field_time - lag
    span = liveliest(log, field_time)
    if span is None:
        return None
    imu = (log.imu_time >= span[0]) & (log.imu_time <= span[1])
    time, rate = log.imu_time[imu], log.rate[imu]
    turned = integral(time, rate)
    usual = float(np.linalg.norm(np.diff(turned, axis=0), axis=1).sum())
    count = int(np.clip(usual / WIDEST_BLOCK, fewest, most))
    inside = (field_time >= span[0]) & (field_time <= span[1])
    stamps, field = field_time[inside], log.field[inside]
    block = np.minimum(((stamps - span[0]) / (span[1] - span[0]) * count).astype(int), count - 1)
    _, first = np.unique(block, return_index=True)
    if len(first) < 20:
        return None
    moment, field = block_means(stamps, first), block_means(field, first)
    width = (span[1] - span[0]) / count
    force = _mean_around(time, integral(time, log.force[imu]), moment, width)
    angle, bend = (
        interpolated(moment, time, path)
        for path in (turned, integral(time, np.cross(turned, rate)))
    )
    step = np.diff(angle, axis=0)
    # The size of the field's changing part.
    swing = np.ptp(np.quantile(field, (0.02, 0.98), axis=0), axis=0)
    size = max(float(np.linalg.norm(swing)) / 2.0, 1e-12)
    return Segment(
        field / size,
        force / max(usual_size(force), 1e-12),
        step,
        0.5 * (np.diff(bend, axis=0) - np.cross(angle[:-1], step)),
        np.diff(moment),
        _mean_around(time, turned, moment, width),
        size,
        moment,
    )


def liveliest(log: SensorLog, field_time: FloatArray) -> tuple[float, float] | None:
    """Return begin and end of the time in which the robot turns most, without gaps of the gyro."""
    if min(len(log.imu_time), len(field_time)) < 20:
        return None
    breaks = np.flatnonzero(np.diff(log.imu_time) > STREAMS.longest_gyro_step) + 1
    best, most = None, 0.0
    for rows in np.split(np.arange(len(log.imu_time)), breaks):
        time = log.imu_time[rows]
        low, high = max(time[0], field_time[0]), min(time[-1], field_time[-1])
        if len(rows) < 20 or high - low < 1.0:
            continue
        size = np.linalg.norm(log.rate[rows], axis=1)
        done = integral(time, size)
        begin = low + np.arange(0.0, max(high - LONGEST - low, 0.0) + 0.5, 1.0)
        gained = np.interp(np.minimum(begin + LONGEST, high), time, done)
        gained -= np.interp(begin, time, done)
        k = int(np.argmax(gained))
        if gained[k] > most:
            best = (float(begin[k]), float(min(begin[k] + LONGEST, high)))
            most = float(gained[k])
    return best


def _mean_around(
    time: FloatArray, path: FloatArray, moment: FloatArray, width: float
) -> FloatArray:
    """Return means over `width` seconds around each moment, from an integral."""
    low = np.maximum(moment - 0.5 * width, time[0])
    high = np.minimum(moment + 0.5 * width, time[-1])
    gained = interpolated(high, time, path) - interpolated(low, time, path)
    return np.asarray(gained / (high - low)[:, None])
