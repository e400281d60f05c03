"""All samples of both sensors over a while, as published."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from magcal_ros.core.geometry.arrays import FloatArray
from magcal_ros.core.samples.streams import FieldSample, ImuSample


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
