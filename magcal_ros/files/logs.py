"""Common parts of the logs of autopilots and phones: limits, axes, and the choice of sensors."""

from __future__ import annotations

import contextlib
import importlib
import io
import math
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from magcal_ros.core.earth_field.reference import Fix
from magcal_ros.core.geometry.arrays import FloatArray
from magcal_ros.core.messages import RECEIVER_SPEED_SIGMA
from magcal_ros.core.samples.streams import VelocitySample
from magcal_ros.files.disk import FileError, damage_in_words, open_regular, printable
from magcal_ros.files.recording import Recording, travel_of

GIGABYTE = LARGEST_LOG = 1 << 30
"""Bytes: half a day of an autopilot's usual log. Its samples and index are kept in memory."""

LONGEST_READING = 600.0
"""Seconds. The libraries skip damaged bytes one by one, which may take days."""

FLU_FROM_FRD = np.array([1.0, -1.0, -1.0])
"""Signs between forward-right-down and forward-left-up axes."""

FIX_3D = 3
"""Smallest type of a receiver's fix with a usable place."""

Progress = Callable[[float], None]  # is called with the fraction that has been read, 0 to 1


EVERY = 1000  # messages, or pieces of a file, between two checks of the time


class Deadline:
    """Ends a reading that takes too long, and reports its progress."""

    def __init__(self, path: Path, progress: Progress | None) -> None:
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


@dataclass(frozen=True)
class Order:
    """The order of preference of sensors; those not listed follow by number."""

    numbers: Sequence[int] = ()
    reason: str = ""
    """Why the first sensor is preferred."""


@dataclass
class LogTables:
    """The rows of a log by sensor, in the autopilot's order; SI units, forward-left-up axes."""

    imus: dict[int, FloatArray] = field(default_factory=dict)
    fields: dict[int, FloatArray] = field(default_factory=dict)
    """As in `Recording`, by the number of the sensor."""
    frames: dict[int, str] = field(default_factory=dict)
    """The name of each magnetometer that is stored in a calibration, for `export`."""
    field_notes: dict[int, list[str]] = field(default_factory=dict)
    """Notes for the user if a magnetometer is chosen."""
    imu_order: Order = Order()
    field_order: Order = Order()
    unhealthy_imus: dict[int, int] = field(default_factory=dict)
    unhealthy_fields: dict[int, int] = field(default_factory=dict)
    """Numbers of samples left out because the autopilot calls the sensor unhealthy in them."""
    fixes: list[Fix] = field(default_factory=list)
    velocities: list[VelocitySample] = field(default_factory=list)
    yaw: FloatArray = field(default_factory=lambda: np.empty((0, 2)))
    """Stamp (s) and the autopilot's yaw (rad, ENU, true north). Shape (n, 2)."""
    notes: list[str] = field(default_factory=list)


class SensorName(NamedTuple):
    """The name of a sensor in a kind of log, and the remedy if the sensor is missing."""

    name: str
    remedy: str
    health: str = ""  # how the log marks samples of an unhealthy sensor


class SensorNames(NamedTuple):
    """The names of both sensors."""

    imu: SensorName
    field: SensorName


def recording_of(
    path: Path, tables: LogTables, names: SensorNames, imu: str = "", mag: str = ""
) -> Recording:
    """Choose the sensors and return their recording; FileError if none gives data."""
    notes = list(tables.notes)
    imus = _Kind(names.imu, tables.imus, tables.unhealthy_imus, tables.imu_order, "--imu")
    one = _chosen(path, imus, imu, notes)
    fields = _Kind(names.field, tables.fields, tables.unhealthy_fields, tables.field_order, "--mag")
    other = _chosen(path, fields, mag, notes)
    notes += tables.field_notes.get(other, ())
    travel, place = travel_of([*tables.velocities, *tables.fixes])
    return Recording(
        _in_order(tables.imus[one]),
        _in_order(tables.fields[other]),
        travel=travel,
        place=place,
        imu_topic=f"{names.imu.name}[{one}]",
        field_topic=f"{names.field.name}[{other}]",
        field_frame=tables.frames.get(other, ""),
        yaw=_in_order(tables.yaw[np.isfinite(tables.yaw).all(axis=1)]),
        notes=tuple(notes),
    )


