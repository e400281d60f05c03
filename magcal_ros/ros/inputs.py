"""What arrives on the two sensor topics, and what can be said about it."""

from __future__ import annotations

import math
import time
from collections import Counter, deque
from collections.abc import Callable
from dataclasses import dataclass
from dataclasses import field as member

from magcal_ros.core.complaints import Heard, complaints
from magcal_ros.core.streams import Streams

SILENT_AFTER = 2.0
"""Seconds without a message after which a sensor is called silent."""

REMEMBERED = 60
"""Looks, one a second, over which dropped samples are counted for the complaints: what was wrong
last month is no complaint any more, and what goes wrong after a good month is one."""


@dataclass
class Sensor:
    """One topic, as far as it was heard: the newest frame, and when it came (steady clock)."""

    topic: str
    frame: str = ""
    last_heard: float | None = None
    messages: int = 0
    publishers: int = 1

    def heard(self, frame: str) -> None:
        """Note that a message came."""
        self.frame = frame
        self.messages += 1
        self.last_heard = time.monotonic()

    def age(self, now: float) -> float:
        """Return seconds since the last message; infinite if none came."""
        return math.inf if self.last_heard is None else now - self.last_heard

    def complaint(self) -> str:
        """Say that nothing comes, and what to look at; empty if messages flow."""
        if self.last_heard is None:
            return (
                f"nothing has arrived on {self.topic}: "
                "is the driver running, and the topic remapped to it?"
            )
        silent = time.monotonic() - self.last_heard
        if silent > SILENT_AFTER:
            return f"{self.topic} has been silent for {silent:.0f} s"
        if self.publishers > 1:
            return f"{self.publishers} publishers on {self.topic}: only one can be the sensor"
        return ""


@dataclass
class Inputs:
    """Both sensors and their cleaned streams."""

    imu: Sensor
    field: Sensor
    streams: Streams
    _earlier: deque[tuple[Heard, Heard]] = member(default_factory=lambda: deque(maxlen=REMEMBERED))

    def look(self, count_publishers: Callable[[str], int]) -> None:
        """Note, once a second, what has come so far and who publishes it."""
        self._earlier.append(self._heard())
        for sensor in (self.imu, self.field):
            sensor.publishers = count_publishers(sensor.topic)

    def complaints(self) -> list[str]:
        """Return everything that is wrong with the inputs, in words."""
        found = [text for text in (self.imu.complaint(), self.field.complaint()) if text]
        imu, mag = self._heard()
        if len(self._earlier) == REMEMBERED:
            imu, mag = map(Heard.since, (imu, mag), self._earlier[0])
        return found + complaints(self.streams, imu, mag)

    def _heard(self) -> tuple[Heard, Heard]:
        imu, mag = (
            Heard(sensor.topic, sensor.messages, Counter(drops))
            for sensor, drops in (
                (self.imu, self.streams.imu_drops),
                (self.field, self.streams.field_drops),
            )
        )
        return imu, mag
