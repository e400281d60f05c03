"""Drawing as SVG; the pictures of the turn in space and of its residuals."""

from __future__ import annotations

import io
import math
import re
import threading
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from magcal_ros.core.geometry.arrays import FloatArray
from magcal_ros.core.samples.coverage import BINS
from magcal_ros.report.turn import MICRO, CorrectedTurn, Turn

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Draw = Callable[["Figure", Turn], None]
Clouds = list[tuple[FloatArray, dict[str, Any]]]

RAW = "#D55E00"
CORRECTED = "#0072B2"
UP = "#009E73"
OUTLIER = "#CC79A7"
IDEAL = "#222222"
SPHERE = "#B8B8B8"
"""Okabe and Ito's colours, which colour-blind people can distinguish; the markers also differ."""

LEFT_OUT = {"color": OUTLIER, "marker": "x", "markersize": 4.0, "markeredgewidth": 0.9}
"""The style of outliers."""

SIZE = (4.9, 5.5)  # width and height of every picture, inches

STYLE: dict[str, Any] = {
    "axes.edgecolor": "#666666",
    "axes.grid": True,
    "axes.labelsize": 9,
    "axes.spines.right": False,
    "axes.spines.top": False,
    "axes.titlesize": 9.5,
    "font.size": 9,
    "grid.color": "#E4E4E4",
    "grid.linewidth": 0.6,
    "legend.fontsize": 8.5,
    "legend.frameon": False,
    "svg.fonttype": "none",
    "text.usetex": False,
    "xtick.labelsize": 8.5,
    "ytick.labelsize": 8.5,
}
# matplotlib's style is global in the process, so only one picture is drawn at a time.
_DRAWING = threading.Lock()


def draw_svg(draw: Draw, turn: Turn, name: str, words: str) -> str:
    """Return a picture as an `svg` element without external references."""
    import matplotlib
    from matplotlib.figure import Figure

    style: Any = STYLE | {"svg.hashsalt": name}
    with _DRAWING, matplotlib.rc_context(style):
        figure = Figure(figsize=SIZE)
        draw(figure, turn)
        target = io.StringIO()
        nothing = dict.fromkeys(("Creator", "Date", "Format", "Type"))
        figure.savefig(target, format="svg", metadata=nothing, transparent=True)
    return _inline(target.getvalue(), name, words)


def _inline(svg: str, name: str, words: str) -> str:
    """Return an SVG file as a part of a page, with unique ids and short numbers."""
    body = svg[svg.index("<svg") :]
    extra = r"<metadata>.*?</metadata>|<style[^>]*>.*?</style>|<!--.*?-->"
    body = re.sub(extra, "", body, flags=re.S)
    view = re.search(r'viewBox="[^"]*"', body)
    box = view.group(0) if view else ""
    opening = f'<svg {box} role="img" aria-label="{words}">'
    body = re.sub(r"<svg[^>]*>", lambda _: opening, body, count=1, flags=re.S)
    body = re.sub(r'(?<= )id="', f'id="{name}-', body)
    body = re.sub(r'xlink:href="#', f'href="#{name}-', body)
    body = re.sub(r"url\(#", f"url(#{name}-", body)
    body = re.sub(r"(\d+\.\d{2})\d+", r"\1", body)
    return re.sub(r"\n+", "\n", body)


def dots(axes: Any, x: Any, y: Any, **style: Any) -> None:
    """Draw a cloud of small markers."""
    chosen = {"linestyle": "none", "marker": "o", "markersize": 2.6, "markeredgewidth": 0.0}
    axes.plot(x, y, **(chosen | style))


def legend_below(figure: Figure, source: Any, columns: int = 2) -> None:
    """Put the legend of the axes `source` below the figure."""
    handles, labels = source.get_legend_handles_labels()
    figure.legend(handles, labels, loc="lower center", ncol=columns, markerscale=2.2)


POINTS = 200  # of each cloud in each of the four views

VIEWS = ((0, 2, "from the right"), (1, 2, "from the front"), (0, 1, "from above"))
NAMES = ("x forward", "y left", "z up")


