"""The turn as a person watches it: a line a second, or a panel that is drawn again."""

from __future__ import annotations

import json
import math
import shutil
import sys
from typing import Any

from magcal_ros.files.plain import plain

BUSY = ("collecting", "fitting")

TOO_FAST = 45.0
TOO_SLOW = 5.0
"""Degrees per second of turning that is advised against."""

NUMBERS = ("arc_deg", "elapsed_s", "turn_rate_deg_s")
TEXTS = ("stage", "filled", "advice")

RING_HEIGHT = 11
RING_WIDTH = 25


class View:
    """Shows the progress of a turn."""

    def show(self, progress: dict[str, Any]) -> None:
        """Draw what `~/status` says of the turn; a view of nothing draws nothing."""

    def __enter__(self) -> View:
        return self

    def __exit__(self, *_: object) -> None:
        pass


def progress_of(status: str) -> dict[str, Any] | None:
    """Return how far a turn is from the text of `~/status`; None if none is under way.

    Whoever is in the graph may publish there: what is no status is passed over, and no text of it
    steers the terminal.
    """
    try:
        content = json.loads(status)
        if content["state"] not in BUSY:
            return None
        found = content["progress"]
        shown: dict[str, Any] = {name: float(found[name]) for name in NUMBERS}
        shown |= {name: plain(str(found[name])) for name in TEXTS}
        shown["samples"] = int(found["samples"])
        sigma = found["heading_sigma_deg"]
        shown["heading_sigma_deg"] = None if sigma is None else float(sigma)
    except (ValueError, TypeError, LookupError, OverflowError, RecursionError):
        return None
    return shown if all(math.isfinite(shown[name]) for name in NUMBERS) else None


def turns_itself(status: str) -> bool:
    """Whether the text of `~/status` says that the robot will turn by itself."""
    try:
        return json.loads(status)["turns_itself"] is True
    except (ValueError, TypeError, LookupError, RecursionError):
        return False


def best_view() -> View:
    """Return a panel on a terminal where rich is installed, else plain lines."""
    if sys.stdout.isatty():
        try:
            return Panel()
        except ImportError:
            pass
    return Lines()


def advice(progress: dict[str, Any]) -> str:
    """Say what to do next, in a few words."""
    rate = abs(progress["turn_rate_deg_s"])
    if progress["stage"] != "collecting":
        return "complete: fitting"
    if rate > TOO_FAST:
        return "slower, please"
    if 0.0 < rate < TOO_SLOW and progress["arc_deg"] > 10.0:
        return "a little faster"
    return progress["advice"] or "go on turning until the heading is certain"


def line(progress: dict[str, Any]) -> str:
    """Put a turn into one line."""
    sigma = progress["heading_sigma_deg"]
    certain = f", heading ±{sigma:.2f}°" if sigma is not None else ""
    return (
        f"[{progress['filled']}] {progress['arc_deg']:4.0f}° seen, "
        f"{progress['samples']} samples{certain} | {advice(progress)}"
    )


def ring(filled: str) -> list[str]:
    """Draw covered (#) and missing (.) headings as a ring, the start on top, left to the left."""
    canvas = [[" "] * RING_WIDTH for _ in range(RING_HEIGHT)]
    for k, mark in enumerate(filled):
        angle = (k + 0.5) * math.tau / len(filled)
        row = round((RING_HEIGHT - 1) / 2 * (1.0 - math.cos(angle)))
        column = round((RING_WIDTH - 1) / 2 * (1.0 - math.sin(angle)))
        canvas[row][column] = mark
    return ["".join(row) for row in canvas]


class Lines(View):
    """A line a second: for pipes and logs."""

    def __init__(self) -> None:
        self._second = -1

    def show(self, progress: dict[str, Any]) -> None:
        """Print at most one line a second."""
        second = int(progress["elapsed_s"])
        if second != self._second:
            # A terminal that is narrower would break the line, and scroll by two.
            width = shutil.get_terminal_size().columns - 1 if sys.stdout.isatty() else None
            print(line(progress)[:width], flush=True)
        self._second = second


class Panel(View):
    """A panel that rich draws again and again.

    Raises
    ------
    ImportError
        If rich is not installed.
    """

    def __init__(self) -> None:
        from rich.live import Live

        self._live = Live(refresh_per_second=8)

    def show(self, progress: dict[str, Any]) -> None:
        """Draw ring, numbers and advice."""
        from rich.columns import Columns
        from rich.panel import Panel as Box
        from rich.text import Text

        drawing = Text("\n".join(ring(progress["filled"])))
        drawing.highlight_regex(r"#", "bold green")
        drawing.highlight_regex(r"\.", "red")
        sigma = progress["heading_sigma_deg"]
        numbers = [
            f"{progress['arc_deg']:.0f}° of the turn seen",
            f"{progress['samples']} samples in {progress['elapsed_s']:.0f} s",
            f"turning {progress['turn_rate_deg_s']:+.0f}°/s",
            "heading not yet certain" if sigma is None else f"heading ±{sigma:.2f}° (1σ)",
            "",
            advice(progress),
        ]
        body = Columns([drawing, Text("\n".join(numbers))], padding=(0, 4))
        self._live.update(Box(body, title="one turn", subtitle="Ctrl-C cancels"))

    def __enter__(self) -> Panel:
        self._live.__enter__()
        return self

    def __exit__(self, *arguments: Any) -> None:
        self._live.__exit__(*arguments)
