"""The live view of a turn in the terminal, and how a command joins the ROS graph."""

from __future__ import annotations

import contextlib
import json
import math
import os
import shutil
import signal
import sys
import threading
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

from magcal_ros.cli.common import bullets
from magcal_ros.core.errors import MagcalError, UsageError
from magcal_ros.files.disk import printable

if TYPE_CHECKING:
    from rclpy.node import Node

LONGEST_ERROR = 500


@contextlib.contextmanager
def joined(name: str, ros_arguments: list[str] | None = None) -> Iterator[Node]:
    """Yield a node; MagcalError without rclpy, UsageError if ROS refuses name or arguments."""
    try:
        import rclpy
        from rclpy.signals import SignalHandlerOptions
    except ImportError as error:
        raise MagcalError(
            "this command needs ROS: source the setup file of ROS, or use the environment that "
            f"`make demo` creates in a checkout ({error})"
        ) from error
    # With rclpy's signal handler, Ctrl-C shuts down the context before the turn can be cancelled.
    try:
        rclpy.init(args=ros_arguments, signal_handler_options=SignalHandlerOptions.NO)
        node = rclpy.create_node(name)
    # rclpy has several base classes of errors: arguments, names, the environment.
    except Exception as error:
        rclpy.try_shutdown()
        words = printable(" ".join(str(error).split()), LONGEST_ERROR)
        raise UsageError(
            f"ROS does not start: {words}. Check --ros-args, ROS_DOMAIN_ID and the other ROS_ and "
            "RMW_ variables"
        ) from error
    try:
        yield node
    finally:
        node.destroy_node()
        rclpy.try_shutdown()


def use_local_traffic() -> None:
    """Limit DDS to this machine and a separate domain, unless the user has set other values."""
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    if os.environ.get("ROS_DISTRO") == "humble":
        # Humble does not know the discovery range; newer versions warn if both are set.
        os.environ.setdefault("ROS_LOCALHOST_ONLY", "1")
    os.environ.setdefault("ROS_DOMAIN_ID", str(100 + os.getpid() % 100))


@contextlib.contextmanager
def interrupts_noted() -> Iterator[threading.Event]:
    """Set an event on Ctrl-C instead of raising KeyboardInterrupt, perhaps inside rclpy."""
    noted = threading.Event()
    before = signal.signal(signal.SIGINT, lambda *_: noted.set())
    try:
        yield noted
    finally:
        signal.signal(signal.SIGINT, before)


BUSY = ("collecting", "fitting")

TOO_FAST = 45.0
TOO_SLOW = 5.0
"""Limits of the advised turn rate, degrees per second."""

NUMBERS = ("arc_deg", "elapsed_s", "turn_rate_deg_s")
TEXTS = ("stage", "filled", "advice")

RING_HEIGHT = 11
RING_WIDTH = 25
WIDEST = 80
"""Columns of the panel; on a narrower terminal it has the width of the terminal."""


def status_of(text: str) -> dict[str, Any]:
    """Return the content of `~/status`; empty for another text, because any node may publish."""
    try:
        content = json.loads(text)
    except (ValueError, RecursionError):
        return {}
    return content if isinstance(content, dict) else {}


def progress_of(status: dict[str, Any]) -> dict[str, Any] | None:
    """Return the progress of a turn in a status; None if no turn is under way.

    Entries of other types are ignored, and control characters are replaced.
    """
    try:
        if status["state"] not in BUSY:
            return None
        found = status["progress"]
        shown: dict[str, Any] = {name: float(found[name]) for name in NUMBERS}
        shown |= {name: printable(str(found[name])) for name in TEXTS}
        shown["samples"] = int(found["samples"])
        sigma = found["heading_sigma_deg"]
        shown["heading_sigma_deg"] = None if sigma is None else float(sigma)
    except (ValueError, TypeError, LookupError, OverflowError):
        return None
    return shown if all(math.isfinite(shown[name]) for name in NUMBERS) else None


