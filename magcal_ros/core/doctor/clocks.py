"""Whether IMU and field are stamped by one clock, within a second."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from magcal_ros.core.doctor.finding import Finding, wrong
from magcal_ros.core.doctor.quiet import block_means
from magcal_ros.core.geometry.arrays import FloatArray
from magcal_ros.core.samples.sensor_log import SensorLog

ONE_CLOCK = (
    "the stamps of IMU and field come from two clocks: stamp both with the time at which they were "
    "measured by the ROS clock, and synchronise the clocks of all computers and boards"
)


@dataclass(frozen=True)
class ClockTuning:
    """When stamps are taken for those of two clocks."""

    shared: float = 0.5
    """Share of the shorter stream that the other one must cover."""
    step: float = 0.1
    """Seconds at which the streams' own speeds are compared."""
    least: float = 0.6
    """Seconds below which it is a latency, which is measured better elsewhere."""
    alike: float = 0.55
    better: float = 0.2
    """Correlation of the speeds beyond the latter lag that is believed, and by how much it must
    exceed the best within it."""
    longest: float = 7200.0
    """Seconds beyond which speeds are not compared."""


TUNING = ClockTuning()


def on_one_clock(log: SensorLog) -> tuple[SensorLog, tuple[Finding, ...]]:
    """Return the log with the field's stamps on the IMU's clock, and a line where they were not."""
    starts = log.imu_time[0], log.field_time[0]
    ends = log.imu_time[-1], log.field_time[-1]
    shorter = min(end - start for start, end in zip(starts, ends, strict=True))
    if min(ends) - max(starts) < TUNING.shared * shorter:
        # What was recorded together began together, roughly.
        off = float(starts[1] - starts[0])
        log = replace(log, field_time=log.field_time - off)
        rest = _apart(log)
        log = replace(log, field_time=log.field_time - rest)
        return log, (_line(off + rest),)
    off = _apart(log)
    if not off:
        return log, ()
    return replace(log, field_time=log.field_time - off), (_line(off),)


def _line(off: float) -> Finding:
    size = f"{abs(off):.1f} s" if abs(off) < 1e5 else f"{abs(off):.4g} s"
    evidence = f"the field's are {size} {'later' if off > 0.0 else 'earlier'} than the IMU's"
    return wrong("clocks", "stamps: clocks", evidence, ONE_CLOCK)


def _apart(log: SensorLog) -> float:
    """Return by how many seconds the field turns later than the gyro; zero for a mere latency."""
    first = min(log.imu_time[0], log.field_time[0])
    last = max(log.imu_time[-1], log.field_time[-1])
    if not log.has_gyro or last - first > TUNING.longest:
        return 0.0
    edges = np.arange(first, last + TUNING.step, TUNING.step)
    gyro = np.linalg.norm(block_means(log.imu_time, log.rate, edges), axis=1)
    field = block_means(log.field_time, log.field, edges)
    moved = np.zeros(len(gyro))
    moved[1:-1] = np.linalg.norm(field[2:] - field[:-2], axis=1)
    one, two = (np.nan_to_num(values - np.nanmean(values)) for values in (gyro, moved))
    power = float(np.linalg.norm(one) * np.linalg.norm(two))
    if not power > 0.0:
        return 0.0
    size = 2 * len(one)
    alike = np.fft.irfft(np.conj(np.fft.rfft(one, size)) * np.fft.rfft(two, size), size) / power
    lag = np.fft.fftfreq(size, 1.0 / size) * TUNING.step
    near = float(alike[np.abs(lag) <= TUNING.least].max())
    best = int(np.argmax(alike))
    plain = alike[best] > max(TUNING.alike, near + TUNING.better)
    shift = round(float(lag[best]) / TUNING.step)
    return float(lag[best]) if plain and _in_both_halves(one, two, shift) else 0.0


def _in_both_halves(one: FloatArray, two: FloatArray, shift: int) -> bool:
    """Return whether speeds (n,) are alike at a shift in either half of the movement.

    One jolt of each sensor is alike at some shift by chance.
    """
    first, last = max(0, -shift), min(len(one), len(two) - shift)
    if last - first < 4:
        return True
    one, two = one[first:last], two[first + shift : last + shift]
    middle = int(np.searchsorted(np.cumsum(one**2), 0.5 * float(np.sum(one**2))))
    halves = [(a, b) for a, b in ((0, middle), (middle, len(one))) if b - a > 3]
    return all(
        float(np.nan_to_num(np.corrcoef(one[a:b], two[a:b])[0, 1])) > 0.5 * TUNING.alike
        for a, b in halves
    )
