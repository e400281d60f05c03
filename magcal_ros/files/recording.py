"""Recorded drives in memory, and as CSV folders: `imu.csv` and `mag.csv`, SI units."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from magcal_ros.core.earth_field.wmm import Place
from magcal_ros.core.geometry.arrays import FloatArray
from magcal_ros.core.samples.streams import FieldSample, ImuSample, TravelSample
from magcal_ros.files.tables import read_columns

IMU_COLUMNS = ("t", "ax", "ay", "az", "gx", "gy", "gz")
FIELD_COLUMNS = ("t", "mx", "my", "mz")


@dataclass(frozen=True, eq=False)
class Recording:
    """A drive as it was recorded, nothing cleaned."""

    imu: FloatArray
    """Stamp (s), specific force (m/s²), angular rate (rad/s; NaN without a gyro). Shape (n, 7)."""
    field: FloatArray
    """Stamp (s), raw field (tesla). Shape (m, 4)."""
    travel: tuple[TravelSample, ...] = ()
    """What receiver and wheels said, by stamp."""
    place: Place | None = None
    """Where the first good fix was."""
    imu_topic: str = "imu.csv"
    field_topic: str = "mag.csv"
    """What to call the two."""
    field_frame: str = ""
    """What a calibration remembers of the magnetometer."""
    yaw: FloatArray = dataclasses.field(default_factory=lambda: np.empty((0, 2)))
    """Stamp (s) and what an autopilot took for its yaw (rad, ENU, true north). Shape (k, 2)."""
    notes: tuple[str, ...] = ()
    """What is to be said of the recording."""

    def samples(self) -> Iterator[ImuSample | FieldSample]:
        """Yield the samples of both sensors in the order of their stamps, the IMU's first."""
        i = 0
        imu, n = self.imu.tolist(), len(self.imu)
        for t, x, y, z in self.field.tolist():
            while i < n and imu[i][0] <= t:
                yield _imu_sample(imu[i])
                i += 1
            yield FieldSample(t, (x, y, z))
        for row in imu[i:]:
            yield _imu_sample(row)

    def turned(self, pose: FloatArray) -> Recording:
        """Return what sensors in the parent's axes would have recorded.

        Parameters
        ----------
        pose : ndarray, shape (3, 3)
            Of the recorder in the vehicle.
        """
        imu, raw = self.imu.copy(), self.field.copy()
        for vectors in (imu[:, 1:4], imu[:, 4:7], raw[:, 1:4]):
            vectors[:] = vectors @ pose.T
        return replace(self, imu=imu, field=raw)


def _imu_sample(row: list[float]) -> ImuSample:
    t, ax, ay, az, gx, gy, gz = row
    return ImuSample(t, (ax, ay, az), (gx, gy, gz))


def read_csv_folder(folder: Path) -> Recording:
    """Read `imu.csv` (t,ax,ay,az,gx,gy,gz) and `mag.csv` (t,mx,my,mz) of a folder.

    Raises
    ------
    FileTrouble
        If a file or a column is missing, or a line is not numbers.
    """
    _, imu = read_columns(folder / "imu.csv", IMU_COLUMNS)
    _, field = read_columns(folder / "mag.csv", FIELD_COLUMNS)
    return Recording(imu, field)
