"""A recording of any kind, opened: a bag or a CSV folder."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from typing import Protocol

import numpy as np

from magcal_ros.core.earth_field.wmm import Place
from magcal_ros.core.errors import Misuse
from magcal_ros.core.samples.travel_samples import TravelSample
from magcal_ros.core.session.recorded import Reading
from magcal_ros.files.atomic import FileTrouble
from magcal_ros.files.bags import open_bag
from magcal_ros.files.recording import Recording, read_csv_folder
from magcal_ros.files.travel_tables import read_travel

FIRST_STAMP = 1.0
"""Seconds. A drive whose time begins at zero or before is moved here: a zero stamp is none."""


class Source(Protocol):
    """A recording to be read once.

    Attributes
    ----------
    imu_topic, field_topic : str
        What to call the two streams, as recorded.
    imu_frame, field_frame : str
        Newest `frame_id` of each; empty while unknown.
    share : float
        How much of it has been read, 0 to 1.
    """

    imu_topic: str
    field_topic: str
    imu_frame: str
    field_frame: str

    @property
    def share(self) -> float:
        """How much of it has been read, 0 to 1."""

    def place(self) -> Place | None:
        """Return where it was recorded, by its first good fix; None if it holds none."""

    def begun(self) -> float:
        """Return when it was recorded, seconds: its beginning."""

    def travel(self) -> list[TravelSample]:
        """Return what receiver and wheels said, by stamp; empty if nothing."""

    def readings(self) -> Iterator[Reading]:
        """Yield what the sensors said in the order in which it was recorded."""


class CsvDrive:
    """A CSV folder as a source.

    Parameters
    ----------
    folder : Path
        Holds `imu.csv` and `mag.csv`; speed and fixes in `odom.csv` and `gps.csv`, if it has them.
    start, stop : float
        Seconds from the recording's first sample.
    """

    imu_frame = field_frame = ""

    def __init__(self, folder: Path, start: float, stop: float) -> None:
        self.imu_topic, self.field_topic = "imu.csv", "mag.csv"
        tables = read_travel(folder)
        self._recording, self._travel = _cut(read_csv_folder(folder), tables.travel, start, stop)
        self._place = tables.place
        self._read = 0

    @property
    def share(self) -> float:
        """How much of it has been read, 0 to 1."""
        return self._read / max(len(self._recording.imu) + len(self._recording.field), 1)

    def place(self) -> Place | None:
        """Return where its first good fix was; None without one."""
        return self._place

    def begun(self) -> float:
        """Return the stamp of the first sample, seconds."""
        imu = self._recording.imu
        return float(imu[0, 0]) if len(imu) else 0.0

    def travel(self) -> list[TravelSample]:
        """Return what receiver and wheels said, by stamp; empty if nothing."""
        return self._travel

    def readings(self) -> Iterator[Reading]:
        """Yield the samples of both sensors in the order of their stamps."""
        self._read = 0
        for sample in self._recording.samples():
            self._read += 1
            yield sample


def open_recording(
    path: Path,
    *,
    imu: str = "",
    field: str = "",
    start: float = 0.0,
    stop: float = math.inf,
) -> AbstractContextManager[Source]:
    """Open a rosbag2 (folder, .mcap, .db3), a ROS 1 bag or a CSV folder.

    Parameters
    ----------
    path : Path
        The recording.
    imu, field : str
        Topics of a bag; empty to take the only one of the right type.
    start, stop : float
        Seconds from the recording's beginning, by the bag's own clock.

    Raises
    ------
    FileTrouble
        If it cannot be read; the text says what to do.
    Misuse
        If a bag has several topics that would do.
    """
    if not path.exists():
        raise FileTrouble(f"cannot read {path}: there is no such file or folder")
    if (path / "imu.csv").exists() or (path / "mag.csv").exists():
        if imu or field:
            raise Misuse(f"{path} is a CSV folder without topics: leave out --imu and --mag")
        return nullcontext(CsvDrive(path, start, stop))
    return open_bag(path, imu, field, start, stop)


def _cut(
    recording: Recording, travel: Sequence[TravelSample], start: float, stop: float
) -> tuple[Recording, list[TravelSample]]:
    """Return the span, with every stamp above zero."""
    stamps = np.concatenate([recording.imu[:, 0], recording.field[:, 0]])
    stamps = stamps[np.isfinite(stamps)]
    if not len(stamps):
        return recording, list(travel)
    first = float(stamps.min())
    shift = FIRST_STAMP - first if first <= 0.0 < np.ptp(stamps) else 0.0
    parts = []
    for table in (recording.imu, recording.field):
        since = table[:, 0] - first
        part = table[(since >= start) & (since < stop)]
        part[:, 0] += shift
        parts.append(part)
    heard = [each for each in travel if start <= each.stamp - first < stop]
    return Recording(*parts), [each._replace(stamp=each.stamp + shift) for each in heard]
