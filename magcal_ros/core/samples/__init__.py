"""What sensors say: streams of samples, paired windows, and what is wrong with them."""

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
from magcal_ros.core.samples.window import (
    Window,
)

__all__ = [
    "STREAMS", "Drop", "FieldSample", "ImuSample", "Pair", "Pairer", "StampGuard", "Streams",
    "Window",
]  # fmt: skip
