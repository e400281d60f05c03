"""Common parts of the logs of autopilots and phones: limits, axes, and the choice of sensors."""

from __future__ import annotations

import contextlib
import importlib
import io
import math
import os
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import KW_ONLY, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from magcal_ros.core.earth_field.reference import Fix
from magcal_ros.core.geometry.arrays import FloatArray
from magcal_ros.core.samples.streams import VelocitySample
from magcal_ros.files.disk import FileError, damage_in_words, open_regular, printable
from magcal_ros.files.recording import Recording, travel_of
from magcal_ros.files.wire import RECEIVER_SPEED_SIGMA

GIGABYTE = LARGEST_LOG = 1 << 30
"""Bytes: half a day of an autopilot's usual log. Its samples and index are kept in memory."""

LONGEST_READING = 600.0
"""Seconds. The libraries skip damaged bytes one by one, which may take days."""

FLU_FROM_FRD = np.array([1.0, -1.0, -1.0])
"""Signs between forward-right-down and forward-left-up axes."""

FIX_3D = 3
"""Smallest type of a receiver's fix with a usable place."""

Progress = Callable[[float], None]  # is called with the fraction that has been read, 0 to 1


STANDARD_ERROR = 2  # file descriptor

EVERY = 1000  # messages, or pieces of a file, between two checks of the time


class Deadline(io.TextIOBase):
    """Ends a reading that takes too long, reports its progress, and discards its output."""

    def __init__(self, path: Path, progress: Progress | None) -> None:
        super().__init__()
        self._path, self._progress = path, progress
        self._end = time.monotonic() + LONGEST_READING

    def report(self, share: float) -> None:
        """Check the time, and report the fraction that has been read, 0 to 1."""
        self.check()
        if self._progress is not None:
            self._progress(share)

    def check(self) -> None:
        """Raise FileError if the time is over."""
        if time.monotonic() > self._end:
            raise FileError(
                f"reading {printable(str(self._path))} takes longer than {LONGEST_READING:g} s: it "
                "is damaged or too long. Cut it with the autopilot's own tools, or record again"
            )

    def write(self, text: str) -> int:
        """Check the time: libraries print a line for each damaged part."""
        self.check()
        return len(text)


@dataclass
class Sensor:
    """An accelerometer or a magnetometer of a log."""

    rows: FloatArray  # as in `Recording`: SI units, forward-left-up axes
    unhealthy: int = 0
    """Number of samples left out because the autopilot calls the sensor unhealthy in them."""
    frame: str = ""  # the name that is stored in a calibration, for `export`
    notes: list[str] = field(default_factory=list)  # for the user if the sensor is chosen


@dataclass
class Sensors:
    """All accelerometers or all magnetometers of a log, by number."""

    name: str  # in this kind of log
    remedy: str  # what to do if the log has no such sensor
    health: str = ""  # how the log marks samples of an unhealthy sensor
    _: KW_ONLY
    found: dict[int, Sensor] = field(default_factory=dict)
    order: Sequence[int] = ()
    """The order of preference; sensors that are not in it follow by number."""
    reason: str = ""  # why the first sensor in `order` is preferred

    def called(self, number: int) -> str:
        """Return the name of a sensor."""
        return f"{self.name}[{number}]"

    def choose(self, path: Path, kind: str, option: str, wanted: str, notes: list[str]) -> int:
        """Return the number of the sensor to use, and add what the user should know to `notes`."""
        rank = {number: place for place, number in enumerate(self.order)}
        numbers = sorted(self.found, key=lambda number: (rank.get(number, len(rank)), number))
        every = ", ".join(map(self.called, sorted(numbers)))
        if wanted:
            found = [k for k in numbers if wanted in (self.called(k), str(k))]
            if not found:
                words = f"has no {printable(wanted)}; it has: {every or 'none'}"
                raise FileError.of(path, f"{words}. Choose with {option}")
            numbers = found
        if not numbers:
            raise FileError.of(path, f"has no {self.name} data: {self.remedy}")
        faults = {k: words for k in numbers if (words := self._fault(k))}
        why = "; ".join(faults.values())
        if len(faults) == len(numbers):
            remedy = self.remedy[:1].upper() + self.remedy[1:]
            raise FileError.of(path, f"has no working {kind}: {why}. {remedy}")
        chosen = next(k for k in numbers if k not in faults)
        if len(numbers) > 1:
            why = f" ({why})" if why else ""
            reason = f", {self.reason}" if self.reason and chosen == self.order[0] else ""
            notes.append(
                f"the log has {every}{why}: {self.called(chosen)} is used{reason}; choose another "
                f"with {option}"
            )
        sensor = self.found[chosen]
        if sensor.unhealthy:
            notes.append(
                f"{sensor.unhealthy} of {sensor.unhealthy + len(sensor.rows)} samples of "
                f"{self.called(chosen)} are left out: the autopilot calls it unhealthy in them "
                f"({self.health})"
            )
        notes += sensor.notes
        return chosen

    def _fault(self, number: int) -> str:
        """Return why a sensor does not work; empty if it does."""
        rows, unhealthy = self.found[number].rows, self.found[number].unhealthy
        if varies(rows[:, 1:4]):
            return ""
        if unhealthy and not len(rows):
            return (
                f"the autopilot calls {self.called(number)} unhealthy in all its {unhealthy} "
                f"samples ({self.health}): the sensor sends no readings"
            )
        return f"{self.called(number)} holds one value, or none, in all its {len(rows)} samples"


