"""The paired, clean samples of one turn, and the raw streams of a log."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from magcal_ros.core.geometry.arrays import (
    BoolArray,
    FloatArray,
    IntArray,
    accumulated,
    freeze,
    trapezoids,
)
from magcal_ros.core.geometry.rotations import (
    chained,
    exp_rotations,
    in_axes,
    rotation_vectors_near,
)
from magcal_ros.core.samples.battery import Battery, Messages, battery_of
from magcal_ros.core.samples.rest import FORCE, RATE, SPAN, AttachedRest
from magcal_ros.core.samples.streams import FieldSample, ImuSample

NEEDED = ("time", "field", "specific_force")
NO_ORIENTATION = (math.nan,) * 4
ROLLS = 0.2  # m/s of the speed of the wheels from which a robot certainly drives
ROUNDING = 1e-12  # of an integral over some samples, relative to the largest reading
NOISELESS, FEWEST_BENDS = 1e-4, 50
"""Largest second difference of a rate without noise, over the largest rate; and the fewest second
differences for this test."""


class Steps(NamedTuple):
    """Integrals of the IMU from each sample to the next."""

    angle: FloatArray  # rotation vectors in body axes, rad. Shape (n - 1, 3).
    velocity: FloatArray  # of the specific force in body axes, m/s. Shape (n - 1, 3).
    intervals: FloatArray  # number of integrated intervals between IMU samples. Shape (n - 1,).

    @classmethod
    def straight(cls, time: FloatArray, force: FloatArray, rate: FloatArray) -> Steps:
        """Integrate straight lines between samples: (n,), (n, 3) in m/s² and (n, 3) in rad/s."""
        return cls(trapezoids(time, rate), trapezoids(time, force), np.ones(max(len(time) - 1, 0)))

    @property
    def attitude(self) -> FloatArray:
        """Rotations from the first sample's body axes to those of each, shape (n, 3, 3)."""
        return np.asarray(chained(exp_rotations(-self.angle)[None])[0])

    def in_axes(self, rotation: FloatArray) -> Steps:
        """Return the steps in rotated body axes."""
        return Steps(self.angle @ rotation.T, self.velocity @ rotation.T, self.intervals)

    def over(self, rows: IntArray) -> Steps:
        """Return the steps between the chosen samples, by increasing indices."""
        attitude = self.attitude[rows]
        turned = attitude[1:] @ np.swapaxes(attitude[:-1], 1, 2)
        sums = [np.diff(accumulated(each)[rows], axis=0) for each in self]
        return Steps(-rotation_vectors_near(turned, -sums[0]), *sums[1:])


def steps_of(rows: FloatArray) -> Steps:
    """Return the steps of samples in rows (n, COLUMNS or more).

    An unknown span is that of a straight line; without a gyro the rotation is zero.
    """
    span = rows[1:, SPAN].copy()
    lost = ~np.isfinite(span).all(axis=1)
    line = Steps.straight(rows[:, 0], rows[:, FORCE], rows[:, RATE])
    span[lost] = np.column_stack(line)[lost]
    return Steps(np.nan_to_num(span[:, :3]), span[:, 3:6], span[:, 6])


