"""A window: the paired, clean samples of one turn."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from magcal_ros.core.geometry.arrays import BoolArray, FloatArray, IntArray, frozen_array
from magcal_ros.core.samples.rest import RestBeside
from magcal_ros.core.samples.streams import FieldSample, ImuSample

NO_ORIENTATION = (math.nan,) * 4
NEIGHBOURS, SPIKE = 9, 4.5
"""A spike is so many robust sigmas from the median of so many samples, itself among them."""


@dataclass(frozen=True, eq=False)
class Window:
    """Samples of one turn, one row per field sample.

    Raises
    ------
    ValueError
        If lengths differ, a number is not finite or time does not increase.
    """

    time: FloatArray
    """Seconds of the field's stamps, increasing. Shape (n,)."""
    field: FloatArray
    """Raw field in tesla, in the magnetometer's axes. Shape (n, 3)."""
    specific_force: FloatArray
    """m/s² in body axes at the same moments, +9.81 upwards at rest. Shape (n, 3)."""
    angular_rate: FloatArray | None = None
    """rad/s in body axes at the same moments; None without a gyro. Shape (n, 3)."""
    turned: FloatArray | None = None
    """Rotations from the body axes at one moment to those of each sample, by all that the gyro
    said, where samples between those of the window were left out. Shape (n, 3, 3)."""
    rests: tuple[RestBeside, ...] = ()
    """What was seen right before and after the turn, where the robot stood there; the gyro's bias
    that they show is taken off `angular_rate`."""
    sigma_before: float = math.inf
    """rad/s per axis, of a bias of the gyro that was known from before and was taken off, too;
    infinite where none was."""

    def __post_init__(self) -> None:
        time = frozen_array(self.time, (-1,), "time")
        n = len(time)
        object.__setattr__(self, "time", time)
        object.__setattr__(self, "field", frozen_array(self.field, (n, 3), "field"))
        force = frozen_array(self.specific_force, (n, 3), "specific force")
        object.__setattr__(self, "specific_force", force)
        if self.angular_rate is not None:
            rate = frozen_array(self.angular_rate, (n, 3), "angular rate")
            object.__setattr__(self, "angular_rate", rate)
        if self.turned is not None:
            object.__setattr__(self, "turned", frozen_array(self.turned, (n, 3, 3), "turned"))
        if (np.diff(time) <= 0.0).any():
            raise ValueError("the stamps of a window must increase")

    @property
    def bias_sigma(self) -> float:
        """Sigma of the bias that `angular_rate` still has, rad/s; infinite where nothing told it.

        It was taken off where a rest has shown it.
        """
        return min([self.sigma_before, *(rest.rate_sigma for rest in self.rests)])

    def __len__(self) -> int:
        return len(self.time)

    def take(self, rows: BoolArray | IntArray) -> Window:
        """Return the window of the chosen rows, a mask or increasing indices."""
        return replace(
            self,
            time=self.time[rows],
            field=self.field[rows],
            specific_force=self.specific_force[rows],
            angular_rate=None if self.angular_rate is None else self.angular_rate[rows],
            turned=None if self.turned is None else self.turned[rows],
        )


def white_noise(values: FloatArray) -> FloatArray:
    """Return the noise of samples (n, 3) per axis by fourth differences, to which sway adds little.

    It is zero where there are too few.
    """
    bends = np.diff(values, 4, axis=0)
    if not len(bends):
        return np.zeros(values.shape[1])
    return np.asarray(np.median(np.abs(bends), axis=0) / 0.6745 / np.sqrt(70.0))


def without_spikes(values: FloatArray) -> BoolArray:
    """Return which rows (n, 3) agree with the median of their neighbours (a Hampel filter)."""
    reach = NEIGHBOURS // 2
    padded = np.pad(values, ((reach, reach), (0, 0)), mode="edge")
    stretches = np.lib.stride_tricks.sliding_window_view(padded, NEIGHBOURS, axis=0)
    away = np.abs(values - np.median(stretches, axis=2))
    # Where the values rise or fall the median is the middle one, and only their peaks deviate.
    usual = np.maximum(1.4826 * np.median(away, axis=0), white_noise(values)) + 1e-12
    return np.asarray((away < SPIKE * usual).all(axis=1))


@dataclass(frozen=True, eq=False)
class SensorLog:
    """Both streams in the order in which they came, nothing cleaned."""

    imu_time: FloatArray
    """Stamps, seconds. Shape (n,)."""
    force: FloatArray
    """Specific force as published, meant as m/s². Shape (n, 3)."""
    rate: FloatArray
    """Angular rate as published, meant as rad/s; NaN without a gyro. Shape (n, 3)."""
    field_time: FloatArray
    """Stamps, seconds. Shape (m,)."""
    field: FloatArray
    """Raw field as published, meant as tesla. Shape (m, 3)."""
    orientation: FloatArray | None = None
    """Quaternions x, y, z, w of the same IMU messages, NaN where there is none. Shape (n, 4)."""

    @classmethod
    def of(cls, samples: Iterable[ImuSample | FieldSample]) -> SensorLog:
        """Gather samples."""
        imu: list[ImuSample] = []
        field: list[FieldSample] = []
        for sample in samples:
            if isinstance(sample, ImuSample):
                imu.append(sample)
            else:
                field.append(sample)
        return cls(
            np.array([s.stamp for s in imu], dtype=np.float64),
            np.array([s.force for s in imu], dtype=np.float64).reshape(-1, 3),
            np.array([s.rate for s in imu], dtype=np.float64).reshape(-1, 3),
            np.array([s.stamp for s in field], dtype=np.float64),
            np.array([s.field for s in field], dtype=np.float64).reshape(-1, 3),
            np.array([s.orientation or NO_ORIENTATION for s in imu]).reshape(-1, 4),
        )

    @property
    def has_gyro(self) -> bool:
        """Whether most IMU samples carry a rate."""
        return bool(len(self.rate) and np.isfinite(self.rate).all(axis=1).mean() > 0.5)
