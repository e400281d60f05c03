"""A recording without what the motors of a calibration add, as a node takes it off live."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from typing import TypeVar

import numpy as np

from magcal_ros.core.calibration.calibration import Calibration
from magcal_ros.core.heading.compass import Compass
from magcal_ros.core.heading.running import MotionSense
from magcal_ros.core.samples.streams import FieldSample, ImuSample, SpeedSample, TravelSample
from magcal_ros.core.up import UpFollower

Reading = TypeVar("Reading", bound=ImuSample | FieldSample | None)

SILENT = 1.5
"""Seconds without a message after which speed and current count as unknown."""


def without_motors(
    readings: Iterable[Reading],
    calibration: Calibration,
    travel: Iterable[TravelSample],
    currents: Sequence[tuple[float, float]],
) -> Iterator[Reading | FieldSample]:
    """Yield the readings; raw fields are those of the robot with its motors off.

    Parameters
    ----------
    readings : iterable
        In the order in which they were recorded.
    calibration : Calibration
        Where it knows no motors, nothing changes.
    travel : iterable of TravelSample
        By stamp; the wheels' speeds are used.
    currents : sequence of (float, float)
        Stamps, seconds, and amperes of the battery, by stamp.
    """
    if calibration.motors is None:
        yield from readings
        return
    compass, up, sense = Compass(calibration), UpFollower(), MotionSense()
    speeds = [(each.stamp, each.speed) for each in travel if isinstance(each, SpeedSample)]
    speed, current = _Newest(speeds), _Newest(currents)
    back = calibration.correction
    for reading in readings:
        if isinstance(reading, ImuSample):
            up.add(reading)
        elif isinstance(reading, FieldSample):
            stamp = reading.stamp
            up.add_field(stamp, reading.field)
            rate = up.rate if up.is_propagated else None
            inputs = speed.at(stamp), current.at(stamp)
            running = sense.at(stamp, rate, up.is_at_rest, *inputs)
            field, _ = compass.at_rest(stamp, reading.field, rate, running)
            x, y, z = back.undo(np.array(field)).tolist()
            yield FieldSample(stamp, (x, y, z))
            continue
        yield reading


class _Newest:
    """The newest of some values by stamp."""

    def __init__(self, values: Sequence[tuple[float, float]]) -> None:
        self._values, self._next = values, 0

    def at(self, stamp: float) -> float:
        """Return the value at a stamp, seconds; NaN where it is unknown. Stamps must increase."""
        values = self._values
        while self._next < len(values) and values[self._next][0] <= stamp:
            self._next += 1
        since, value = values[self._next - 1] if self._next else (-math.inf, math.nan)
        return value if stamp - since < SILENT else math.nan
