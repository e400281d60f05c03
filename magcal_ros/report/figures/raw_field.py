"""The raw field over time, for a turn from which nothing could be found."""

from __future__ import annotations

from typing import Any

from magcal_ros.report.figures.canvas import CORRECTED, MICRO, RAW, UP, dots
from magcal_ros.report.turn import Turn

LOOKS = (("x forward", RAW, "^"), ("y left", CORRECTED, "o"), ("z up", UP, "s"))

WORDS = (
    "Below, the raw field. On a turn two of its lines swing up and down like waves; flat lines "
    "mean that the robot stood, or that the sensor does not feel the field; jumps mean that "
    "something magnetic switched."
)
"""What the picture says to someone who is no expert."""


def draw(axes: Any, turn: Turn) -> None:
    """Draw the three components."""
    rows = turn.rows()
    for number, (words, colour, marker) in enumerate(LOOKS):
        values = MICRO * turn.field[rows, number]
        dots(axes, turn.time[rows], values, color=colour, marker=marker, label=words)
    axes.set(xlabel="time since the first sample [s]", ylabel="raw field [µT]")
