"""What single sensor streams show of their own faults: stamps, repeats, steps, range, gravity."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from magcal_ros.core.assessment.grading import Grade
from magcal_ros.core.geometry.arrays import FloatArray
from magcal_ros.core.geometry.attitude import STANDARD_GRAVITY
from magcal_ros.core.samples.stamps import bursts_in_words, long_gaps
from magcal_ros.core.samples.units import (
    Z_NOT_UP,
    likely_acceleration_unit,
    likely_field_unit,
)


@dataclass(frozen=True)
class HealthTuning:
    """Where a stream's fault begins.

    Parameters
    ----------
    repeats : float
        Share of samples with the values of the one before.
    coarse : float
        Tesla, step of the field's numbers.
    saturated : float
        Share of samples at one extreme value, in runs.
    gravity : float
        Misfit of the usual acceleration.
    fewest : int
        Samples below which nothing is said of a stream.
    """

    repeats: float = 0.05
    coarse: float = 0.5e-6
    saturated: float = 0.01
    gravity: float = 0.15
    fewest: int = 50


TUNING = HealthTuning()


@dataclass(frozen=True)
class Finding:
    """One line of the page.

    Parameters
    ----------
    name : str
        What was looked at.
    grade : Grade
        `EXCELLENT` where nothing is wrong.
    evidence : str
        The numbers.
    remedy : str
        What to change; empty where nothing is wrong.
    """

    name: str
    grade: Grade
    evidence: str
    remedy: str = ""


def stamps_finding(name: str, time: FloatArray) -> Finding:
    """Look at a stream's stamps, seconds, increasing; at least two."""
    gaps = np.diff(time)
    usual, span = float(np.median(gaps)), float(time[-1] - time[0])
    evidence = (
        f"{len(gaps) / span:.1f} Hz, gaps of {usual * 1e3:.1f} ms, at most {gaps.max():.2f} s"
    )
    long = long_gaps(time)
    if len(long):
        return Finding(f"{name}: stamps", Grade.WARN, evidence, bursts_in_words(long))
    return Finding(f"{name}: stamps", Grade.EXCELLENT, evidence)


def field_findings(field: FloatArray, tuning: HealthTuning = TUNING) -> list[Finding]:
    """Look at raw field samples in tesla, shape (n, 3), in the order in which they came."""
    size = float(np.median(np.linalg.norm(field, axis=1)))
    unit = likely_field_unit(size)
    found = [_finding("field: unit", f"usually {size * 1e6:.3g} µT", unit)]
    same = float((np.diff(field, axis=0) == 0.0).all(axis=1).mean())
    words = "the driver publishes faster than the sensor measures: lower its rate to the sensor's"
    found.append(
        _finding("field: repeats", f"{same:.0%} repeated", words if same > tuning.repeats else "")
    )
    step = max(_step(field[:, axis]) for axis in range(3))
    words = "choose a finer range of the sensor, or average in the driver"
    evidence = f"steps of {step * 1e6:.2g} µT" if step else "no steps seen"
    found.append(_finding("field: resolution", evidence, words if step > tuning.coarse else ""))
    full = [axis for axis in range(3) if _saturated(field[:, axis], tuning)]
    largest = float(np.abs(field).max()) * 1e6
    words = f"{_axes(full)} stops at one value: choose a wider range, or move it away from magnets"
    found.append(_finding("field: range", f"at most {largest:.3g} µT", words if full else ""))
    found.append(_frozen("field", field))
    return found


def imu_findings(
    force: FloatArray, rate: FloatArray | None, tuning: HealthTuning = TUNING
) -> list[Finding]:
    """Look at specific force (m/s²) and angular rate (rad/s or None), each shape (n, 3)."""
    size = float(np.median(np.linalg.norm(force, axis=1)))
    hint = ""
    if abs(size / STANDARD_GRAVITY - 1.0) > tuning.gravity:
        hint = likely_acceleration_unit(size) or "check the accelerometer's range and scale"
    elif float(np.median(force[:, 2])) < 0.5 * size:
        hint = Z_NOT_UP
    x, y, z = np.median(force, axis=0)
    found = [_finding("IMU: gravity", f"({x:.2f}, {y:.2f}, {z:.2f}) m/s²", hint)]
    if rate is None:
        words = "no gyro: mirrored or swapped axes of the magnetometer cannot be told"
        return [*found, Finding("IMU: gyro", Grade.WARN, "absent", words)]
    return [*found, _frozen("gyro", rate)]


def _finding(name: str, evidence: str, remedy: str) -> Finding:
    return Finding(name, Grade.WARN if remedy else Grade.EXCELLENT, evidence, remedy)


def _frozen(name: str, values: FloatArray) -> Finding:
    still = [axis for axis in range(3) if np.ptp(values[:, axis]) == 0.0]
    words = f"{_axes(still)} never changes: the driver does not read it"
    evidence = f"{3 - len(still)} of 3 axes change"
    return _finding(f"{name}: axes alive", evidence, words if still else "")


def _axes(which: list[int]) -> str:
    return " and ".join("xyz"[axis] for axis in which)


def _step(values: FloatArray) -> float:
    """Return the step of numbers (n,) that lie on a grid; zero where they hardly meet twice."""
    distinct = np.unique(values)
    if len(distinct) < 3 or len(distinct) > len(values) // 4:
        return 0.0
    return float(np.min(np.diff(distinct)))


def _saturated(values: FloatArray, tuning: HealthTuning) -> bool:
    """Return whether the largest or the smallest value comes in runs."""
    for extreme in (values.max(), values.min()):
        at = values == extreme
        runs = float((at[1:] & at[:-1]).mean())
        if tuning.saturated < runs < 1.0 and abs(extreme) == np.abs(values).max():
            return True
    return False
