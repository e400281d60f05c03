"""The pictures of a report in their order, and the pictures of the heading."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import partial
from html import escape
from typing import TYPE_CHECKING, Any

import numpy as np

from magcal_ros.core.geometry.arrays import FloatArray
from magcal_ros.core.geometry.attitude import mean_angle, wrap_angle
from magcal_ros.report import turn_views
from magcal_ros.report.turn import CorrectedTurn, Turn

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def draw(figure: Figure, turn: Turn, corrected: CorrectedTurn) -> None:
    """Draw raw and corrected headings over the turn, and the deviation of the corrected ones."""
    assert turn.angle is not None
    angle = np.degrees(turn.angle)
    upper, lower = figure.subplots(2, 1, sharex=True, gridspec_kw={"height_ratios": (1.25, 1.0)})
    figure.subplots_adjust(left=0.155, right=0.98, top=0.97, bottom=0.205, hspace=0.1)
    _draw_headings(upper, turn, corrected, angle)
    _draw_deviation(lower, turn, corrected, angle)
    turn_views.legend_below(figure, upper)


def caption(turn: Turn, corrected: CorrectedTurn) -> str:
    """Return the explanation of the picture for users who are not experts."""
    by = "the gyro" if turn.has_gyro else "the smoothed corrected heading (there is no gyro)"
    kept = turn.inliers & np.isfinite(corrected.sigma)
    inside = np.abs(corrected.deviation[kept]) <= 2.0 * corrected.sigma[kept]
    scatter = 100.0 * float(inside.mean()) if len(inside) else 0.0
    return (
        "A perfect compass follows the black line: one degree of heading for each degree turned. "
        f"The {turn.kind} was measured by {by}. Below is the deviation of the corrected heading "
        f"from this line; {scatter:.0f}% of the samples are in the blue ±2σ band that the node "
        "would publish (about 95% is expected)."
    )


def _draw_headings(axes: Any, turn: Turn, corrected: CorrectedTurn, angle: Any) -> None:
    order = turn.rows()
    order = order[np.argsort(angle[order])]
    ideal = np.degrees(wrap_angle(corrected.reference[order]))
    # The line is interrupted where the heading wraps from 180° to -180°.
    ideal[1:][np.abs(np.diff(ideal)) > 180.0] = np.nan
    line = {"color": turn_views.IDEAL, "linewidth": 0.9, "zorder": 3}
    axes.plot(angle[order], ideal, label=f"the {turn.kind} itself", **line)
    rows = turn.rows()
    raw = {"color": turn_views.RAW, "marker": "^", "markersize": 3.0, "label": "before"}
    turn_views.dots(axes, angle[rows], np.degrees(wrap_angle(turn.yaw[rows])), **raw)
    after = np.degrees(wrap_angle(corrected.yaw[rows]))
    turn_views.dots(axes, angle[rows], after, color=turn_views.CORRECTED, label="after")
    axes.fill_between([], [], [], color=turn_views.CORRECTED, alpha=0.2, label="±2σ of the heading")
    axes.set(ylabel="heading, ENU yaw [°]", ylim=(-185, 185), yticks=range(-180, 181, 90))


def _draw_deviation(axes: Any, turn: Turn, corrected: CorrectedTurn, angle: Any) -> None:
    rows = turn.rows(turn.inliers & np.isfinite(corrected.sigma))
    rows = rows[np.argsort(angle[rows])]
    deviation, sigma = np.degrees(corrected.deviation), np.degrees(corrected.sigma)
    band = 2.0 * sigma[rows]
    blue = turn_views.CORRECTED
    axes.fill_between(angle[rows], -band, band, color=blue, alpha=0.2, linewidth=0.0)
    axes.axhline(0.0, color=turn_views.IDEAL, linewidth=0.9)
    left_out = turn.rows(~turn.inliers, most=100)
    # Outliers must not compress the scale; they are drawn at the edge.
    usual = np.percentile(np.append(np.abs(deviation[rows]), band), 98.0) if len(rows) else 0.0
    reach = 1.4 * max(float(usual), 0.1)
    clipped = np.clip(deviation, -reach, reach)
    turn_views.dots(axes, angle[rows], clipped[rows], color=blue)
    if len(left_out):
        turn_views.dots(axes, angle[left_out], clipped[left_out], **turn_views.LEFT_OUT)
    axes.set(ylim=(-reach, reach), ylabel="deviation after [°]")
    axes.set_xlabel("turned since the start [°], left positive")


BINS = 24
POINTS_OF_COMPASS = {-180: "W", -90: "S", 0: "E", 90: "N", 180: "W"}


def draw_gyro(figure: Figure, turn: Turn, corrected: CorrectedTurn) -> None:
    """Draw the mean deviation from the gyro before and after, over the heading."""
    upper, lower = figure.subplots(2, 1, sharex=True)
    figure.subplots_adjust(left=0.155, right=0.98, top=0.94, bottom=0.11, hspace=0.2)
    before, after = deviations(turn, corrected)
    _draw_card(upper, before, turn_views.RAW, "^", "before the correction")
    title = "after the correction"
    bound = turn.swing_bound
    if bound is not None:
        title += f" (grey: good, ±{bound:g}° rms)"
    _draw_card(lower, after, turn_views.CORRECTED, "o", title)
    if bound is not None:
        # The range that the verdict calls good is always in the picture.
        lower.axhspan(-bound, bound, color="#EAEAEA", zorder=0)
        reach = max(1.2 * math.degrees(float(np.nanmax(np.abs(after)))), 1.25 * bound)
        lower.set_ylim(-reach, reach)
    lower.set_xticks(list(POINTS_OF_COMPASS))
    lower.set_xticklabels([f"{yaw}°\n{point}" for yaw, point in POINTS_OF_COMPASS.items()])
    lower.set(xlim=(-184, 184), xlabel="heading of the robot, ENU yaw")


def caption_of_gyro(turn: Turn, corrected: CorrectedTurn) -> str:
    """Return the explanation of the picture for users who are not experts."""
    worst = math.degrees(float(np.nanmax(np.abs(deviations(turn, corrected)[1]))))
    swing = corrected.estimate.swing
    judged = ""
    if swing is not None:
        judged = f" ({math.degrees(swing.rms):.1f}° rms beyond noise, which is graded)"
    return (
        "A gyro is not affected by magnetic fields, so it reveals an error that the circle does "
        "not: if steel nearby distorts the field, the compass error oscillates once or twice per "
        f"turn. A flat blue line is good; here the error is up to {worst:.1f}°{judged}. Each mark "
        "is the mean over 15° of heading; the errors by bias and scale of the gyro are subtracted."
    )


def deviations(turn: Turn, corrected: CorrectedTurn) -> tuple[FloatArray, FloatArray]:
    """Return the mean deviation before and after at 24 headings, radians; NaN without samples.

    The deviation after the correction is the one that is graded, if there is one.
    """
    reference, inliers = corrected.reference, turn.inliers
    before = _means(wrap_angle(turn.yaw - reference)[inliers], reference[inliers])
    swing = corrected.estimate.swing
    if swing is not None:
        return before, _means(swing.deviation, swing.heading)
    return before, _means(corrected.deviation[inliers], reference[inliers])


def _means(deviation: FloatArray, heading: FloatArray) -> FloatArray:
    where = ((wrap_angle(heading) + math.pi) * (BINS / math.tau)).astype(int) % BINS
    groups = (deviation[where == number] for number in range(BINS))
    return np.array([mean_angle(group) if len(group) else math.nan for group in groups])


def _draw_card(axes: Any, values: FloatArray, colour: str, marker: str, title: str) -> None:
    centre = -180.0 + (np.arange(BINS) + 0.5) * (360.0 / BINS)
    shown = np.degrees(values)
    axes.axhline(0.0, color=turn_views.IDEAL, linewidth=0.9)
    axes.plot(centre, shown, color=colour, marker=marker, markersize=4.5, linewidth=0.0)
    # The line is interrupted where the deviation wraps from 180° to -180°.
    leaps = np.append(np.abs(np.diff(shown)) > 180.0, False)
    axes.plot(centre, np.where(leaps, np.nan, shown), color=colour, linewidth=1.2)
    reach = 1.2 * max(float(np.nanmax(np.abs(shown))), 0.1)
    axes.set(ylim=(-reach, reach), ylabel="compass − gyro [°]", title=title)


NO_MATPLOTLIB = (
    "No picture: matplotlib is not installed. Install python3-matplotlib with apt, or matplotlib "
    "with pip in a virtual environment, and make the report again from samples.csv."
)


@dataclass(frozen=True)
class Picture:
    """A figure of the page."""

    name: str
    title: str
    caption: str
    drawing: str  # an SVG, or a paragraph with the reason why there is none


def missing(why: str) -> str:
    """Return a paragraph in place of a drawing."""
    return f'<p class="missing">{escape(why)}</p>'


NO_GYRO = Picture(
    "gyro",
    "Gyro against compass",
    "Only a gyro reveals whether steel nearby distorts the field: the compass error then "
    "oscillates over the turn, although the circle looks right.",
    missing("Not checked: there was no gyro in these samples."),
)


def pictures(turn: Turn) -> list[Picture]:
    """Draw all pictures for which the turn has data."""
    if not len(turn.time):
        return []
    around = turn_views.draw_residuals, turn_views.caption_of_residuals(turn)
    found = [
        _picture(turn, "views", "The field in space", turn_views.draw, turn_views.caption(turn)),
        _picture(turn, "around", "Headings and residuals", *around),
    ]
    corrected = turn.corrected
    if corrected is None:
        return found
    heading = partial(draw, corrected=corrected), caption(turn, corrected)
    found.append(_picture(turn, "heading", "Heading before and after", *heading))
    if not turn.has_gyro:
        return [*found, NO_GYRO]
    gyro = partial(draw_gyro, corrected=corrected), caption_of_gyro(turn, corrected)
    return [*found, _picture(turn, NO_GYRO.name, NO_GYRO.title, *gyro)]


def _picture(turn: Turn, name: str, title: str, draw: turn_views.Draw, words: str) -> Picture:
    try:
        drawing = turn_views.draw_svg(draw, turn, name, title)
    except ImportError:
        drawing = missing(NO_MATPLOTLIB)
    except Exception as error:
        # Unusual samples may cause errors in matplotlib; the report is then written without this
        # picture.
        drawing = missing(f"No picture: drawing has failed ({type(error).__name__}: {error}).")
    return Picture(name, title, words, drawing)