def with_all_reasons(message: str, status: dict[str, Any]) -> str:
    """Return the answer of ~/calibrate with all reasons against the result, each on one line.

    The answer contains the first reasons; the status contains all.
    """
    try:
        verdict = status["verdict"]
        summary, headline = str(verdict["summary"]), str(verdict["headline"])
        against = [printable(str(words), LONGEST_ERROR) for words in verdict["against"]]
        accepted = verdict["accepted"] is True
    except (TypeError, LookupError):
        return message
    before, found, after = message.partition(summary)
    if not (found and summary and against):
        return message
    listed = bullets("But:" if accepted else "The reasons:", against)
    return f"{before}{printable(headline, LONGEST_ERROR)}\n{listed}\n{after.strip()}"


def best_view() -> ProgressLines:
    """Return a panel on a terminal if rich is installed, else plain lines."""
    if sys.stdout.isatty():
        with contextlib.suppress(ImportError):
            return Panel()
    return ProgressLines()


def advice(progress: dict[str, Any]) -> str:
    """Return what to do next, in a few words."""
    rate = abs(progress["turn_rate_deg_s"])
    if progress["stage"] != "collecting":
        return "complete, you can stop: fitting"
    if rate > TOO_FAST:
        return "slower, please"
    if 0.0 < rate < TOO_SLOW and progress["arc_deg"] > 10.0:
        return "a little faster"
    return progress["advice"] or "continue turning until the heading is certain"


def line(progress: dict[str, Any]) -> str:
    """Return the progress of a turn in one line."""
    sigma = progress["heading_sigma_deg"]
    certain = f", heading ±{sigma:.2f}°" if sigma is not None else ""
    return (
        f"[{progress['filled']}] {progress['arc_deg']:4.0f}° measured, "
        f"{progress['samples']} samples{certain} | {advice(progress)}"
    )


def ring(filled: str) -> list[str]:
    """Return covered (#) and missing (.) headings as a ring, from the top counter-clockwise."""
    canvas = [[" "] * RING_WIDTH for _ in range(RING_HEIGHT)]
    for k, mark in enumerate(filled):
        angle = (k + 0.5) * math.tau / len(filled)
        row = round((RING_HEIGHT - 1) / 2 * (1.0 - math.cos(angle)))
        column = round((RING_WIDTH - 1) / 2 * (1.0 - math.sin(angle)))
        canvas[row][column] = mark
    return ["".join(row) for row in canvas]


class ProgressLines(contextlib.AbstractContextManager["ProgressLines"]):
    """Shows the progress of a turn in lines, for pipes and logs."""

    def __init__(self) -> None:
        self._second, self._printed = -1, ""

    def show(self, progress: dict[str, Any]) -> None:
        """Print at most one line a second, and no line twice in a row."""
        second, words = int(progress["elapsed_s"]), line(progress)
        if second != self._second and words != self._printed:
            # The line is cut to the width of the terminal.
            width = shutil.get_terminal_size().columns - 1 if sys.stdout.isatty() else None
            print(words[:width], flush=True)
            self._second, self._printed = second, words

    def __exit__(self, *_: object) -> None:
        pass


class Panel(ProgressLines):
    """Shows the progress of a turn in a panel; raises ImportError if rich is not installed."""

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
            f"{progress['arc_deg']:.0f}° of the turn measured",
            f"{progress['samples']} samples in {progress['elapsed_s']:.0f} s",
            f"turning {progress['turn_rate_deg_s']:+.0f}°/s",
            "heading not yet certain" if sigma is None else f"heading ±{sigma:.2f}° (1σ)",
            "",
            advice(progress),
        ]
        body = Columns([drawing, Text("\n".join(numbers))], padding=(0, 4))
        self._live.start()
        self._live.update(Box(body, title="one turn", subtitle="Ctrl-C cancels", width=WIDEST))

    def __exit__(self, *_: object) -> None:
        self._live.stop()