@dataclass(frozen=True, eq=False)
class Window:
    """Samples of one turn, one row per field sample.

    Raises
    ------
    ValueError
        If a column is missing, lengths differ, a number is not finite (a speed may be NaN) or time
        does not increase.
    """

    time: FloatArray  # seconds of the field's stamps, increasing. Shape (n,).
    field: FloatArray  # raw field in tesla, in the magnetometer's axes. Shape (n, 3).
    specific_force: FloatArray
    """m/s² in body axes at the same moments, +9.81 upwards at rest. Shape (n, 3)."""
    angular_rate: FloatArray | None = None
    """rad/s in body axes at the same moments; None without a gyro. Shape (n, 3)."""
    missed: Steps | None = None
    """Difference of `steps` from straight lines, by the IMU samples between those of the window;
    None if these are unknown, or without a gyro."""
    rests: tuple[AttachedRest, ...] = ()
    """Rests right before and after the turn. The gyro's bias at the rests is subtracted from
    `angular_rate`."""
    sigma_before: float = math.inf
    """Sigma of a bias from earlier that was subtracted, too, rad/s per axis; else infinite."""
    speed: FloatArray | None = None
    """Of the wheels, m/s ahead, NaN where it was not measured; None if it never was. Shape (n,)."""
    battery: Battery | None = None  # its current; None if it was not measured throughout
    rested: BoolArray | None = None
    """Where a recorder detected a rest; None without detection. Shape (n,)."""
    longest_step: float = math.inf
    """Longest gap between samples across which the gyro is integrated, seconds."""

    def __post_init__(self) -> None:
        missing = [name for name in NEEDED if getattr(self, name) is None]
        if missing:
            raise ValueError(f"a window needs {', '.join(missing).replace('_', ' ')}, not None")
        freeze(self, time=(-1,))
        rows = (len(self.time), 3)
        freeze(self, field=rows, specific_force=rows, angular_rate=rows)
        for name, kind in (("speed", np.float64), ("rested", np.bool_)):
            if getattr(self, name) is not None:
                object.__setattr__(self, name, np.asarray(getattr(self, name), dtype=kind))
                if getattr(self, name).shape != rows[:1]:
                    raise ValueError(f"{name} must have the shape {rows[:1]}")
        if self.speed is not None and np.isinf(self.speed).any():
            raise ValueError("speed is infinite; it is NaN where it was not measured")
        if (np.diff(self.time) <= 0.0).any():
            raise ValueError("the stamps of a window must increase")

    @property
    def bias_sigma(self) -> float:
        """Sigma of the remaining bias of `angular_rate`, rad/s; infinite if none was subtracted."""
        return min([self.sigma_before, *(rest.rate_sigma for rest in self.rests)])

    def __len__(self) -> int:
        return len(self.time)

    @property
    def wheel_speed(self) -> FloatArray | None:
        """The speed; None if it is zero throughout, as in odometry with an empty twist.

        On a steady circle no other sensor would contradict the zeros.
        """
        is_known = self.speed is not None and np.nan_to_num(self.speed).any()
        return self.speed if is_known else None

    @property
    def rolls(self) -> bool:
        """Whether the wheels' speed shows that the robot drives."""
        if self.speed is None:
            return False
        known = self.speed[np.isfinite(self.speed)]
        return bool(len(known)) and float(np.median(np.abs(known))) > ROLLS

    @property
    def imu_gap(self) -> float:
        """Median time between two samples of the IMU, seconds; zero for less than two samples."""
        if len(self) < 2:
            return 0.0
        intervals = np.ones(1) if self.missed is None else self.missed.intervals
        return float(np.median(np.diff(self.time) / np.maximum(intervals, 1.0)))

    @property
    def steps(self) -> Steps:
        """Integrals of all known IMU samples; without a gyro the rotation is zero."""
        line, missed = self._straight, self.missed
        if missed is None:
            return line
        return Steps(line.angle + missed.angle, line.velocity + missed.velocity, missed.intervals)

    def take(self, rows: BoolArray | IntArray) -> Window:
        """Return the window of the chosen rows, a mask or increasing indices."""
        columns = ("time", "field", "specific_force", "angular_rate", "speed", "rested")
        every = {name: getattr(self, name) for name in columns}
        found = {name: each[rows] for name, each in every.items() if each is not None}
        taken = replace(self, missed=None, **found)
        if self.missed is None:
            return taken
        return taken.with_steps(self.steps.over(np.arange(len(self))[rows]))

    def in_axes(self, rotation: FloatArray) -> Window:
        """Return the same samples in body axes that are rotated by `rotation` (3, 3)."""
        rate = self.angular_rate
        return replace(
            self,
            specific_force=self.specific_force @ rotation.T,
            angular_rate=None if rate is None else rate @ rotation.T,
            missed=in_axes(self.missed, rotation),
            rests=in_axes(self.rests, rotation),
        )

    def with_steps(self, steps: Steps) -> Window:
        """Return the window with the integrals of all samples of an IMU with a gyro."""
        (angle, velocity, intervals), line = steps, self._straight
        missed = Steps(angle - line.angle, velocity - line.velocity, intervals)
        return replace(self, missed=missed)

    def with_battery(self, messages: Messages) -> Window:
        """Return the window with the battery's current from messages, if it is known."""
        if not len(messages) or not len(self):
            return self
        begin = min([float(self.time[0]), *(rest.beside - rest.seconds for rest in self.rests)])
        end = max([float(self.time[-1]), *(rest.beside + rest.seconds for rest in self.rests)])
        return replace(self, battery=battery_of(messages, begin, end))

    @property
    def _straight(self) -> Steps:
        rate = np.zeros((len(self), 3)) if self.angular_rate is None else self.angular_rate
        return Steps.straight(self.time, self.specific_force, rate)


