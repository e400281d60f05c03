"""Heading before and after the correction, with its sigma band."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from magcal_ros.core.geometry.attitude import wrap_angle
from magcal_ros.report.figures.canvas import CORRECTED, IDEAL, LEFT_OUT, RAW, dots, legend_below
from magcal_ros.report.turn import Corrected, Turn

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def draw(figure: Figure, turn: Turn) -> None:
    """Draw the headings over the turn, and how far the corrected one deviates from it."""
    corrected, angle = turn.corrected, turn.angle
    if corrected is None or angle is None:
        return
    upper, lower = figure.subplots(2, 1, sharex=True, gridspec_kw={"height_ratios": (1.25, 1.0)})
    figure.subplots_adjust(left=0.155, right=0.98, top=0.97, bottom=0.205, hspace=0.1)
    _draw_headings(upper, turn, corrected, np.degrees(angle))
    _draw_deviation(lower, turn, corrected, np.degrees(angle))
    legend_below(figure, upper)


def caption(turn: Turn) -> str:
    """Explain the picture to someone who is no expert."""
    if turn.corrected is None:
        return ""
    by = (
        "the gyro" if turn.has_gyro else "the corrected heading itself, smoothed (there is no gyro)"
    )
    scatter = _scatter_share(turn, turn.corrected)
    return (
        "A perfect compass follows the black line: one degree of heading for each degree turned. "
        f"The turn was measured by {by}. Below, the corrected heading's distance from that line; "
        f"{scatter:.0f}% of the samples lie in the blue ±2σ band that the node would publish "
        "(about 95% should)."
    )


def _scatter_share(turn: Turn, corrected: Corrected) -> float:
    kept = turn.believed & np.isfinite(corrected.sigma)
    inside = np.abs(corrected.deviation[kept]) <= 2.0 * corrected.sigma[kept]
    return 100.0 * float(inside.mean()) if len(inside) else 0.0


def _draw_headings(axes: Any, turn: Turn, corrected: Corrected, angle: Any) -> None:
    order = turn.rows()
    order = order[np.argsort(angle[order])]
    ideal = np.degrees(wrap_angle(corrected.reference[order]))
    # A line that leaves at the top and comes back at the bottom must not be joined.
    ideal[1:][np.abs(np.diff(ideal)) > 180.0] = np.nan
    axes.plot(angle[order], ideal, color=IDEAL, linewidth=0.9, label="the turn itself", zorder=3)
    rows = turn.rows()
    raw = {"color": RAW, "marker": "^", "markersize": 3.0, "label": "before"}
    dots(axes, angle[rows], np.degrees(wrap_angle(turn.yaw[rows])), **raw)
    after = np.degrees(wrap_angle(corrected.yaw[rows]))
    dots(axes, angle[rows], after, color=CORRECTED, label="after")
    axes.fill_between([], [], [], color=CORRECTED, alpha=0.2, label="±2σ of the heading")
    axes.set(ylabel="heading, ENU yaw [°]", ylim=(-185, 185), yticks=range(-180, 181, 90))


def _draw_deviation(axes: Any, turn: Turn, corrected: Corrected, angle: Any) -> None:
    rows = turn.rows(turn.believed & np.isfinite(corrected.sigma))
    rows = rows[np.argsort(angle[rows])]
    deviation, sigma = np.degrees(corrected.deviation), np.degrees(corrected.sigma)
    band = 2.0 * sigma[rows]
    axes.fill_between(angle[rows], -band, band, color=CORRECTED, alpha=0.2, linewidth=0.0)
    axes.axhline(0.0, color=IDEAL, linewidth=0.9)
    left_out = turn.rows(~turn.believed, most=100)
    # A few wild samples must not flatten all others; they are drawn at the rim.
    usual = np.percentile(np.append(np.abs(deviation[rows]), band), 98.0) if len(rows) else 0.0
    reach = 1.4 * max(float(usual), 0.1)
    dots(axes, angle[rows], np.clip(deviation[rows], -reach, reach), color=CORRECTED)
    if len(left_out):
        dots(axes, angle[left_out], np.clip(deviation[left_out], -reach, reach), **LEFT_OUT)
    axes.set(ylim=(-reach, reach), ylabel="after, off the line [°]")
    axes.set_xlabel("turned since the start [°], left positive")
