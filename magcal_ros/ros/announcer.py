"""The node's log: a line is written only when its content has changed."""

from __future__ import annotations

import math
import os
import re
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from traceback import walk_tb
from typing import Protocol

PAUSE = 10.0  # seconds between two lines on one subject

LASTING = 3.0
"""Seconds that a fault must last before it is logged, because drivers do not start together."""

_NUMBER = re.compile(r"\d+(?:\.\d+)?")


class Log(Protocol):
    """The methods that a logger needs, because rclpy's class of loggers is not public."""

    def info(self, message: str) -> object:
        """Log an event."""

    def warning(self, message: str) -> object:
        """Log a fault."""

    def error(self, message: str) -> object:
        """Log a failure."""


@dataclass
class _Line:
    """The newest line on a subject, and the line that was logged last."""

    text: str = ""
    wrong: bool = False
    logged: str = ""  # logged last
    at: float = -PAUSE  # time of the last log, seconds


class Announcer:
    """Logs changes, at most once in ten seconds for each subject."""

    def __init__(
        self, log: Log, clock: Callable[[], float] = time.monotonic, lasting: float = LASTING
    ) -> None:
        self._log, self._clock, self._lasting = log, clock, lasting
        self._lines: dict[str, _Line] = {}
        self._wrong_since: dict[str, float] = {}
        self._complained_at: dict[str, float] = {}

    def tell(self, subject: str, text: str, *, wrong: bool = False) -> None:
        """Log a line on a subject if it differs from the line that was logged last.

        Within ten seconds after the last line, the newest line waits for `complain`.
        """
        line = self._lines.setdefault(subject, _Line())
        line.text, line.wrong = text, wrong
        self._say_if_due(line)

    def complain(self, complaints: Iterable[str]) -> None:
        """Log each complaint once it has lasted, and again when it comes back.

        Complaints that differ only in numbers are the same. Waiting lines of `tell` are logged too.
        To be called about once a second.
        """
        for line in self._lines.values():
            self._say_if_due(line)
        now = self._clock()
        found = {_NUMBER.sub("#", text): text for text in complaints}
        self._wrong_since = {kind: self._wrong_since.get(kind, now) for kind in found}
        logged_at = {
            kind: at
            for kind, at in self._complained_at.items()
            if kind in found or now - at < PAUSE
        }
        for kind, since in self._wrong_since.items():
            last = logged_at.get(kind, -math.inf)
            if last < since and now - last >= PAUSE and now - since >= self._lasting:
                logged_at[kind] = now
                self._log.warning(found[kind])
        self._complained_at = logged_at

    def _say_if_due(self, line: _Line) -> None:
        now = self._clock()
        if line.text != line.logged and now - line.at >= PAUSE:
            line.logged, line.at = line.text, now
            # rclpy refuses another severity from the same call.
            if line.wrong:
                self._log.warning(line.text)
            else:
                self._log.info(line.text)


LONGEST = 300  # logged characters of an error's text; some errors quote a whole message


class CallbackErrors:
    """Counts the errors of all callbacks; logs each type of error at each line of code once."""

    def __init__(self, log: Callable[[str], object]) -> None:
        self._log = log
        self._known: set[tuple[type[BaseException], str]] = set()
        self.total = 0

    def note(self, error: BaseException) -> str:
        """Count an error of a callback, log it if its kind is new, and return its description."""
        self.total += 1
        # No source lines are read, because there may be no free file descriptor.
        calls = list(walk_tb(error.__traceback__))
        place = "an unknown place"
        if calls:
            innermost, line = calls[-1]
            place = f"{os.path.basename(innermost.f_code.co_filename)}, line {line}"
        kind = type(error), place
        words = " ".join(str(error).split())[:LONGEST]
        text = f"an error in a callback, {kind[0].__name__} in {place}"
        # The error comes from rclpy's own callback of /clock.
        if any(frame.f_globals.get("__name__") == "rclpy.time_source" for frame, _ in calls):
            text = "the simulated time on /clock jumped to a time that ROS cannot represent"
        if kind not in self._known:
            self._known.add(kind)
            self._log(
                f"{text}: {words}. The node continues; further errors of this kind are only "
                "counted, in Inputs of /diagnostics"
            )
        return text
