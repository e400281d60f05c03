"""The raw field over time, for a turn from which nothing could be found."""

from __future__ import annotations

from typing import TYPE_CHECKING

from magcal_ros.report.figures.canvas import CORRECTED, MICRO, RAW, UP, dots, legend_below
from magcal_ros.report.turn import Turn

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SIZE = (4.9, 4.0)
LOOKS = (("x forward", RAW, "^"), ("y left", CORRECTED, "o"), ("z up", UP, "s"))


def draw(figure: Figure, turn: Turn) -> None:
    """Draw the three components."""
    axes = figure.add_axes((0.14, 0.24, 0.84, 0.72))
    rows = turn.rows()
    for number, (words, colour, marker) in enumerate(LOOKS):
        values = MICRO * turn.field[rows, number]
        dots(axes, turn.time[rows], values, color=colour, marker=marker, label=words)
    axes.set(xlabel="time since the first sample [s]", ylabel="raw field [µT]")
    legend_below(figure, axes, columns=3)


def caption(turn: Turn) -> str:
    """Explain the picture to someone who is no expert."""
    del turn
    return (
        "On a turn two of the three lines swing up and down like waves. Flat lines mean that the "
        "robot stood, or that the sensor does not feel the field; jumps mean that something "
        "magnetic switched."
    )
