"""How well the samples agree with the model around the turn, and which part of it was seen."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from magcal_ros.core.samples.coverage import BINS
from magcal_ros.report.figures.canvas import (
    CORRECTED,
    IDEAL,
    LEFT_OUT,
    MICRO,
    RAW,
    UP,
    dots,
    legend_below,
)
from magcal_ros.report.turn import Corrected, Turn

if TYPE_CHECKING:
    from matplotlib.figure import Figure

RAW_FIELD = (
    "Below, the raw field. On a turn two of its lines swing up and down like waves; flat lines "
    "mean that the robot stood, or that the sensor does not feel the field; jumps mean that "
    "something magnetic switched."
)
"""What its picture says to someone who is no expert."""


def draw(figure: Figure, turn: Turn) -> None:
    """Draw the ring of headings that were seen, and the residuals, or without a fit the field."""
    corrected = turn.corrected
    _draw_ring(figure.add_axes((0.29, 0.625, 0.42, 0.3), projection="polar"), turn)
    axes = figure.add_axes((0.155, 0.175, 0.825, 0.345))
    if corrected is None:
        _draw_raw_field(axes, turn)
    else:
        _draw_residuals(axes, turn, corrected)
    legend_below(figure, axes, columns=3 if corrected is None else 2)


def caption(turn: Turn) -> str:
    """Explain the picture to someone who is no expert."""
    hole = turn.coverage.hole_in_words or "nothing of the turn is missing"
    ring = f"The ring shows which headings were seen, counted from the start: {hole}."
    if turn.corrected is None:
        return f"{ring} {RAW_FIELD}"
    return (
        f"{ring} Below, what the model leaves unexplained: a cloud without a pattern inside the "
        "grey band is sensor noise; waves tell of iron that turns with the robot, bumps of "
        "something that passed by."
    )


def _draw_ring(axes: Any, turn: Turn) -> None:
    axes.set_theta_zero_location("N")
    counts = np.zeros(BINS)
    if turn.angle is not None and turn.coverage.filled.any():
        where = np.mod(turn.angle, math.tau) * (BINS / math.tau)
        counts = np.bincount(where.astype(int) % BINS, minlength=BINS).astype(float)
    width = math.tau / BINS
    centre = (np.arange(BINS) + 0.5) * width
    # Square roots make areas comparable: the eye takes a bar's area on a ring for its size.
    height = np.sqrt(counts / max(float(counts.max()), 1.0))
    axes.bar(centre, height, width=0.9 * width, bottom=0.55, color=CORRECTED)
    empty = centre[counts == 0.0]
    axes.bar(empty, 1.0, width=width, bottom=0.55, color="#F6D9C6", edgecolor=RAW, linewidth=0.3)
    axes.set(ylim=(0.0, 1.6), yticks=[])
    axes.set_xticks(np.radians([0, 90, 180, 270]))
    axes.set_xticklabels(["start", "90° left", "180°", "90° right"])
    for label, side in zip(
        axes.get_xticklabels(), ("center", "right", "center", "left"), strict=True
    ):
        label.set_horizontalalignment(side)
    axes.tick_params(axis="x", pad=0)
    axes.grid(False)
    axes.spines["polar"].set_visible(False)
    # The same arc as in the table of numbers, where a fit has measured one.
    arc = turn.coverage.arc if turn.corrected is None else turn.corrected.estimate.arc
    seen = f"{math.degrees(arc):.0f}°\nseen"
    axes.text(0.0, 0.0, seen, ha="center", va="center", fontsize=9.5)


def _draw_raw_field(axes: Any, turn: Turn) -> None:
    """Draw the three components over time, for a turn from which nothing could be found."""
    rows = turn.rows()
    looks = (("x forward", RAW, "^"), ("y left", CORRECTED, "o"), ("z up", UP, "s"))
    for number, (words, colour, marker) in enumerate(looks):
        values = MICRO * turn.field[rows, number]
        dots(axes, turn.time[rows], values, color=colour, marker=marker, label=words)
    axes.set(xlabel="time since the first sample [s]", ylabel="raw field [µT]")


def _draw_residuals(axes: Any, turn: Turn, corrected: Corrected) -> None:
    angle = np.degrees(turn.angle if turn.angle is not None else np.arange(len(turn.time)))
    noise = 2.0 * corrected.estimate.noise_field * MICRO
    axes.axhspan(-noise, noise, color="#EAEAEA", label="±2σ of the field's noise")
    axes.axhline(0.0, color=IDEAL, linewidth=0.6)
    kept = turn.rows(turn.believed)
    series = (
        (corrected.radial, CORRECTED, "o", "across the circle"),
        (corrected.axial, RAW, "^", "along the turn's axis"),
    )
    left_out = turn.rows(~turn.believed, most=100)
    for values, colour, marker, words in series:
        shown = MICRO * values
        dots(axes, angle[kept], shown[kept], color=colour, marker=marker, label=words)
        if len(left_out):
            label = "left out" if values is corrected.axial else None
            dots(axes, angle[left_out], shown[left_out], **LEFT_OUT, label=label)
    axes.set(xlabel="turned since the start [°], left positive", ylabel="residual [µT]")
