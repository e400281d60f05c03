"""What arrives on the two sensor topics, and what can be said about it."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass

from magcal_ros.core.streams import Drop, Streams
from magcal_ros.core.units import likely_field_unit

SILENT_AFTER = 2.0
"""Seconds without a message after which a sensor is called silent."""


@dataclass
class Sensor:
    """One topic, as far as it was heard: the newest frame, and when it came (steady clock)."""

    topic: str
    frame: str = ""
    last_heard: float | None = None
    messages: int = 0

    def heard(self, frame: str) -> None:
        """Note that a message came."""
        self.frame = frame
        self.messages += 1
        self.last_heard = time.monotonic()

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
        return ""


@dataclass
class Inputs:
    """Both sensors and their cleaned streams."""

    imu: Sensor
    field: Sensor
    streams: Streams

    def complaints(self) -> list[str]:
        """Return everything that is wrong with the inputs, in words."""
        found = [text for text in (self.imu.complaint(), self.field.complaint()) if text]
        found += self._about_drops()
        offset = self.stamp_offset()
        if abs(offset) > 1.0:
            found.append(
                f"the stamps of field and IMU are {offset:+.1f} s apart: "
                "let one clock stamp both sensors"
            )
        return found

    def stamp_offset(self) -> float:
        """Return newest field stamp less newest IMU stamp, seconds; zero if one is missing."""
        offset = self.streams.field_stamps.newest - self.streams.imu_stamps.newest
        return offset if math.isfinite(offset) else 0.0

    def _about_drops(self) -> list[str]:
        found = []
        drops, total = self.streams.field_drops, max(self.field.messages, 1)
        if drops[Drop.TOO_LARGE]:
            unit = likely_field_unit(self.streams.largest_field)
            found.append(unit or f"a field of {self.streams.largest_field:.3g} T is no Earth field")
        for sensor, counts in ((self.imu, self.streams.imu_drops), (self.field, drops)):
            for drop, words in _WORDS.items():
                if counts[drop] > 0.02 * max(sensor.messages, 1):
                    found.append(f"{sensor.topic}: {counts[drop]} of {sensor.messages} {words}")
        if drops[Drop.REPEATED] > 0.9 * total:
            found.append(f"{self.field.topic} repeats one value: the sensor is frozen or at rest")
        return found


_WORDS = {
    Drop.NOT_FINITE: "samples are not finite",
    Drop.ZERO: "samples are all zero",
    Drop.ABSENT: "messages carry no acceleration",
    Drop.ZERO_STAMP: "stamps are zero: the driver must stamp its messages",
    Drop.BACKWARD_STAMP: "stamps go backward",
    Drop.UNPAIRED: "samples have no IMU sample near their stamp",
}
