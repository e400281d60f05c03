"""Errors raised in callbacks: each kind is logged once, and all are counted."""

from __future__ import annotations

import os
from collections.abc import Callable
from types import TracebackType

LONGEST = 300
"""Characters of an error's own words that go into the log; some quote a whole message."""


class CallbackErrors:
    """Counts the errors of all callbacks and logs each kind of them once.

    A kind is a type of error at a line of code.

    Parameters
    ----------
    log : callable
        Takes a line for the log.
    """

    def __init__(self, log: Callable[[str], object]) -> None:
        self._log = log
        self._known: set[tuple[type[BaseException], str]] = set()
        self.total = 0

    def note(self, error: BaseException) -> str:
        """Count an error that a callback raised, and log it if its kind is new; says what it is."""
        self.total += 1
        kind = type(error), _place(error.__traceback__)
        words = " ".join(str(error).split())[:LONGEST]
        said = f"an error in a callback, {kind[0].__name__} in {kind[1]}"
        if _is_of_clock(error.__traceback__):
            said = "the simulated time on /clock jumped to a time that ROS does not have"
        if kind not in self._known:
            self._known.add(kind)
            self._log(
                f"{said}: {words}. The node goes on; from now on this kind is only counted, "
                "in Inputs of /diagnostics"
            )
        return said


def _is_of_clock(trace: TracebackType | None) -> bool:
    """Whether it comes of what rclpy does with a message on /clock."""
    while trace is not None and trace.tb_frame.f_globals.get("__name__") != "rclpy.time_source":
        trace = trace.tb_next
    return trace is not None


def _place(trace: TracebackType | None) -> str:
    """Return file and line of the innermost call."""
    if trace is None:
        return "an unknown place"
    while trace.tb_next is not None:
        trace = trace.tb_next
    return f"{os.path.basename(trace.tb_frame.f_code.co_filename)}, line {trace.tb_lineno}"
