"""The turns that a running node keeps, so that the next one can join them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from magcal_ros.core.multi_turn.result import Several
from magcal_ros.core.samples.window import Window


@dataclass(frozen=True)
class KeptTuning:
    """How much is kept of the turns: the oldest leaves first, and a long one is thinned."""

    most_turns: int = 12
    """Turns."""
    most_samples: int = 4000
    """Samples of each."""


TUNING = KeptTuning()


@dataclass(frozen=True, eq=False)
class Kept:
    """Turns that agree, in their order."""

    windows: tuple[Window, ...] = ()
    names: tuple[str, ...] = ()
    """What each is called."""
    count: int = 0
    """How many turns were tried, for the next one's name."""

    def joined(self, window: Window, several: Several) -> Kept:
        """Return what is kept once a turn has joined; a turn that had to go for it goes."""
        windows, names = (*self.windows, window), (*self.names, self.next_name)
        rows = several.joined[-TUNING.most_turns :]
        return Kept(
            tuple(_thinned(windows[row]) for row in rows),
            tuple(names[row] for row in rows),
            self.count + 1,
        )

    @property
    def next_name(self) -> str:
        """What the next turn is called."""
        return f"turn {self.count + 1}"


def _thinned(window: Window) -> Window:
    step = math.ceil(len(window) / TUNING.most_samples)
    return window if step <= 1 else window.take(np.arange(0, len(window), step))


def names_of(paths: Sequence[str]) -> list[str]:
    """Return names that tell recordings apart: the paths, numbered where one comes twice."""
    return [
        path if paths.count(path) == 1 else f"{path} ({paths[: k + 1].count(path)})"
        for k, path in enumerate(paths)
    ]
