"""A recording's wheels and receiver, replayed together with its sensors."""

from __future__ import annotations

import heapq
import math
from collections.abc import Iterable, Iterator

from magcal_ros.core.driving.travelling import Travelling
from magcal_ros.core.geometry.vec3 import Triple
from magcal_ros.core.samples.streams import FieldSample, ImuSample, Streams, TravelSample
from magcal_ros.core.up import UpFollower

NOTHING: Triple = (0.0, 0.0, 0.0)


class TravelReplay:
    """Merges travel samples into a recording's readings, and follows up and speed along it.

    Attributes
    ----------
    up : UpFollower
    travelling : Travelling
    own : tuple of float
        The vehicle's own acceleration at the newest IMU sample, m/s², body axes; zero where it is
        not known.
    """

    def __init__(self, travel: Iterable[TravelSample], streams: Streams | None = None) -> None:
        self._travel, self._streams = list(travel), streams
        self.travelling, self.up = Travelling(), UpFollower()
        self.own = NOTHING

    def readings(
        self, readings: Iterable[ImuSample | FieldSample | None]
    ) -> Iterator[ImuSample | FieldSample | None]:
        """Yield the readings in their order; the attributes belong to the newest one."""
        if not self._travel and self._streams is None:
            yield from readings
            return
        newest = -math.inf

        def stamp_of(reading: ImuSample | FieldSample | TravelSample | None) -> float:
            # A reading without numbers comes where it was recorded.
            return newest if reading is None else reading.stamp

        for reading in heapq.merge(readings, self._travel, key=stamp_of):
            if isinstance(reading, ImuSample):
                newest = reading.stamp
                if self._streams is not None and not self._streams.add_imu(reading):
                    continue
                own = self.travelling.add_imu(reading, self.up.gyro_bias.rate)
                self.up.add(reading, own)
                self.own = own or NOTHING
            elif isinstance(reading, FieldSample):
                if self._streams is not None and not self._streams.add_field(reading):
                    continue
                self.up.add_field(reading.stamp, reading.field)
            elif reading is not None:
                self.travelling.add_travel(reading)
                continue
            yield reading

    @property
    def speed(self) -> float:
        """The newest speed, m/s; NaN without a source."""
        track = self.travelling.speedometer.track
        return math.nan if track is None else track.last