@dataclass
class LogTables:
    """The contents of a log."""

    imus: Sensors
    fields: Sensors
    fixes: list[Fix] = field(default_factory=list)
    velocities: list[VelocitySample] = field(default_factory=list)
    yaw: FloatArray = field(default_factory=lambda: np.empty((0, 2)))
    """Stamp (s) and the autopilot's yaw (rad, ENU, true north). Shape (n, 2)."""
    notes: list[str] = field(default_factory=list)

    def take_fix(self, fix: Fix, speed: float, course: float) -> None:
        """Add a fix, with speed over ground (m/s) and course (rad, clockwise of north), or NaN."""
        self.fixes.append(fix)
        if fix.has_fix and math.isfinite(speed + course):
            east, north = speed * math.sin(course), speed * math.cos(course)
            moving = VelocitySample(fix.stamp, east, north, RECEIVER_SPEED_SIGMA)
            self.velocities.append(moving)

    def recording(self, path: Path, imu: str = "", mag: str = "") -> Recording:
        """Choose the sensors and return their recording; FileError if none gives data."""
        notes = list(self.notes)
        one = self.imus.choose(path, "accelerometer", "--imu", imu, notes)
        other = self.fields.choose(path, "magnetometer", "--mag", mag, notes)
        travel, place = travel_of([*self.velocities, *self.fixes])
        return Recording(
            _in_order(self.imus.found[one].rows),
            _in_order(self.fields.found[other].rows),
            travel=travel,
            place=place,
            imu_topic=self.imus.called(one),
            field_topic=self.fields.called(other),
            field_frame=self.fields.found[other].frame,
            yaw=_in_order(self.yaw[np.isfinite(self.yaw).all(axis=1)]),
            notes=tuple(notes),
        )


def varies(vectors: FloatArray) -> bool:
    """Whether the vectors change: a stuck or missing sensor repeats one value."""
    finite = vectors[np.isfinite(vectors).all(axis=1)]
    return len(finite) > 1 and bool(np.ptp(finite, axis=0).any())


def most_common(numbers: FloatArray) -> int:
    """Return the most common number of an array; zero if it is empty."""
    values, counts = np.unique(numbers, return_counts=True)
    return int(values[counts.argmax()]) if len(values) else 0


def symmetric(diagonal: Iterable[float], off_diagonal: Iterable[float]) -> FloatArray:
    """Return the symmetric matrix (3, 3) with this diagonal and the elements xy, xz and yz."""
    (x, y, z), (xy, xz, yz) = diagonal, off_diagonal
    return np.array([[x, xy, xz], [xy, y, yz], [xz, yz, z]])


def _in_order(table: FloatArray) -> FloatArray:
    """Return the rows sorted by stamp: loggers with several threads do not keep the order."""
    return table[np.argsort(table[:, 0], kind="stable")]


def library(path: Path, module: str, extra: str) -> Any:
    """Return a module of an optional library; a FileError says how to install it."""
    name = module.partition(".")[0]
    try:
        importlib.import_module(name)
        return importlib.import_module(module)
    except ImportError as error:
        raise FileError(
            f"reading {printable(str(path))} needs the Python library {name}: "
            f"pip install 'magcal_ros[{extra}]', or pip install {name}"
        ) from error


def first_bytes(path: Path, count: int) -> bytes:
    """Return the first bytes of a log; a FileError if it cannot be read or is too large."""
    try:
        with open_regular(path) as handle:
            size, head = os.fstat(handle.fileno()).st_size, handle.read(count)
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise FileError(f"cannot read {printable(str(path))}: {reason}") from error
    if not size:
        raise FileError.of(path, "is empty: copy or download it again")
    if size > LARGEST_LOG:
        limit = f"logs up to {LARGEST_LOG / GIGABYTE:g} GiB are read"
        words = f"has {size / GIGABYTE:.1f} GiB, and {limit}: record the turn in a log of its own"
        raise FileError.of(path, words)
    return head


@contextlib.contextmanager
def limited(path: Path, progress: Progress | None) -> Iterator[Deadline]:
    """Discard the output of a library within a deadline, and raise its errors as `FileError`."""
    deadline = Deadline(path, progress)
    with (
        damage_in_words(path, "no log of its kind", "Download it again"),
        contextlib.redirect_stdout(deadline),
        contextlib.redirect_stderr(deadline),
    ):
        yield deadline


@contextlib.contextmanager
def without_native_errors() -> Iterator[None]:
    """Discard what a library's compiled code writes to the process's standard error."""
    try:
        kept = os.dup(STANDARD_ERROR)
    except OSError:  # it is closed
        yield
        return
    nowhere = os.open(os.devnull, os.O_WRONLY | os.O_CLOEXEC)
    try:
        os.dup2(nowhere, STANDARD_ERROR)
        yield
    finally:
        os.dup2(kept, STANDARD_ERROR)
        os.close(nowhere)
        os.close(kept)
