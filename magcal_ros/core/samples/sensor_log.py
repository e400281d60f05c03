"""All samples of both sensors over a while, as published."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from magcal_ros.core.geometry.arrays import FloatArray
from magcal_ros.core.samples.streams import FieldSample, ImuSample


@dataclass(frozen=True, eq=False)
class SensorLog:
    """Both streams in the order in which they came, nothing cleaned.

    Parameters
    ----------
    imu_time : ndarray, shape (n,)
        Stamps, seconds.
    force : ndarray, shape (n, 3)
        Specific force as published, meant as m/s².
    rate : ndarray, shape (n, 3)
        Angular rate as published, meant as rad/s; NaN without a gyro.
    field_time : ndarray, shape (m,)
        Stamps, seconds.
    field : ndarray, shape (m, 3)
        Raw field as published, meant as tesla.
    """

    imu_time: FloatArray
    force: FloatArray
    rate: FloatArray
    field_time: FloatArray
    field: FloatArray

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
        )

    @property
    def has_gyro(self) -> bool:
        """Whether most IMU samples carry a rate."""
        return bool(len(self.rate) and np.isfinite(self.rate).all(axis=1).mean() > 0.5)
