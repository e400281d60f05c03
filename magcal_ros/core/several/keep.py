"""The turns that a running node keeps, so that the next one can join them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from magcal_ros.core.calibrate import Outcome, calibrate
from magcal_ros.core.errors import Reason, Refusal
from magcal_ros.core.knowledge import Knowledge
from magcal_ros.core.window import Window

if TYPE_CHECKING:
    from magcal_ros.core.several.result import Several

MOST_TURNS = 12
MOST_SAMPLES = 4000
"""Bounds of what is kept; the oldest turn leaves first, and a long one is thinned."""


@dataclass(frozen=True, eq=False)
class Kept:
    """Turns that agree, in their order.

    Parameters
    ----------
    windows : tuple of Window
    names : tuple of str
        What each is called.
    count : int
        How many turns were tried, for the next one's name.
    """

    windows: tuple[Window, ...] = ()
    names: tuple[str, ...] = ()
    count: int = 0

    def joined(self, window: Window, several: Several) -> Kept:
        """Return what is kept once a turn has joined; a turn that had to go for it goes."""
        windows, names = (*self.windows, window), (*self.names, self.next_name)
        rows = several.joined[-MOST_TURNS:]
        return Kept(
            tuple(_thinned(windows[row]) for row in rows),
            tuple(names[row] for row in rows),
            self.count + 1,
        )

    @property
    def next_name(self) -> str:
        """What the next turn is called."""
        return f"turn {self.count + 1}"


def take_turn(
    kept: Kept, window: Window, knowledge: Knowledge, method: str, accumulate: bool
) -> tuple[Outcome, Kept]:
    """Fit a turn, together with those that are kept if turns are accumulated.

    Parameters
    ----------
    kept : Kept
        The turns before.
    window : Window
        The new turn.
    knowledge : Knowledge
        Of this moment; it holds for the turns before too.
    method : str
        Name of the method; only `maximum_likelihood` accumulates.
    accumulate : bool
        Whether turns are put together.

    Returns
    -------
    Outcome, Kept
        A turn that is refused does not join: the others stay as they are.
    """
    if not accumulate:
        return calibrate(window, knowledge, method), Kept()
    # Keeping turns loads nothing that fits: a node at rest pays for none of it.
    from magcal_ros.core.several.calibrate import calibrate_turns

    names = (*kept.names, kept.next_name)
    outcome = calibrate_turns([*kept.windows, window], knowledge, method, names)
    several = outcome.several
    if several is None or not several.fates[-1].joined:
        return _refused(outcome, kept), kept
    if not outcome.verdict.accepted:
        return outcome, kept
    return outcome, kept.joined(window, several)


def _refused(outcome: Outcome, kept: Kept) -> Outcome:
    """Say why the new turn did not join; what the turns before tell is no news."""
    if not kept.windows:
        return outcome
    why = outcome.verdict.summary if outcome.several is None else outcome.several.fates[-1].words
    words = (
        f"{kept.next_name} does not join the {_turns(len(kept.windows))} before it: "
        f"{why.rstrip('.')}; those before stay"
    )
    refusal = Refusal(outcome.reason or Reason.TURNS_DISAGREE, words)
    return replace(Outcome.refused(refusal), several=outcome.several)


def _turns(count: int) -> str:
    return "turn" if count == 1 else f"{count} turns"


def _thinned(window: Window) -> Window:
    step = math.ceil(len(window) / MOST_SAMPLES)
    return window if step <= 1 else window.take(np.arange(0, len(window), step))


def names_of(paths: Sequence[str]) -> list[str]:
    """Return names that tell recordings apart: the paths, numbered where one comes twice."""
    return [
        path if paths.count(path) == 1 else f"{path} ({paths[: k + 1].count(path)})"
        for k, path in enumerate(paths)
    ]
