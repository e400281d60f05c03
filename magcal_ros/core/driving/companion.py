"""What wheels and receiver tell along a recording, beside its sensors."""

from __future__ import annotations

import heapq
import math
from collections.abc import Iterable, Iterator

from magcal_ros.core.driving.travelling import Travelling
from magcal_ros.core.geometry.vec3 import Triple
from magcal_ros.core.samples.streams import FieldSample, ImuSample
from magcal_ros.core.samples.travel_samples import TravelSample
from magcal_ros.core.up import UpFollower

NOTHING: Triple = (0.0, 0.0, 0.0)


class Companion:
    """Goes along with a recording's sensors; without any travel it costs nothing.

    Parameters
    ----------
    travel : iterable
        What receiver and wheels said, by stamp.

    Attributes
    ----------
    own : tuple of float
        The vehicle's own acceleration at the newest IMU sample, m/s², body axes; zero where it is
        not known.
    """

    def __init__(self, travel: Iterable[TravelSample]) -> None:
        self._travel = list(travel)
        self._travelling, self._up = Travelling(), UpFollower()
        self.own = NOTHING

    def along(
        self, readings: Iterable[ImuSample | FieldSample | None]
    ) -> Iterator[ImuSample | FieldSample | None]:
        """Yield the readings in their order; what is known belongs to the newest one."""
        if not self._travel:
            yield from readings
            return
        newest = -math.inf

        def stamp_of(reading: ImuSample | FieldSample | TravelSample | None) -> float:
            # A reading without numbers comes where it was recorded.
            return newest if reading is None else reading.stamp

        for reading in heapq.merge(readings, self._travel, key=stamp_of):
            if isinstance(reading, ImuSample):
                newest = reading.stamp
                own = self._travelling.add_imu(reading, self._up.gyro_bias.rate)
                self._up.add(reading, own)
                self.own = own or NOTHING
            elif isinstance(reading, FieldSample):
                self._up.add_field(reading.stamp, reading.field)
            elif reading is not None:
                self._travelling.add_travel(reading)
                continue
            yield reading

    @property
    def speed(self) -> float:
        """The newest speed, m/s; NaN where nobody tells it."""
        track = self._travelling.speedometer.track
        return math.nan if track is None else track.last