def draw(figure: Figure, turn: Turn) -> None:
    """Draw accelerometer, raw and corrected field, ideal circle and reference sphere."""
    strength = _strength(turn)
    clouds = _clouds(turn, strength)
    sizes = [float(np.abs(points).max()) for points, _ in clouds if len(points)]
    limit = 1.08 * max(strength, *sizes)
    margins = {"left": 0.125, "right": 0.98, "top": 0.95, "bottom": 0.2}
    grid = figure.add_gridspec(2, 2, wspace=0.36, hspace=0.4, **margins)
    # The 3-D view needs no space for tick labels, only some for its oblique axes.
    solid: Any = figure.add_axes((0.015, 0.595, 0.43, 0.345), projection="3d")
    _draw_solid(solid, turn, clouds, strength, limit)
    places = (grid[0, 1], grid[1, 0], grid[1, 1])
    for place, (i, j, words) in zip(places, VIEWS, strict=True):
        axes = figure.add_subplot(place)
        _draw_projection(axes, turn, clouds, strength, i, j)
        axes.set(xlim=(-limit, limit), ylim=(-limit, limit), aspect="equal")
        axes.set_xlabel(f"{NAMES[i]} [µT]", labelpad=1)
        axes.set_ylabel(f"{NAMES[j]} [µT]", labelpad=0)
        axes.set_title(words)
        last = axes
    legend_below(figure, last)


def caption(turn: Turn) -> str:
    """Return the explanation of the picture for users who are not experts."""
    if turn.corrected is None:
        return (
            "Each orange mark is one raw field sample. In a full turn they should form a circle; "
            "green is up by the accelerometer, drawn with the length of the field."
        )
    return (
        "When the robot turns, the field moves on a circle. Orange: as measured, shifted from the "
        "origin by the hard iron and tilted by the mounting. Blue: corrected; the samples should "
        "be on the fitted black circle. Green: up, drawn with the length of the field."
    )


def _strength(turn: Turn) -> float:
    if turn.corrected is not None:
        return turn.corrected.estimate.strength * MICRO
    return max(float(np.linalg.norm(turn.field, axis=1).mean()) * MICRO, 1e-3)


