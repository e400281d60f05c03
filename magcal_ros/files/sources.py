"""Open a recording of any kind (a bag, a CSV folder or a log), and repair its readings.

Stamps that come in bursts are spread evenly, and a slow IMU is interpolated.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import replace
from itertools import chain, islice
from pathlib import Path
from typing import TypeAlias

import numpy as np

from magcal_ros.core.calibration.calibration import Calibration
from magcal_ros.core.errors import Reason, Refusal, UsageError
from magcal_ros.core.geometry.arrays import FloatArray
from magcal_ros.core.geometry.vec3 import interpolate, length
from magcal_ros.core.samples.bursts import bursts_in_words, spread_bursts
from magcal_ros.core.samples.samples_tuning import STREAMS
from magcal_ros.core.samples.streams import FieldSample, ImuSample
from magcal_ros.core.samples.units import slow_field_words, slow_words
from magcal_ros.core.session.recorded import Reading, without_motors
from magcal_ros.files import ardupilot, phone, px4
from magcal_ros.files.bags import Bag, open_bag
from magcal_ros.files.disk import FileError
from magcal_ros.files.logs import Progress
from magcal_ros.files.recording import NAME_UNIT, Recording, read_csv_folder, read_travel

Source: TypeAlias = Bag | Recording  # an open recording of any kind


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

    `imu` and `field` are topics of a bag or sensors of a log. If empty, the only topic of the right
    type is used, or the first sensor with data. `start` and `stop` are seconds from the beginning.
    `imu_pose` (3, 3) is the pose of the sensors in the vehicle; bags do not take it. `progress` is
    called with the share that has been read. FileError if the recording cannot be read, UsageError
    if the topics are ambiguous.
    """
    if not path.exists():
        raise FileError(f"cannot read {path}: there is no such file or folder")
    recording = _read_whole(path, imu, field, progress)
    if recording is None:
        if imu_pose is not None:
            raise UsageError(
                "--imu-rpy-deg is for logs and CSV folders: the frames of a bag are the driver's"
            )
        return open_bag(path, imu, field, start, stop)
    turned = recording if imu_pose is None else recording.turned(imu_pose)
    return nullcontext(turned.cut(start, stop))


PACKED = (".zip", ".gz", ".tgz", ".tar", ".xz", ".7z")
"""Suffixes of archives, as phones export and as bags are passed on."""


def _read_whole(path: Path, imu: str, field: str, progress: Progress | None) -> Recording | None:
    """Return a recording that is read into memory; None for a bag."""
    kind = path.suffix.lower()
    if path.is_file() and kind in ardupilot.SUFFIXES:
        return ardupilot.read_ardupilot(path, imu, field, progress)
    if path.is_file() and kind == ".ulg":
        return px4.read_px4(path, imu, field, progress)
    if path.is_file() and kind in PACKED:
        raise FileError.of(path, "is packed: unpack it, and name the result")
    if path.is_file() and kind == ".csv":
        raise FileError.of(path, "is one table of a recording: name its folder")
    is_csv = (path / "imu.csv").exists() or (path / "mag.csv").exists()
    if not is_csv and not phone.is_phone_folder(path):
        return None
    if imu or field:
        raise UsageError(f"{path} is a CSV folder without topics: leave out --imu and --mag")
    if not is_csv:
        return phone.read_phone(path)
    travel, place = read_travel(path)
    return replace(read_csv_folder(path), travel=travel, place=place)


EXAMINED = 20_000  # messages from which bursts of stamps and the rate of the IMU are recognised
SLOWEST = 1.5  # seconds, longest usual gap of an IMU that is interpolated

TURN_WITHIN = math.radians(20.0)
"""Largest turn between samples of a slow IMU: it makes a mean of the level field 0.5% too small."""


