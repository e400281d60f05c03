"""Recorded drives as CSV folders: `imu.csv` and `mag.csv`, SI units."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from magcal_ros.core.geometry.arrays import FloatArray
from magcal_ros.core.samples.streams import FieldSample, ImuSample
from magcal_ros.files.tables import read_columns

IMU_COLUMNS = ("t", "ax", "ay", "az", "gx", "gy", "gz")
FIELD_COLUMNS = ("t", "mx", "my", "mz")


@dataclass(frozen=True, eq=False)
class Recording:
    """A drive as it was recorded, nothing cleaned.

    Parameters
    ----------
    imu : ndarray, shape (n, 7)
        Stamp (s), specific force (m/s²), angular rate (rad/s; NaN without a gyro).
    field : ndarray, shape (m, 4)
        Stamp (s), raw field (tesla).
    """

    imu: FloatArray
    field: FloatArray

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


def _imu_sample(row: list[float]) -> ImuSample:
    t, ax, ay, az, gx, gy, gz = row
    return ImuSample(t, (ax, ay, az), (gx, gy, gz))


def read_csv_folder(folder: Path) -> Recording:
    """Read `imu.csv` (t,ax,ay,az,gx,gy,gz) and `mag.csv` (t,mx,my,mz) of a folder.

    Parameters
    ----------
    folder : Path
        Holds the two files, each with a header line; SI units.

    Returns
    -------
    Recording

    Raises
    ------
    FileTrouble
        If a file or a column is missing, or a line is not numbers.
    """
    _, imu = read_columns(folder / "imu.csv", IMU_COLUMNS)
    _, field = read_columns(folder / "mag.csv", FIELD_COLUMNS)
    return Recording(imu, field)
