"""What arrives on the two sensor topics, and what can be said about it."""

from __future__ import annotations

import math
import time
from collections import Counter, deque
from collections.abc import Callable
from dataclasses import dataclass
from dataclasses import field as member

from magcal_ros.core.samples.streams import Streams
from magcal_ros.core.samples.units import Heard, complaints
from magcal_ros.files.default_paths import known_as

SILENT_AFTER = 2.0
"""Seconds without a message after which a sensor is called silent."""

REMEMBERED = 60
"""Looks, one a second, over which dropped samples are counted for the complaints: what was wrong
last month is no complaint any more, and what goes wrong after a good month is one."""

RATE_LOOKS = 6
"""Looks over which a rate is taken."""


@dataclass
class Sensor:
    """One topic: the newest frame, and when a message last came (steady clock)."""

    topic: str
    clock: Callable[[], float] = time.monotonic
    frame: str = ""
    last_heard: float | None = None
    messages: int = 0
    publishers: int = 1
    changes: int = 0
    _changes_at_look: tuple[int, int] = (0, 0)
    _frame_before: str = ""
    _counts: deque[tuple[float, int]] = member(default_factory=lambda: deque(maxlen=RATE_LOOKS))

    @property
    def rate(self) -> float:
        """Messages a second over the last looks, Hz."""
        if len(self._counts) < 2:
            return 0.0
        (then, before), (now, after) = self._counts[0], self._counts[-1]
        return (after - before) / max(now - then, 1e-9)

    def heard(self, frame: str) -> bool:
        """Note that a message came; returns whether another sensor is met with it."""
        is_first = self.last_heard is None
        self.messages += 1
        self.last_heard = self.clock()
        if frame == self.frame:
            return is_first
        if not is_first:
            self.changes += 1
            self._frame_before = self.frame
        self.frame = frame
        return True

    def look(self) -> None:
        """Note, once a second, how many messages and changes of the frame have come."""
        self._counts.append((self.clock(), self.messages))
        self._changes_at_look = (self._changes_at_look[1], self.changes)

    def age(self) -> float:
        """Return seconds since the last message; infinite if none came."""
        return math.inf if self.last_heard is None else self.clock() - self.last_heard

    def complaint(self) -> str:
        """Say that nothing comes, and what to look at; empty if messages flow."""
        if self.last_heard is None:
            return (
                f"nothing has arrived on {self.topic}: "
                "is the driver running, and the topic remapped to it?"
            )
        silent = self.age()
        if silent > SILENT_AFTER:
            return f"{self.topic} has been silent for {silent:.0f} s"
        if self.publishers > 1:
            return f"{self.publishers} publishers on {self.topic}: only one can be the sensor"
        if self.changes - self._changes_at_look[0] > 1:
            names = " and ".join(
                repr(known_as(f)) for f in sorted((self._frame_before, self.frame))
            )
            return f"the frame of {self.topic} changes between {names}: only one can be the sensor"
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
            sensor.look()

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