def _clouds(turn: Turn, strength: float) -> Clouds:
    """Return points (n, 3) in µT and their styles, in the order of drawing."""
    rows = turn.rows(most=POINTS)
    up = {"color": UP, "marker": "s", "label": "up (accelerometer)"}
    raw = {"color": RAW, "marker": "^", "markersize": 3.2, "label": "raw field"}
    clouds: Clouds = [(strength * turn.up[rows], up), (MICRO * turn.field[rows], raw)]
    if turn.corrected is not None:
        field = MICRO * turn.corrected.field
        kept = turn.rows(turn.inliers, most=POINTS)
        clouds.append((field[kept], {"color": CORRECTED, "label": "corrected field"}))
        left_out = turn.rows(~turn.inliers, most=POINTS // 4)
        if len(left_out):
            clouds.append((field[left_out], LEFT_OUT | {"label": "left out"}))
    return clouds


def _draw_projection(
    axes: Any, turn: Turn, clouds: Clouds, strength: float, i: int, j: int
) -> None:
    phase = np.linspace(0.0, 2.0 * np.pi, 91)
    of_what = "raw field's mean size" if turn.corrected is None else "field's strength"
    outline = (strength * np.cos(phase), strength * np.sin(phase))
    axes.plot(*outline, color=SPHERE, linewidth=0.9, label=f"sphere: the {of_what}")
    axes.axhline(0.0, color=SPHERE, linewidth=0.5)
    axes.axvline(0.0, color=SPHERE, linewidth=0.5)
    for points, looks in clouds:
        dots(axes, points[:, i], points[:, j], **looks)
    if turn.corrected is not None:
        circle = MICRO * turn.corrected.circle
        axes.plot(circle[:, i], circle[:, j], color=IDEAL, linewidth=0.9, label="ideal circle")


def _draw_solid(axes: Any, turn: Turn, clouds: Clouds, strength: float, limit: float) -> None:
    around, down = np.meshgrid(np.linspace(0.0, 2.0 * np.pi, 25), np.linspace(0.0, np.pi, 13))
    axes.plot_wireframe(
        strength * np.sin(down) * np.cos(around),
        strength * np.sin(down) * np.sin(around),
        strength * np.cos(down),
        color="#DADADA",
        linewidth=0.35,
    )
    for points, looks in clouds:
        dots(axes, points[:, 0], points[:, 1], zs=points[:, 2], **looks)
    if turn.corrected is not None:
        circle = MICRO * turn.corrected.circle
        axes.plot(circle[:, 0], circle[:, 1], circle[:, 2], color=IDEAL, linewidth=0.9)
    axes.set(xlim=(-limit, limit), ylim=(-limit, limit), zlim=(-limit, limit))
    axes.set_box_aspect((1, 1, 1), zoom=1.2)
    axes.view_init(elev=24, azim=-58)
    for number, name in enumerate("xyz"):
        getattr(axes, f"set_{name}label")(NAMES[number], labelpad=-14, fontsize=8)
        axes.tick_params(axis=name, labelbottom=False, labelleft=False, pad=-4)
        getattr(axes, f"set_{name}ticklabels")([])
    axes.set_title("3-D view", pad=4)


RAW_FIELD = (
    "Below is the raw field. During a turn, two of its lines look like waves. Flat lines "
    "mean that the robot did not turn, or that the sensor does not measure the field. Jumps mean "
    "that something magnetic was switched on or off."
)
"""Explanation of the raw field for users who are not experts."""


def draw_residuals(figure: Figure, turn: Turn) -> None:
    """Draw the ring of measured headings, and the residuals, or without a fit the raw field."""
    corrected = turn.corrected
    _draw_ring(figure.add_axes((0.29, 0.625, 0.42, 0.3), projection="polar"), turn)
    axes = figure.add_axes((0.155, 0.175, 0.825, 0.345))
    if corrected is None:
        _draw_raw_field(axes, turn)
    else:
        _draw_residuals(axes, turn, corrected)
    legend_below(figure, axes, columns=3 if corrected is None else 2)


def caption_of_residuals(turn: Turn) -> str:
    """Return the explanation of the picture for users who are not experts."""
    hole = turn.coverage.hole_in_words or "none is missing"
    ring = f"The ring shows the measured headings, counted from the start: {hole}."
    if turn.corrected is None:
        return f"{ring} {RAW_FIELD}"
    return (
        f"{ring} Below are the residuals of the model: a cloud without a pattern inside the grey "
        "band is sensor noise; waves are caused by iron that turns with the robot, and bumps by "
        "something magnetic that passed by."
    )


HOLE = 0.55  # radius of the hole of the ring, of 1.6 in all


def _draw_ring(axes: Any, turn: Turn) -> None:
    axes.set_theta_zero_location("N")
    counts = np.zeros(BINS)
    if turn.angle is not None and turn.coverage.filled.any():
        where = np.mod(turn.angle, math.tau) * (BINS / math.tau)
        counts = np.bincount(where.astype(int) % BINS, minlength=BINS).astype(float)
    width = math.tau / BINS
    centre = (np.arange(BINS) + 0.5) * width
    # With square roots, the areas of the bars are comparable.
    height = np.sqrt(counts / max(float(counts.max()), 1.0))
    axes.bar(centre, height, width=0.9 * width, bottom=HOLE, color=CORRECTED)
    empty = centre[counts == 0.0]
    axes.bar(empty, 1.0, width=width, bottom=HOLE, color="#F6D9C6", edgecolor=RAW, linewidth=0.3)
    axes.set(ylim=(0.0, 1.6), yticks=[])
    axes.set_xticks(np.radians([0, 90, 180, 270]))
    axes.set_xticklabels(["start", "90° left", "180°", "90° right"])
    sides = ("center", "right", "center", "left")
    for label, side in zip(axes.get_xticklabels(), sides, strict=True):
        label.set_horizontalalignment(side)
    axes.tick_params(axis="x", pad=0)
    axes.grid(False)
    axes.spines["polar"].set_visible(False)
    # With a fit, the arc is the same as in the table of numbers.
    arc = turn.coverage.arc if turn.corrected is None else turn.corrected.estimate.arc
    measured = f"{math.degrees(arc):.0f}°\narc"
    axes.text(0.0, 0.0, measured, ha="center", va="center", fontsize=9.5)


def _draw_raw_field(axes: Any, turn: Turn) -> None:
    """Draw the three components over time, for a turn without an estimate."""
    rows = turn.rows()
    looks = (("x forward", RAW, "^"), ("y left", CORRECTED, "o"), ("z up", UP, "s"))
    for number, (words, colour, marker) in enumerate(looks):
        values = MICRO * turn.field[rows, number]
        dots(axes, turn.time[rows], values, color=colour, marker=marker, label=words)
    axes.set(xlabel="time since the first sample [s]", ylabel="raw field [µT]")


def _draw_residuals(axes: Any, turn: Turn, corrected: CorrectedTurn) -> None:
    angle = np.degrees(turn.angle if turn.angle is not None else np.arange(len(turn.time)))
    noise = 2.0 * corrected.estimate.noise_field * MICRO
    axes.axhspan(-noise, noise, color="#EAEAEA", label="±2σ of the field's noise")
    axes.axhline(0.0, color=IDEAL, linewidth=0.6)
    kept = turn.rows(turn.inliers)
    series = (
        (corrected.radial, CORRECTED, "o", "across the circle"),
        (corrected.axial, RAW, "^", "along the turn's axis"),
    )
    left_out = turn.rows(~turn.inliers, most=100)
    for values, colour, marker, words in series:
        shown = MICRO * values
        dots(axes, angle[kept], shown[kept], color=colour, marker=marker, label=words)
        if len(left_out):
            label = "left out" if values is corrected.axial else None
            dots(axes, angle[left_out], shown[left_out], **LEFT_OUT, label=label)
    axes.set(xlabel="turned since the start [°], left positive", ylabel="residual [µT]")
