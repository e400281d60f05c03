"""Gyro against compass: the compass's deviation at each heading."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from magcal_ros.core.geometry.arrays import FloatArray
from magcal_ros.core.geometry.attitude import wrap_angle
from magcal_ros.report.figures.canvas import CORRECTED, IDEAL, RAW
from magcal_ros.report.turn import Corrected, Turn

if TYPE_CHECKING:
    from matplotlib.figure import Figure

BINS = 24
POINTS_OF_COMPASS = {-180: "W", -90: "S", 0: "E", 90: "N", 180: "W"}


def draw(figure: Figure, turn: Turn) -> None:
    """Draw the mean deviation from the gyro before and after, over the heading."""
    corrected = turn.corrected
    if corrected is None:
        return
    upper, lower = figure.subplots(2, 1, sharex=True)
    figure.subplots_adjust(left=0.155, right=0.98, top=0.94, bottom=0.11, hspace=0.2)
    before, after = deviations(turn, corrected)
    _draw_card(upper, before, RAW, "^", "before the correction")
    title = "after the correction"
    bound = turn.swing_bound
    if bound is not None:
        title += f" (grey: good, ±{bound:g}° rms)"
    _draw_card(lower, after, CORRECTED, "o", title)
    if bound is not None:
        _draw_bound(lower, after, bound)
    lower.set_xticks(list(POINTS_OF_COMPASS))
    lower.set_xticklabels([f"{yaw}°\n{point}" for yaw, point in POINTS_OF_COMPASS.items()])
    lower.set(xlim=(-184, 184), xlabel="heading of the robot, ENU yaw")


def caption(turn: Turn) -> str:
    """Explain the picture to someone who is no expert."""
    if turn.corrected is None:
        return ""
    worst = math.degrees(float(np.nanmax(np.abs(deviations(turn, turn.corrected)[1]))))
    swing = turn.corrected.estimate.swing
    judged = "" if swing is None else f" ({math.degrees(swing.rms):.1f}° rms, which is judged)"
    return (
        "The gyro knows nothing of magnetism, so it shows what a clean circle hides: where steel "
        "near by bends the field, the compass swings once or twice around the turn. A flat blue "
        f"line is good; here it swings by up to {worst:.1f}°{judged}. Each mark is the mean over "
        "15° of heading; the gyro's own bias and scale are taken off."
    )


def deviations(turn: Turn, corrected: Corrected) -> tuple[FloatArray, FloatArray]:
    """Return the mean deviation before and after at 24 headings, radians; NaN where none was.

    Afterwards it is what the verdict is on, where it is on any.
    """
    reference, believed = corrected.reference, turn.believed
    before = _means(wrap_angle(turn.yaw - reference)[believed], reference[believed])
    swing = corrected.estimate.swing
    if swing is not None:
        return before, _means(swing.deviation, swing.heading)
    return before, _means(corrected.deviation[believed], reference[believed])


def _means(deviation: FloatArray, heading: FloatArray) -> FloatArray:
    where = ((wrap_angle(heading) + math.pi) * (BINS / math.tau)).astype(int) % BINS
    found = np.full(BINS, np.nan)
    for number in range(BINS):
        here = where == number
        if here.any():
            found[number] = np.angle(np.mean(np.exp(1j * deviation[here])))
    return found


def _draw_card(axes: Any, values: FloatArray, colour: str, marker: str, title: str) -> None:
    centre = -180.0 + (np.arange(BINS) + 0.5) * (360.0 / BINS)
    shown = np.degrees(values)
    axes.axhline(0.0, color=IDEAL, linewidth=0.9)
    axes.plot(centre, shown, color=colour, marker=marker, markersize=4.5, linewidth=0.0)
    # From -180 to +180 it is one small step, not a line through the whole picture.
    leaps = np.append(np.abs(np.diff(shown)) > 180.0, False)
    axes.plot(centre, np.where(leaps, np.nan, shown), color=colour, linewidth=1.2)
    reach = 1.2 * max(float(np.nanmax(np.abs(shown))), 0.1)
    axes.set(ylim=(-reach, reach), ylabel="compass − gyro [°]", title=title)


def _draw_bound(axes: Any, values: FloatArray, bound: float) -> None:
    """Shade the range that the verdict calls good, and keep it in the picture."""
    axes.axhspan(-bound, bound, color="#EAEAEA", zorder=0)
    reach = max(1.2 * math.degrees(float(np.nanmax(np.abs(values)))), 1.25 * bound)
    axes.set_ylim(-reach, reach)
