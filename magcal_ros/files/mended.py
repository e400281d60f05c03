"""Recordings whose samples were stamped when a buffer was read: their stamps spread evenly."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from itertools import chain, islice

import numpy as np

from magcal_ros.core.geometry.arrays import FloatArray
from magcal_ros.core.samples.stamps import bursts_in_words, bursts_of_a_turn, long_gaps, mended
from magcal_ros.core.samples.streams import ImuSample
from magcal_ros.core.session.recorded import Reading
from magcal_ros.files.sources import Source

LOOKED_AT = 20_000
"""Messages by which it is told whether stamps come in bursts."""


class MendedReadings:
    """What the sensors of a recording said, with even stamps in place of those in bursts.

    A recording is read once, and twice more where its stamps come in bursts.

    Parameters
    ----------
    source : Source
        The recording.

    Attributes
    ----------
    notes : list of str
        What was mended, in words; complete when everything has been read.
    """

    def __init__(self, source: Source) -> None:
        self._source = source
        self.notes: list[str] = []

    def __iter__(self) -> Iterator[Reading]:
        """Yield what the sensors said in the order in which it was recorded."""
        readings = self._source.readings()
        begun = list(islice(readings, LOOKED_AT))
        if not any(map(bursts_of_a_turn, _stamps(begun))):
            yield from chain(begun, readings)
            return
        del readings, begun
        stamps = _stamps(self._source.readings())
        even = [mended(each) for each in stamps]
        self._note(stamps, even)
        imu, field = (
            iter((old if new is None else new).tolist())
            for old, new in zip(stamps, even, strict=True)
        )
        yield from _restamped(self._source.readings(), imu, field)

    def _note(self, stamps: Sequence[FloatArray], even: Sequence[FloatArray | None]) -> None:
        """Say which topics were mended; those of one driver in one line."""
        topics: dict[str, list[str]] = {}
        names = self._source.imu_topic, self._source.field_topic
        for name, old, new in zip(names, stamps, even, strict=True):
            if new is not None:
                topics.setdefault(bursts_in_words(long_gaps(old)), []).append(name)
        self.notes += [
            f"{' and '.join(them)}: {words}; here they were spread evenly, which a node cannot do"
            for words, them in topics.items()
        ]


def _stamps(readings: Iterable[Reading]) -> tuple[FloatArray, FloatArray]:
    imu: list[float] = []
    field: list[float] = []
    for reading in readings:
        if reading is not None:
            (imu if isinstance(reading, ImuSample) else field).append(reading.stamp)
    return np.array(imu), np.array(field)


def _restamped(
    readings: Iterable[Reading], imu: Iterator[float], field: Iterator[float]
) -> Iterator[Reading]:
    for reading in readings:
        if reading is None:
            yield None
        elif isinstance(reading, ImuSample):
            yield reading._replace(stamp=next(imu))
        else:
            yield reading._replace(stamp=next(field))
