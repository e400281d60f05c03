"""Recordings in memory, and as CSV folders: `imu.csv` and `mag.csv`, SI units."""

from __future__ import annotations

import contextlib
import dataclasses
import heapq
import io
import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import chain, pairwise
from operator import itemgetter
from pathlib import Path
from typing import TextIO

import numpy as np

from magcal_ros.core.earth_field.reference import Fix, LocalPlane
from magcal_ros.core.earth_field.wmm import Place
from magcal_ros.core.errors import UsageError
from magcal_ros.core.geometry.arrays import BoolArray, FloatArray
from magcal_ros.core.samples.samples_tuning import STREAMS
from magcal_ros.core.samples.streams import (
    FieldSample,
    HeadingSample,
    ImuSample,
    PositionSample,
    SpeedSample,
    TravelSample,
)
from magcal_ros.core.samples.window import Window
from magcal_ros.files.disk import FileError, open_regular, printable, write_atomically

IMU_COLUMNS = ("t", "ax", "ay", "az", "gx", "gy", "gz")
FIELD_COLUMNS = ("t", "mx", "my", "mz")


FIRST_STAMP = 1.0
"""Seconds. Recordings that begin at zero or before are shifted here: zero means no stamp."""


@dataclass(frozen=True, eq=False)
class Recording:
    """A recording in memory, as recorded; it has the same attributes as a `Bag`."""

    imu: FloatArray
    """Stamp (s), specific force (m/s²), angular rate (rad/s; NaN without a gyro). Shape (n, 7)."""
    field: FloatArray  # stamp (s), raw field (tesla). Shape (m, 4).
    travel: tuple[TravelSample, ...] = ()  # samples of receiver and wheels, sorted by stamp
    place: Place | None = None  # place of the first good fix
    imu_topic: str = "imu.csv"
    field_topic: str = "mag.csv"
    field_frame: str = ""
    """The name of the magnetometer that is stored in a calibration."""
    yaw: FloatArray = dataclasses.field(default_factory=lambda: np.empty((0, 2)))
    """Stamp (s) and the autopilot's estimate of yaw (rad, ENU, true north). Shape (k, 2)."""
    notes: tuple[str, ...] = ()
    imu_frame = ""
    currents = ()

    @property
    def count(self) -> int:
        """Number of messages of both sensors."""
        return len(self.imu) + len(self.field)

    @property
    def first_stamp(self) -> float:
        """The stamp of the first sample, seconds."""
        return float(self.imu[0, 0]) if len(self.imu) else 0.0

    def headings(self, topic: str) -> list[HeadingSample]:
        """Raise a UsageError: only bags have topics."""
        raise UsageError(f"{printable(topic)}: only a bag has a topic with headings")

    def samples(self) -> Iterator[ImuSample | FieldSample]:
        """Yield the samples of both sensors sorted by stamp, at equal stamps the IMU's first.

        Each stream keeps the order of its rows, even if a stamp goes back.
        """
        imu = (
            ImuSample(t, (ax, ay, az), (gx, gy, gz))
            for t, ax, ay, az, gx, gy, gz in self.imu.tolist()
        )
        field = (FieldSample(t, (x, y, z)) for t, x, y, z in self.field.tolist())
        both: list[Iterable[tuple[float, ImuSample | FieldSample]]] = [
            zip(_monotonic(self.imu[:, 0]).tolist(), imu, strict=True),
            zip(_monotonic(self.field[:, 0]).tolist(), field, strict=True),
        ]
        return (sample for _, sample in heapq.merge(*both, key=itemgetter(0)))

    readings = samples

    def cut(self, start: float, stop: float) -> Recording:
        """Return the samples from `start` to `stop`, seconds from the beginning.

        A stamp of zero or before is shifted as `FIRST_STAMP` says.
        """
        stamps = np.concatenate([self.imu[:, 0], self.field[:, 0]])
        stamps = stamps[np.isfinite(stamps)]
        if not len(stamps):
            return self
        first = float(stamps.min())
        shift = FIRST_STAMP - first if first <= 0.0 < np.ptp(stamps) else 0.0
        parts = []
        for table in (self.imu, self.field, self.yaw):
            since = table[:, 0] - first
            part = table[(since >= start) & (since < stop)]
            part[:, 0] += shift
            parts.append(part)
        imu, field, yaw = parts
        moved = tuple(
            each._replace(stamp=each.stamp + shift)
            for each in self.travel
            if start <= each.stamp - first < stop
        )
        return replace(self, imu=imu, field=field, yaw=yaw, travel=moved)

    def turned(self, pose: FloatArray) -> Recording:
        """Return the recording in the vehicle's axes; `pose` (3, 3) is that of the sensors."""
        imu, raw = self.imu.copy(), self.field.copy()
        for vectors in (imu[:, 1:4], imu[:, 4:7], raw[:, 1:4]):
            vectors[:] = vectors @ pose.T
        return replace(self, imu=imu, field=raw)


