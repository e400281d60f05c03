"""What arrives on the two sensor topics, and what can be said about it."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass

from magcal_ros.core.complaints import Heard, complaints
from magcal_ros.core.streams import Streams

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
        imu, field = (Heard(each.topic, each.messages) for each in (self.imu, self.field))
        return found + complaints(self.streams, imu, field)
