"""The result of several turns, the advice for the next one, and the turns that are kept."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from magcal_ros.core.samples.window import Window


@dataclass(frozen=True)
class KeptTurnsTuning:
    """How much is kept of the turns: the oldest is dropped first, and a long one is thinned."""

    most_turns: int = 12
    most_samples: int = 4000


TUNING = KeptTurnsTuning()


@dataclass(frozen=True, eq=False)
class KeptTurns:
    """Turns that agree, in their order."""

    windows: tuple[Window, ...] = ()
    names: tuple[str, ...] = ()
    count: int = 0  # how many turns were tried, for the next one's name

    def joined(self, window: Window, multi_turn: MultiTurnReport) -> KeptTurns:
        """Return the kept turns after a turn has joined, without those it has excluded."""
        windows, names = (*self.windows, window), (*self.names, self.next_name)
        rows = multi_turn.joined[-TUNING.most_turns :]
        return KeptTurns(
            tuple(_thinned(windows[row]) for row in rows),
            tuple(names[row] for row in rows),
            self.count + 1,
        )

    @property
    def next_name(self) -> str:
        """The name of the next turn."""
        return f"turn {self.count + 1}"


def _thinned(window: Window) -> Window:
    step = math.ceil(len(window) / TUNING.most_samples)
    return window if step <= 1 else window.take(np.arange(0, len(window), step))


def names_of(paths: Sequence[str]) -> list[str]:
    """Return distinct names of recordings: the paths, numbered if repeated."""
    return [
        path if paths.count(path) == 1 else f"{path} ({paths[: k + 1].count(path)})"
        for k, path in enumerate(paths)
    ]


WORTH_A_TURN = 0.85
"""Ratio of sigmas below which a quantity counts as better known; a further turn is advised if that
applies to the absolute heading."""


@dataclass(frozen=True)
class TurnAccuracy:
    """Standard deviations of quantities that one turn cannot determine, and of the heading.

    They include the priors of soft iron and the installation's yaw, so that those after one turn
    and after several are comparable.
    """

    installation_yaw: float  # radians
    soft_iron: tuple[float, ...]  # elements xx, yy, zz, xy, xz, yz; dimensionless
    axial_hard_iron: float  # along body z, tesla
    strength: float
    inclination: float  # tesla, radians
    level: float
    tilted: float
    """Heading on the level and on slopes of 10° without one common offset, radians."""
    absolute_level: float
    absolute_tilted: float  # the same with this offset, the yaw of the installation

    @property
    def in_words(self) -> str:
        """One line, in degrees and microtesla."""
        iron = 100.0 * max(self.soft_iron)
        return (
            f"installation yaw ±{_degrees(self.installation_yaw)}, "
            f"absolute heading ±{_degrees(self.absolute_level)} on level ground and "
            f"±{_degrees(self.absolute_tilted)} at 10° of tilt, "
            f"inclination ±{_degrees(self.inclination)}, "
            f"axial hard iron ±{self.axial_hard_iron * 1e6:.2f} µT, "
            f"soft iron ±{iron:.1f}% at worst (1σ)"
        )

    def facts(self) -> dict[str, object]:
        """Return the standard deviations in degrees, microtesla and percent, rounded."""
        degrees = {
            "installation_yaw": self.installation_yaw,
            "inclination": self.inclination,
            "heading": self.level,
            "heading_tilted": self.tilted,
            "heading_absolute": self.absolute_level,
            "heading_absolute_tilted": self.absolute_tilted,
        }
        facts: dict[str, object] = {
            f"{name}_deg": round(math.degrees(value), 4) for name, value in degrees.items()
        }
        facts["axial_hard_iron_ut"] = round(self.axial_hard_iron * 1e6, 4)
        facts["strength_ut"] = round(self.strength * 1e6, 4)
        facts["soft_iron_percent"] = [round(100.0 * value, 4) for value in self.soft_iron]
        return facts

    def improvement(self, before: TurnAccuracy) -> str:
        """Return in words what a turn has improved, compared with `before`."""
        parts = self.changes(before)
        if not parts:
            return "the same tilt as before: this reduces noise, but shows nothing new"
        return "brought " + ", ".join(parts)

    def changes(self, before: TurnAccuracy) -> list[str]:
        """Return what is better known than before, the most important first."""
        tilted, iron = "absolute heading at 10° of tilt", max(self.soft_iron)
        rows = [
            ("installation yaw", before.installation_yaw, self.installation_yaw, _degrees),
            (tilted, before.absolute_tilted, self.absolute_tilted, _degrees),
            ("inclination", before.inclination, self.inclination, _degrees),
            ("axial hard iron", before.axial_hard_iron, self.axial_hard_iron, _microtesla),
            ("soft iron at worst", max(before.soft_iron), iron, _percent),
        ]
        return [
            f"{name} from ±{unit(old)} to ±{unit(new)}"
            for name, old, new, unit in rows
            if new < WORTH_A_TURN * old
        ]

    def is_worth_a_turn(self, before: TurnAccuracy) -> bool:
        """Whether the absolute heading is so much better known that a turn is advised."""
        return self.absolute_tilted < WORTH_A_TURN * before.absolute_tilted


@dataclass(frozen=True)
class TurnAdvice:
    """A further turn, and the expected result."""

    pose: str  # how the robot should stand, to be read after "turn"
    after: TurnAccuracy


@dataclass(frozen=True)
class TurnResult:
    """The result for one turn."""

    name: str
    words: str  # what it added, or why it was left out
    shown: TurnAccuracy | None = None  # standard deviations after it joined; None if it did not

    @property
    def joined(self) -> bool:
        """Whether it is part of the estimate."""
        return self.shown is not None


@dataclass(frozen=True)
class MultiTurnReport:
    """The report on joined turns."""

    turns: tuple[TurnResult, ...]  # one for each turn, in order
    advice: tuple[TurnAdvice, ...]  # further turns, the best first

    @property
    def joined(self) -> tuple[int, ...]:
        """Indices of the turns that are part of the estimate."""
        return tuple(index for index, each in enumerate(self.turns) if each.joined)

    @property
    def newest(self) -> int:
        """Index of the last turn that joined; the estimate's residuals are on its samples."""
        return self.joined[-1]

    @property
    def shown(self) -> TurnAccuracy:
        """Standard deviations by all turns that joined."""
        return next(each.shown for each in reversed(self.turns) if each.shown is not None)

    @property
    def advice_in_words(self) -> str:
        """The advice for the next turn, with the numbers before and after."""
        now = f"absolute heading at 10° of tilt ±{_degrees(self.shown.absolute_tilted)}"
        if not self.advice:
            return f"Now {now}."
        first = self.advice[0]
        if not first.after.is_worth_a_turn(self.shown):
            left = _degrees(first.after.absolute_tilted)
            return f"Another turn would bring little: {now} (at best ±{left})."
        # The best of the other kind: on a slope, or with a tilted robot.
        other = next((a for a in self.advice if a.pose[:2] != first.pose[:2]), first)
        both = [first]
        if other is not first and other.after.is_worth_a_turn(self.shown):
            both.append(other)
        parts = [f"{a.pose}: {', '.join(a.after.changes(self.shown)[:2])}." for a in both]
        return "Next turn " + " Or ".join(parts)

    @property
    def in_words(self) -> str:
        """Several sentences: which turns joined, why others did not, results, advice."""
        count = len(self.joined)
        words = f"{count} turn{'s' if count > 1 else ''} together: {self.shown.in_words}."
        for each in self.turns:
            if not each.joined:
                words += f" Not joined: {each.name}: {each.words}."
        return f"{words} {self.advice_in_words}"

    def facts(self) -> dict[str, object]:
        """Return everything as plain values for JSON, in degrees, microtesla and percent."""
        return {
            "turns": [
                {
                    "name": each.name,
                    "joined": each.joined,
                    "words": each.words,
                    "shown": None if each.shown is None else each.shown.facts(),
                }
                for each in self.turns
            ],
            "shown": self.shown.facts(),
            "next": [{"pose": a.pose, "after": a.after.facts()} for a in self.advice],
            "advice": self.advice_in_words,
        }


def _degrees(radians: float) -> str:
    value = math.degrees(radians)
    return "many °" if value > 90.0 else f"{value:.2g}°"


def _microtesla(tesla: float) -> str:
    return "many µT" if tesla > 100e-6 else f"{tesla * 1e6:.2g} µT"


def _percent(share: float) -> str:
    return f"{100.0 * share:.2g}%"