def _monotonic(stamps: FloatArray) -> FloatArray:
    """Return stamps (n,) of a clock that is never set back, for sorting two streams.

    Where the clock was set back for good, later stamps are shifted. Streams with stamps of the same
    clock thus keep their common order.
    """
    if not len(stamps):
        return stamps
    moments, newest, shift = stamps.copy(), -math.inf, 0.0
    edges = [0, *(np.flatnonzero(np.diff(stamps) < 0.0) + 1).tolist(), len(stamps)]
    for first, end in pairwise(edges):
        if (stamps[first : first + STREAMS.restart_after] + shift < newest).all():
            shift = newest - float(stamps[first])
        moments[first:end] += shift
        newest = float(np.fmax.reduce(moments[first:end], initial=newest))
    return np.asarray(np.fmax.accumulate(moments))


def read_csv_folder(folder: Path) -> Recording:
    """Read `imu.csv` (t,ax,ay,az,gx,gy,gz) and `mag.csv` (t,mx,my,mz) of a folder.

    Without a gyro, its columns may be missing.
    """
    path = folder / "imu.csv"
    some = set(GYRO) & set(read_header(path))
    _, imu = read_columns(path, IMU_COLUMNS, *([] if some else [IMU_COLUMNS[:4]]))
    if not some:
        imu = np.column_stack([imu, np.full((len(imu), 3), math.nan)])
    _, field = read_columns(folder / "mag.csv", FIELD_COLUMNS)
    return Recording(imu, field)


LONGEST_LINE = 10_000  # characters
LATEST_STAMP = 2.0**33  # seconds, largest magnitude: the stamps of ROS end at a quarter of it
SECOND = {"": 1.0, "s": 1.0, "ms": 1e3, "us": 1e6, "µs": 1e6, "ns": 1e9}
"""One second in each unit of stamps."""
NAME_UNIT = "name their unit in the header, as in t [ms]"


def read_columns(
    path: Path, *choices: tuple[str, ...], may_be_empty: bool = False
) -> tuple[tuple[str, ...], FloatArray]:
    """Return the first of the `choices` whose columns a file has, and its table (n, columns).

    The file has a header line. Its columns may be in any order, and there may be others. The first
    column of a choice holds the stamps, returned in seconds; its header may name another unit.
    """
    header, units = zip(*_cells(path), strict=True)
    columns = next((each for each in choices if set(each) <= set(header)), None)
    if columns is None:
        missing = [name for name in choices[-1] if name not in header]
        lines_like = " or ".join(",".join(each) for each in choices)
        raise FileError(
            f"{path} has no column {', '.join(missing)}; its first line should be {lines_like}"
        )
    places = [header.index(name) for name in columns]
    unit = units[places[0]]
    if unit not in SECOND:
        raise FileError.of(path, f"has stamps in an unknown unit, {unit!r}: write s, ms, us or ns")
    return columns, read_numbers(path, places, SECOND[unit], may_be_empty)


def read_header(path: Path) -> list[str]:
    """Return the names in a file's first line, without units in square brackets."""
    return [name for name, _ in _cells(path)]


def _cells(path: Path) -> list[tuple[str, str]]:
    """Return the names in a file's first line, each with the unit in square brackets, if any."""
    with _opened(path) as handle:
        first = next(_lines(handle), "")
    cells = (cell.strip().strip('"').partition("[") for cell in first.split(_separator(first)))
    return [(name.strip(), unit.partition("]")[0].strip()) for name, _, unit in cells]


def read_numbers(
    path: Path, columns: Sequence[int], second: float = 1.0, may_be_empty: bool = False
) -> FloatArray:
    """Return some columns below a header line; the first holds stamps, returned in seconds.

    The separator is a comma, tab or semicolon; with the last two, numbers may have a decimal comma.
    `second` is one second in the unit of the first column. An incomplete last line is left out.
    """
    with _opened(path) as handle:
        lines = _lines(handle)
        header = next(lines, "")
        separator = _separator(header)
        most = header.count(separator)
        lines = (each for each in lines if each[-1] == "\n" or each.count(separator) >= most)
        if separator != ",":
            lines = (line.replace(",", ".") for line in lines)
        rows = (line for line in lines if line.partition("#")[0].strip())
        first = next(rows, None)
        if first is None:
            if may_be_empty:
                return np.empty((0, len(columns)))
            raise FileError(f"{path} holds no samples: record again")
        table = np.loadtxt(chain([first], rows), delimiter=separator, usecols=columns, ndmin=2)
    table[:, 0] /= second
    stamps = table[:, 0]
    if (np.abs(stamps[np.isfinite(stamps)]) > LATEST_STAMP).any():
        latest = f"{np.nanmax(np.abs(stamps)):.3g}"
        words = f"its stamps must be seconds, and reach {latest}: correct them, or {NAME_UNIT}"
        raise FileError.of(path, f"is damaged: {words}")
    return np.asarray(table, dtype=np.float64)