def is_noiseless(rate: FloatArray) -> bool:
    """Return whether rates (n, 3) have no noise: an axis in a simulation may be constant."""
    changed = (np.diff(rate, axis=0) != 0.0).any(axis=1)[1:]
    bend = np.abs(np.diff(rate, 2, axis=0)).max(axis=1)[changed]
    if len(bend) < FEWEST_BENDS:
        return len(bend) > 0
    return bool(np.median(bend) < NOISELESS * np.abs(rate).max())


def working_axes(rate: FloatArray | None) -> tuple[bool, bool, bool]:
    """Return which axes of a gyro (n, 3) measure: without noise all do, if any changes."""
    if rate is None or not len(rate):
        return False, False, False
    x, y, z = (bool(spread > 0.0) for spread in np.ptp(rate, axis=0))
    return (True, True, True) if (x or y or z) and is_noiseless(rate) else (x, y, z)


@dataclass(frozen=True, eq=False)
class SensorLog:
    """Both raw streams, in order of arrival."""

    imu_time: FloatArray  # stamps, seconds, shape (n,)
    force: FloatArray  # specific force as published, meant as m/s². Shape (n, 3).
    rate: FloatArray  # angular rate as published, meant as rad/s; NaN without a gyro. Shape (n, 3).
    field_time: FloatArray  # stamps, seconds, shape (m,)
    field: FloatArray  # raw field as published, meant as tesla. Shape (m, 3).
    orientation: FloatArray | None = None
    """Quaternions x, y, z, w of the same IMU messages, NaN where there is none. Shape (n, 4)."""

    @classmethod
    def of(cls, samples: Iterable[ImuSample | FieldSample]) -> SensorLog:
        """Gather samples."""
        every = list(samples)
        imu = [sample for sample in every if isinstance(sample, ImuSample)]
        field = [sample for sample in every if isinstance(sample, FieldSample)]
        return cls(
            np.array([s.stamp for s in imu], dtype=np.float64),
            np.array([s.force for s in imu], dtype=np.float64).reshape(-1, 3),
            np.array([s.rate for s in imu], dtype=np.float64).reshape(-1, 3),
            np.array([s.stamp for s in field], dtype=np.float64),
            np.array([s.field for s in field], dtype=np.float64).reshape(-1, 3),
            np.array([s.orientation or NO_ORIENTATION for s in imu]).reshape(-1, 4),
        )

    @classmethod
    def of_window(cls, window: Window) -> SensorLog:
        """Return the samples of a window as two streams; a rate of zeros counts as no gyro.

        Where the window omits IMU samples, one sample is inserted to give the same integrals by the
        trapezoidal rule.
        """
        time, rate = window.time, window.angular_rate
        if rate is None or not rate.any():
            rate = np.full((len(window), 3), np.nan)
            return cls(time, window.specific_force, rate, time, window.field)
        imu = np.column_stack([time, window.specific_force, rate])
        if window.missed is not None:
            angle, velocity, intervals = window.missed
            left_out = np.flatnonzero(intervals > 1.0)
            between = 0.5 * (imu[1:] + imu[:-1])
            beyond = 2.0 * np.hstack([velocity, angle]) / np.diff(time)[:, None]
            # Rounding must not look like a change of a sensor that repeats one value.
            beyond[np.abs(beyond) < ROUNDING * np.abs(imu[:, 1:]).max()] = 0.0
            between[:, 1:] += beyond
            imu = np.insert(imu, left_out + 1, between[left_out], axis=0)
        return cls(imu[:, 0], imu[:, 1:4], imu[:, 4:], time, window.field)

    @property
    def has_gyro(self) -> bool:
        """Whether most IMU samples carry a rate."""
        return bool(len(self.rate) and np.isfinite(self.rate).all(axis=1).mean() > 0.5)
