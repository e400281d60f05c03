"""A recording of any kind, opened: a bag, a CSV folder, or a log."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import AbstractContextManager, nullcontext
from dataclasses import replace
from pathlib import Path
from typing import TypeAlias

import numpy as np

from magcal_ros.core.earth_field.wmm import Place
from magcal_ros.core.errors import Misuse
from magcal_ros.core.geometry.arrays import FloatArray
from magcal_ros.core.samples.streams import HeadingSample, TravelSample
from magcal_ros.core.session.recorded import Reading
from magcal_ros.files import ardupilot, phone, px4
from magcal_ros.files.bags import Bag, open_bag
from magcal_ros.files.disk import FileTrouble, plain
from magcal_ros.files.logs import Progress
from magcal_ros.files.recording import Recording, read_csv_folder, read_travel

FIRST_STAMP = 1.0
"""Seconds. A drive whose time begins at zero or before is moved here: a zero stamp is none."""


class HeldDrive:
    """A recording in memory, read like a `Bag`; `start`, `stop` are seconds from its beginning."""

    imu_frame = ""

    def __init__(self, recording: Recording, start: float, stop: float) -> None:
        self._recording = _cut(recording, start, stop)
        self.imu_topic, self.field_topic = recording.imu_topic, recording.field_topic
        self.field_frame, self.notes = recording.field_frame, recording.notes
        self._read = 0

    @property
    def share(self) -> float:
        """How much of it has been read, 0 to 1."""
        return self._read / max(len(self._recording.imu) + len(self._recording.field), 1)

    def readings(self) -> Iterator[Reading]:
        """Yield the samples of both sensors in the order of their stamps."""
        self._read = 0
        for sample in self._recording.samples():
            self._read += 1
            yield sample

    def place(self) -> Place | None:
        """Return where its first good fix was; None without one."""
        return self._recording.place

    def begun(self) -> float:
        """Return the stamp of the first sample, seconds."""
        imu = self._recording.imu
        return float(imu[0, 0]) if len(imu) else 0.0

    def travel(self) -> list[TravelSample]:
        """Return the samples of receiver and wheels, by stamp."""
        return list(self._recording.travel)

    def yaw(self) -> FloatArray:
        """Return stamps and the yaws of an autopilot (rad, ENU, true north), (n, 2)."""
        return self._recording.yaw

    def currents(self) -> list[tuple[float, float]]:
        """Return the currents of the battery: only bags have them."""
        return []

    def headings(self, topic: str) -> list[HeadingSample]:
        """Raise a Misuse: only bags have topics."""
        raise Misuse(f"{plain(topic)}: only a bag has a topic with headings")


Source: TypeAlias = Bag | HeldDrive
"""A recording of any kind, opened."""


def open_recording(
    path: Path,
    *,
    imu: str = "",
    field: str = "",
    start: float = 0.0,
    stop: float = math.inf,
    imu_pose: FloatArray | None = None,
    progress: Progress | None = None,
) -> AbstractContextManager[Source]:
    """Open a bag, a CSV folder, an autopilot's log or a phone's folder.

    `imu` and `field` are topics of a bag or sensors of a log; empty for the only one of the right
    type, and of a log for the first that gives data. `start` and `stop` are seconds from the
    beginning. `imu_pose` (3, 3) is the pose of the sensors in the vehicle, of all but a bag.
    `progress` takes the share that is read. FileTrouble if it cannot be read, Misuse if the topics
    are ambiguous.
    """
    if not path.exists():
        raise FileTrouble(f"cannot read {path}: there is no such file or folder")
    recording = _held(path, imu, field, progress)
    if recording is None:
        if imu_pose is not None:
            raise Misuse(
                "--imu-rpy-deg is for logs and CSV folders: the frames of a bag are the driver's"
            )
        return open_bag(path, imu, field, start, stop)
    return nullcontext(
        HeldDrive(recording if imu_pose is None else recording.turned(imu_pose), start, stop)
    )


def _held(path: Path, imu: str, field: str, progress: Progress | None) -> Recording | None:
    """Return a recording that is read whole; None of a bag."""
    kind = path.suffix.lower()
    if path.is_file() and kind in ardupilot.SUFFIXES:
        return ardupilot.read_ardupilot(path, imu, field, progress)
    if path.is_file() and kind == ".ulg":
        return px4.read_px4(path, imu, field, progress)
    is_csv = (path / "imu.csv").exists() or (path / "mag.csv").exists()
    if not is_csv and not phone.is_phone_folder(path):
        return None
    if imu or field:
        raise Misuse(f"{path} is a CSV folder without topics: leave out --imu and --mag")
    if not is_csv:
        return phone.read_phone(path)
    travel, place = read_travel(path)
    return replace(read_csv_folder(path), travel=travel, place=place)


def _cut(recording: Recording, start: float, stop: float) -> Recording:
    """Return the span, with every stamp above zero."""
    stamps = np.concatenate([recording.imu[:, 0], recording.field[:, 0]])
    stamps = stamps[np.isfinite(stamps)]
    if not len(stamps):
        return recording
    first = float(stamps.min())
    shift = FIRST_STAMP - first if first <= 0.0 < np.ptp(stamps) else 0.0
    parts = []
    for table in (recording.imu, recording.field, recording.yaw):
        since = table[:, 0] - first
        part = table[(since >= start) & (since < stop)]
        part[:, 0] += shift
        parts.append(part)
    imu, field, yaw = parts
    heard = tuple(
        each._replace(stamp=each.stamp + shift)
        for each in recording.travel
        if start <= each.stamp - first < stop
    )
    return replace(recording, imu=imu, field=field, yaw=yaw, travel=heard)
