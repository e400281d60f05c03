"""The node's log: a line is written only when its content has changed."""

from __future__ import annotations

import math
import os
import re
import time
from collections.abc import Callable, Iterable
from traceback import walk_tb

from rclpy.node import Node

PAUSE = 10.0  # seconds between two lines on one subject

LASTING = 3.0
"""Seconds that a fault must last before it is logged, because drivers do not start together."""

_NUMBER = re.compile(r"\d+(?:\.\d+)?")


class Announcer:
    """Logs changes in the node's log, at most once in ten seconds for each subject."""

    def __init__(
        self, node: Node, clock: Callable[[], float] = time.monotonic, lasting: float = LASTING
    ) -> None:
        self._log, self._clock, self._lasting = node.get_logger(), clock, lasting
        # By subject, the newest line and whether it is a warning; the last logged line, its time.
        self._newest: dict[str, tuple[str, bool]] = {}
        self._logged: dict[str, tuple[str, float]] = {}
        self._wrong_since: dict[str, float] = {}
        self._complained_at: dict[str, float] = {}

    def tell(self, subject: str, text: str, *, wrong: bool = False) -> None:
        """Log a line on a subject if it differs from the line that was logged last.

        Within ten seconds after the last line, the newest line waits for `complain`.
        """
        self._newest[subject] = text, wrong
        self._say_if_due(subject)

    def complain(self, complaints: Iterable[str]) -> None:
        """Log each complaint once it has lasted, and again when it comes back.

        Complaints that differ only in numbers are the same. Waiting lines of `tell` are logged too.
        To be called about once a second.
        """
        for subject in self._newest:
            self._say_if_due(subject)
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

    def _say_if_due(self, subject: str) -> None:
        (text, wrong), now = self._newest[subject], self._clock()
        logged, at = self._logged.get(subject, ("", -math.inf))
        if text != logged and now - at >= PAUSE:
            self._logged[subject] = text, now
            # rclpy refuses another severity from the same call.
            if wrong:
                self._log.warning(text)
            else:
                self._log.info(text)


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
