"""Recorded drives as CSV folders: `imu.csv` and `mag.csv`, SI units."""

from __future__ import annotations

import io
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TextIO

import numpy as np

from magcal_ros.core.geometry.arrays import FloatArray
from magcal_ros.core.samples.streams import FieldSample, ImuSample
from magcal_ros.files.atomic import FileTrouble
from magcal_ros.files.plain import plain
from magcal_ros.files.reading import open_regular

IMU_COLUMNS = ("t", "ax", "ay", "az", "gx", "gy", "gz")
LONGEST_LINE = 10_000
"""Characters."""

LATEST_STAMP = 2.0**33
"""Seconds, whichever sign: the stamps of ROS end at a quarter of that."""

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
    imu = _read_columns(folder / "imu.csv", IMU_COLUMNS)
    return Recording(imu, _read_columns(folder / "mag.csv", FIELD_COLUMNS))


def _lines(handle: TextIO) -> Iterator[str]:
    """Yield the lines; one that does not end would fill the memory."""
    while line := handle.readline(LONGEST_LINE):
        if len(line) == LONGEST_LINE:
            raise ValueError(f"a line has {LONGEST_LINE} characters or more")
        yield line


def _read_columns(path: Path, columns: tuple[str, ...]) -> FloatArray:
    try:
        with io.TextIOWrapper(open_regular(path), encoding="utf-8") as handle:
            lines = _lines(handle)
            header = [name.strip() for name in next(lines, "").split(",")]
            missing = [name for name in columns if name not in header]
            if missing:
                raise FileTrouble(
                    f"{path} has no column {', '.join(missing)}; "
                    f"its first line should be {','.join(columns)}"
                )
            order = [header.index(name) for name in columns]
            table = np.loadtxt(lines, delimiter=",", usecols=order, ndmin=2)
    except OSError as error:
        raise FileTrouble(f"cannot read {path}: {error.strerror or error}") from error
    except ValueError as error:
        raise FileTrouble(f"{plain(str(path))} is damaged: {error}") from error
    except IndexError as error:  # numpy before 1.23
        raise FileTrouble(f"{plain(str(path))} is damaged: a line has too few columns") from error
    stamps = table[:, 0]
    if (np.abs(stamps[np.isfinite(stamps)]) > LATEST_STAMP).any():
        raise FileTrouble(
            f"{plain(str(path))} is damaged: {columns[0]} must be seconds, and it reaches "
            f"{np.nanmax(np.abs(stamps)):.3g}"
        )
    if not len(table):
        raise FileTrouble(f"{path} holds no samples")
    return np.asarray(table, dtype=np.float64)