class RepairedReadings:
    """The readings of a recording, with even stamps in place of those in bursts.

    A recording is read once, and twice more if its stamps come in bursts. An IMU of 1 to 5 Hz is
    too slow to be paired with the field, and is interpolated in slow turns. `notes` lists the
    repairs, and is complete when everything has been read.
    """

    def __init__(
        self, source: Source, for_drive: bool = False, known: Calibration | None = None
    ) -> None:
        self._source, self._for_drive, self._known = source, for_drive, known
        self.read = [0, 0]
        """Numbers of messages of IMU and field read so far, also of those without acceleration."""
        self.notes: list[str] = []

    @property
    def share(self) -> float:
        """Fraction of the recording that has been read, 0 to 1."""
        return min(1.0, sum(self.read) / max(self._source.count, 1))

    def __iter__(self) -> Iterator[Reading]:
        """Yield the samples in the order in which they were recorded."""
        if self._known is None or self._known.motors is None:
            return self._repaired()
        inputs = self._source.travel, self._source.currents
        return without_motors(self._repaired(), self._known, *inputs)

    def _repaired(self) -> Iterator[Reading]:
        readings = self._source.readings()
        examined = list(islice(readings, EXAMINED))
        self.read = [0, 0]
        stamps = _stamps(examined)
        if self._for_drive and (slow := slow_field_words(_usual_gap(stamps[1]))):
            raise Refusal(Reason.TOO_FEW_SAMPLES, f"{self._source.field_topic}: {slow}")
        gap = _usual_gap(stamps[0])
        slow = slow_words(gap)
        if slow or not any(map(bursts_in_words, stamps)):
            every = self._counted(chain(examined, readings))
            yield from self._interpolated(every, gap, slow) if slow else every
            return
        del readings, examined
        stamps = _stamps(self._source.readings())
        even = [spread_bursts(each) for each in stamps]
        self._note(stamps, even)
        pairs = zip(stamps, even, strict=True)
        repaired = [iter((old if new is None else new).tolist()) for old, new in pairs]
        for reading in self._counted(self._source.readings()):
            stamp = repaired[isinstance(reading, FieldSample)]
            yield reading and reading._replace(stamp=next(stamp))

    def _counted(self, readings: Iterable[Reading]) -> Iterator[Reading]:
        for reading in readings:
            self.read[isinstance(reading, FieldSample)] += 1
            yield reading

    def _interpolated(
        self, readings: Iterable[Reading], gap: float, slow: str
    ) -> Iterator[Reading]:
        """Yield readings with a slow IMU interpolated, and without the field in fast turns."""
        if gap > SLOWEST:
            is_table = self._source.imu_topic == Recording.imu_topic
            remedy = f". If the stamps are not seconds, {NAME_UNIT}" if is_table else ""
            raise Refusal(Reason.TOO_FEW_SAMPLES, f"{self._source.imu_topic}: {slow}{remedy}")
        last: ImuSample | None = None
        is_fast, fields, left_out = False, 0, 0
        for reading in readings:
            if isinstance(reading, ImuSample):
                is_fast = not gap * length(reading.rate) < TURN_WITHIN
                if last is not None and not is_fast:
                    yield from _between(last, reading, SLOWEST * gap)
                last = reading
            elif reading is not None:
                fields += 1
                left_out += is_fast
                if is_fast:
                    continue
            yield reading
        self.notes.append(
            f"{self._source.imu_topic}: {slow}. Unlike in the node, it was interpolated here; "
            f"{left_out} of {fields} field samples were left out, because between two IMU samples "
            f"the robot turned by more than {math.degrees(TURN_WITHIN):.0f}° or the gyro is absent"
        )

    def _note(self, stamps: Sequence[FloatArray], even: Sequence[FloatArray | None]) -> None:
        """Note which topics were repaired; topics with the same fault share a line."""
        topics: dict[str, list[str]] = {}
        names = self._source.imu_topic, self._source.field_topic
        for name, old, new in zip(names, stamps, even, strict=True):
            if new is not None:
                topics.setdefault(bursts_in_words(old), []).append(name)
        self.notes += [
            f"{' and '.join(them)}: {words}; here the stamps were spread evenly (a node cannot)"
            for words, them in topics.items()
        ]


def _stamps(readings: Iterable[Reading]) -> tuple[FloatArray, FloatArray]:
    stamps: tuple[list[float], list[float]] = [], []
    for reading in readings:
        if reading is not None:
            stamps[isinstance(reading, FieldSample)].append(reading.stamp)
    imu, field = map(np.array, stamps)
    return imu, field


def _usual_gap(stamps: FloatArray) -> float:
    """Return the median gap, seconds; zero for less than two samples."""
    return float(np.median(np.diff(stamps))) if len(stamps) > 1 else 0.0


def _between(last: ImuSample, sample: ImuSample, longest: float) -> Iterator[ImuSample]:
    """Yield interpolated samples in a gap too long for pairing; none if it is over `longest`."""
    gap = sample.stamp - last.stamp
    if not STREAMS.max_gap < gap <= longest:
        return
    parts = math.ceil(gap / (0.5 * STREAMS.max_gap))
    for part in range(1, parts):
        share = part / parts
        force = interpolate(last.force, sample.force, share)
        rate = interpolate(last.rate, sample.rate, share)
        yield ImuSample(last.stamp + share * gap, force, rate, is_measured=False)
