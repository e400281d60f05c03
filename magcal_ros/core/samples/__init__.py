"""Samples of the sensors: streams, paired windows, and their faults."""

from magcal_ros.core.samples.streams import (
    STREAMS,
    Drop,
    FieldSample,
    ImuSample,
    Pair,
    Pairer,
    StampGuard,
    Streams,
)
from magcal_ros.core.samples.window import Window

__all__ = [
    "STREAMS", "Drop", "FieldSample", "ImuSample", "Pair", "Pairer", "StampGuard", "Streams",
    "Window",
]  # fmt: skip