@contextlib.contextmanager
def _opened(path: Path) -> Iterator[TextIO]:
    try:
        # Spreadsheets begin a file with a byte order mark.
        with io.TextIOWrapper(open_regular(path), encoding="utf-8-sig") as handle:
            yield handle
    except OSError as error:
        raise FileError(f"cannot read {path}: {error.strerror or error}") from error
    except ValueError as error:
        raise FileError.of(path, f"is damaged: {error}") from error
    except IndexError as error:  # numpy before 1.23
        raise FileError.of(path, "is damaged: a line has too few columns") from error


def _separator(header: str) -> str:
    return next((mark for mark in "\t;" if mark in header), ",")


def _lines(handle: TextIO) -> Iterator[str]:
    """Yield the lines, with a limit of their length: an endless line would fill the memory."""
    while line := handle.readline(LONGEST_LINE):
        if len(line) == LONGEST_LINE:
            raise ValueError(f"a line has {LONGEST_LINE} characters or more")
        yield line


def travel_of(
    travel: Iterable[TravelSample | Fix],
) -> tuple[tuple[TravelSample, ...], Place | None]:
    """Return fixes and other samples sorted by stamp, and the place of the first good fix."""
    plane = LocalPlane()
    samples = (plane.position(each) if isinstance(each, Fix) else each for each in travel)
    found = [sample for sample in samples if sample is not None]
    return tuple(sorted(found, key=lambda sample: sample.stamp)), plane.origin


def read_travel(folder: Path) -> tuple[tuple[TravelSample, ...], Place | None]:
    """Read `odom.csv` (t,speed) and `gps.csv` (t,latitude,longitude or t,east,north) of a folder.

    Both are optional, each with a header line. Units are seconds, m/s (negative backwards), degrees
    and metres.
    """
    found = list[TravelSample | Fix]()
    if (folder / "odom.csv").exists():
        _, rows = read_columns(folder / "odom.csv", ("t", "speed"))
        found += [SpeedSample(*row) for row in rows.tolist()]
    if (folder / "gps.csv").exists():
        fix, plane = ("t", "latitude", "longitude", "altitude"), ("t", "east", "north")
        columns, rows = read_columns(folder / "gps.csv", fix, fix[:3], plane)
        if columns == plane:
            found += [PositionSample(*row) for row in rows.tolist()]
        else:
            found += [
                Fix(True, latitude, longitude, height[0] if height else math.nan, stamp)
                for stamp, latitude, longitude, *height in rows.tolist()
            ]
    return travel_of(found)


NEEDED = ("t", "mx", "my", "mz", "ax", "ay", "az")
GYRO = ("gx", "gy", "gz")
COLUMNS = {
    "t": "s",
    **dict.fromkeys(("mx", "my", "mz"), "T"),
    **dict.fromkeys(("ax", "ay", "az"), "m/s^2"),
    **dict.fromkeys(GYRO, "rad/s"),
    "believed": "1/0",
}
"""Name and unit of each column; a header cell reads `mx [T]`."""

REMEDY = "Choose a writable folder, or correct its permissions."


def write_samples(path: Path, window: Window, inliers: BoolArray | None = None) -> None:
    """Write a window, every number at full precision.

    Without a gyro, the columns of the rate hold `nan`. `inliers` (n,) are the samples that the fit
    used; None without a fit.
    """
    n = len(window)
    rate = np.full((n, 3), np.nan) if window.angular_rate is None else window.angular_rate
    marks = [0] * n if inliers is None else [int(mark) for mark in inliers]
    numbers = np.column_stack([window.time, window.field, window.specific_force, rate]).tolist()
    lines = [",".join(f"{name} [{unit}]" for name, unit in COLUMNS.items())]
    lines += [
        ",".join([*map(repr, row), str(mark)]) for row, mark in zip(numbers, marks, strict=True)
    ]
    write_atomically(path, "\n".join(lines) + "\n", REMEDY)


def read_samples(path: Path) -> Window:
    """Read the window of a turn, outliers included.

    The header has at least t, mx, my, mz, ax, ay and az, in any order, with or without units in
    brackets. The units are SI.
    """
    _, table = read_columns(path, NEEDED + GYRO, NEEDED, may_be_empty=True)
    rate = table[:, 7:] if table.shape[1] > 7 and not np.isnan(table[:, 7:]).all() else None
    try:
        return Window(table[:, 0], table[:, 1:4], table[:, 4:7], rate)
    except ValueError as error:
        raise FileError.of(path, f"is damaged: {error}") from error