@dataclass(frozen=True)
class _Kind:
    """All accelerometers or all magnetometers of a log, by number."""

    called: SensorName
    sensors: Mapping[int, FloatArray]
    unhealthy: Mapping[int, int]
    order: Order
    option: str

    def name(self, number: int) -> str:
        return f"{self.called.name}[{number}]"

    def count(self, number: int) -> int:
        return len(self.sensors.get(number, ()))

    def works(self, number: int) -> bool:
        return self.count(number) > 0 and varies(self.sensors[number][:, 1:4])

    def fault(self, number: int) -> str:
        """Say why a sensor does not work."""
        left_out = self.unhealthy.get(number, 0)
        if left_out and not self.count(number):
            return (
                f"the autopilot calls {self.name(number)} unhealthy in all its {left_out} samples "
                f"({self.called.health}): the sensor sends no readings"
            )
        return (
            f"{self.name(number)} holds one value, or none, in all its {self.count(number)} samples"
        )


def _chosen(path: Path, kind: _Kind, wanted: str, notes: list[str]) -> int:
    """Return the number of the sensor to take."""
    name, remedy, _ = kind.called
    order, option = kind.order, kind.option
    rank = {number: place for place, number in enumerate(order.numbers)}
    numbers = sorted(
        {*kind.sensors, *kind.unhealthy},
        key=lambda number: (rank.get(number, len(rank)), number),
    )
    every = ", ".join(kind.name(k) for k in sorted(numbers))
    if wanted:
        found = [k for k in numbers if wanted in (kind.name(k), str(k))]
        if not found:
            raise FileError(
                f"{printable(str(path))} has no {printable(wanted)}; it has: {every or 'none'}. "
                f"Choose with {option}"
            )
        numbers = found
    if not numbers:
        raise FileError(f"{printable(str(path))} has no {name} data: {remedy}")
    working = [k for k in numbers if kind.works(k)]
    if not working:
        what = "magnetometer" if option == "--mag" else "accelerometer"
        faults = "; ".join(kind.fault(k) for k in numbers)
        raise FileError(
            f"{printable(str(path))} has no working {what}: {faults}. "
            f"{remedy[:1].upper()}{remedy[1:]}"
        )
    chosen = working[0]
    if len(numbers) > 1:
        dead = [kind.fault(k) for k in numbers if k not in working]
        told = f" ({'; '.join(dead)})" if dead else ""
        reason = f", {order.reason}" if order.reason and chosen == order.numbers[0] else ""
        notes.append(
            f"the log has {every}{told}: {kind.name(chosen)} is used{reason}; choose another with "
            f"{option}"
        )
    if left_out := kind.unhealthy.get(chosen, 0):
        notes.append(
            f"{left_out} of {left_out + kind.count(chosen)} samples of {kind.name(chosen)} are "
            f"left out: the autopilot calls it unhealthy in them ({kind.called.health})"
        )
    return chosen


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


def velocity(stamp: float, speed: float, course: float) -> VelocitySample:
    """Return the velocity for a speed over ground (m/s) and a course (rad, clockwise of north)."""
    east, north = speed * math.sin(course), speed * math.cos(course)
    return VelocitySample(stamp, east, north, RECEIVER_SPEED_SIGMA)


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
            size = handle.seek(0, io.SEEK_END)
            handle.seek(0)
            begun = handle.read(count)
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise FileError(f"cannot read {printable(str(path))}: {reason}") from error
    if not size:
        raise FileError(f"{printable(str(path))} is empty: copy or download it again")
    if size > LARGEST_LOG:
        raise FileError(
            f"{printable(str(path))} has {size / GIGABYTE:.1f} GiB, and logs up to "
            f"{LARGEST_LOG / GIGABYTE:g} GiB are read: record the turn in a log of its own"
        )
    return begun


@contextlib.contextmanager
def without_output(path: Path, deadline: Deadline) -> Iterator[None]:
    """Discard the output of a library, and raise its errors as `FileError`."""
    heard = _DiscardedOutput(deadline)
    with (
        damage_in_words(path, "no log of its kind", lambda: "Download it again"),
        contextlib.redirect_stdout(heard),
        contextlib.redirect_stderr(heard),
    ):
        yield


class _DiscardedOutput(io.TextIOBase):
    """Discards the output of a library, and checks the time limit at each write."""

    def __init__(self, deadline: Deadline) -> None:
        super().__init__()
        self._deadline = deadline

    def write(self, text: str) -> int:
        self._deadline.check()
        return len(text)
