"""The log lines of the node; none is repeated without news."""

from __future__ import annotations

import math
import os
import re
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from traceback import walk_tb
from typing import Protocol

from magcal_ros.core.session.turn_machine import Conclusion

PAUSE = 10.0  # seconds between two lines on one subject

LASTING = 3.0
"""Seconds that something must be wrong before it is logged: drivers start one after another."""

_NUMBER = re.compile(r"\d+(?:\.\d+)?")


class Log(Protocol):
    """What is needed of a logger; rclpy's own class is none of its public names."""

    def info(self, message: str) -> object:
        """Log an event."""

    def warning(self, message: str) -> object:
        """Log what is wrong."""

    def error(self, message: str) -> object:
        """Log a failure."""


@dataclass
class _Line:
    """The line to log on a subject, the line that was logged last, and when."""

    text: str = ""
    wrong: bool = False
    said: str = ""
    at: float = -PAUSE


class Announcer:
    """Logs what has changed, at most once in ten seconds for each subject."""

    def __init__(
        self, log: Log, clock: Callable[[], float] = time.monotonic, lasting: float = LASTING
    ) -> None:
        self._log, self._clock, self._lasting = log, clock, lasting
        self._lines: dict[str, _Line] = {}
        self._wrong_since: dict[str, float] = {}
        self._complained_at: dict[str, float] = {}
        self._turning = False
        self._answer: Conclusion | None = None

    def tell(self, subject: str, text: str, *, wrong: bool = False) -> None:
        """Log something on a subject, if it differs from what was logged last.

        What comes sooner than ten seconds after the last line waits for `complain`, and only the
        newest of it is logged.
        """
        line = self._lines.setdefault(subject, _Line())
        line.text, line.wrong = text, wrong
        self._say_if_due(line)

    def complain(self, complaints: Iterable[str]) -> None:
        """Log what is wrong: once it has lasted, and again when it comes back.

        A complaint in which only numbers change is the same one. What `tell` was told and had to
        wait is logged as well: to be called about once a second.
        """
        for line in self._lines.values():
            self._say_if_due(line)
        now = self._clock()
        found = {_NUMBER.sub("#", text): text for text in complaints}
        self._wrong_since = {kind: self._wrong_since.get(kind, now) for kind in found}
        said = self._complained_at
        said = {kind: at for kind, at in said.items() if kind in found or now - at < PAUSE}
        for kind, since in self._wrong_since.items():
            last = said.get(kind, -math.inf)
            if last < since and now - last >= PAUSE and now - since >= self._lasting:
                said[kind] = now
                self._log.warning(found[kind])
        self._complained_at = said

    def follow_turn(self, turning: bool, answer: Conclusion | None) -> None:
        """Log that a turn begins, and the words of each new answer."""
        if answer is not None and answer is not self._answer:
            self._answer, self._turning = answer, False
            self._log.info(f"the turn is over: {answer.message}")
        elif turning and not self._turning:
            self._turning = True
            self._log.info("a turn begins")

    def _say_if_due(self, line: _Line) -> None:
        now = self._clock()
        if line.text != line.said and now - line.at >= PAUSE:
            line.said, line.at = line.text, now
            # rclpy refuses another severity from the same call.
            if line.wrong:
                self._log.warning(line.text)
            else:
                self._log.info(line.text)


LONGEST = 300  # characters of an error's own words that go into the log; some quote a whole message


class CallbackErrors:
    """Counts the errors of all callbacks and logs each kind, a type at a line of code, once."""

    def __init__(self, log: Callable[[str], object]) -> None:
        self._log = log
        self._known: set[tuple[type[BaseException], str]] = set()
        self.total = 0

    def note(self, error: BaseException) -> str:
        """Count an error that a callback raised, and log it if its kind is new; says what it is."""
        self.total += 1
        # Without the lines of the source: what is short of files can read none.
        calls = list(walk_tb(error.__traceback__))
        place = "an unknown place"
        if calls:
            innermost, line = calls[-1]
            place = f"{os.path.basename(innermost.f_code.co_filename)}, line {line}"
        kind = type(error), place
        words = " ".join(str(error).split())[:LONGEST]
        said = f"an error in a callback, {kind[0].__name__} in {place}"
        # What rclpy does with a message on /clock.
        if any(frame.f_globals.get("__name__") == "rclpy.time_source" for frame, _ in calls):
            said = "the simulated time on /clock jumped to a time that ROS cannot represent"
        if kind not in self._known:
            self._known.add(kind)
            self._log(
                f"{said}: {words}. The node continues; further errors of this kind are only "
                "counted, in Inputs of /diagnostics"
            )
        return said
