"""What is wrong with the samples that came in, in words."""

from __future__ import annotations

import math
from dataclasses import dataclass

from magcal_ros.core.streams import Drop, Streams
from magcal_ros.core.units import likely_field_unit

WORTH_A_WORD = 0.02
"""Share of dropped samples that is said."""

MOST_REPEATS = 0.9
"""Share of repeated field values beyond which the sensor is frozen or the robot at rest."""

LARGEST_OFFSET = 1.0
"""Seconds between the two sensors' newest stamps."""

WORDS = {
    Drop.NOT_FINITE: "samples are not finite",
    Drop.ZERO: "samples are all zero",
    Drop.ABSENT: "messages carry no acceleration",
    Drop.ZERO_STAMP: "stamps are zero: the driver must stamp its messages",
    Drop.BACKWARD_STAMP: "stamps go backward",
    Drop.UNREADABLE: "messages are damaged: their bytes are not what their type says",
    Drop.UNPAIRED: "samples have no IMU sample near their stamp",
}


@dataclass(frozen=True)
class Heard:
    """One topic and how many messages came on it."""

    topic: str
    messages: int


def complaints(streams: Streams, imu: Heard, field: Heard) -> list[str]:
    """Say what is wrong with two streams, and what to do; empty if nothing is.

    Parameters
    ----------
    streams : Streams
        The cleaned streams with their counts.
    imu, field : Heard
        What came on the two topics.
    """
    found = []
    drops = streams.field_drops
    if drops[Drop.TOO_LARGE]:
        unit = likely_field_unit(streams.largest_field)
        found.append(unit or f"a field of {streams.largest_field:.3g} T is no Earth field")
    for heard, counts in ((imu, streams.imu_drops), (field, drops)):
        found += [
            f"{heard.topic}: {counts[drop]} of {heard.messages} {words}"
            for drop, words in WORDS.items()
            if counts[drop] > WORTH_A_WORD * max(heard.messages, 1)
        ]
    if drops[Drop.REPEATED] > MOST_REPEATS * max(field.messages, 1):
        found.append(f"{field.topic} repeats one value: the sensor is frozen or at rest")
    offset = stamp_offset(streams)
    if abs(offset) > LARGEST_OFFSET:
        found.append(
            f"the stamps of field and IMU are {offset:+.1f} s apart: "
            "let one clock stamp both sensors"
        )
    return found


def stamp_offset(streams: Streams) -> float:
    """Return newest field stamp less newest IMU stamp, seconds; zero if one is missing."""
    offset = streams.field_stamps.newest - streams.imu_stamps.newest
    return offset if math.isfinite(offset) else 0.0
