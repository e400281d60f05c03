"""Drawing one picture to inline SVG, without matplotlib's global state."""

from __future__ import annotations

import io
import re
import threading
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from magcal_ros.report.turn import Turn

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Draw = Callable[["Figure", Turn], None]

RAW = "#D55E00"
CORRECTED = "#0072B2"
UP = "#009E73"
ODD = "#CC79A7"
IDEAL = "#222222"
SPHERE = "#B8B8B8"
"""Okabe and Ito's colours, which colour-blind people tell apart; markers differ besides."""

LEFT_OUT = {"color": ODD, "marker": "x", "markersize": 4.0, "markeredgewidth": 0.9}
"""How samples look that the fit did not believe."""

MICRO = 1e6

SIZE = (4.9, 5.5)
"""Width and height of every picture, inches."""

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
# matplotlib's style is one for the whole process, so only one picture is drawn at a time.
_DRAWING = threading.Lock()


def draw_svg(draw: Draw, turn: Turn, name: str, words: str) -> str:
    """Draw a picture.

    Returns
    -------
    str
        An `svg` element that refers to nothing outside of itself.

    Raises
    ------
    ImportError
        If there is no matplotlib.
    """
    import matplotlib
    from matplotlib.figure import Figure

    style: Any = STYLE | {"svg.hashsalt": name}
    with _DRAWING, matplotlib.rc_context(style):
        figure = Figure(figsize=SIZE)
        draw(figure, turn)
        target = io.StringIO()
        figure.savefig(target, format="svg", metadata=dict.fromkeys(_METADATA), transparent=True)
    return _inline(target.getvalue(), name, words)


_METADATA = ("Creator", "Date", "Format", "Type")


def _inline(svg: str, name: str, words: str) -> str:
    """Make an SVG file part of a page: no foreign names, ids of its own, short numbers."""
    body = svg[svg.index("<svg") :]
    body = re.sub(r"<metadata>.*?</metadata>", "", body, flags=re.S)
    body = re.sub(r"<style[^>]*>.*?</style>", "", body, flags=re.S)
    body = re.sub(r"<!--.*?-->", "", body, flags=re.S)
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
    """Put the legend of one of its axes under the figure."""
    handles, labels = source.get_legend_handles_labels()
    figure.legend(handles, labels, loc="lower center", ncol=columns, markerscale=2.2)
