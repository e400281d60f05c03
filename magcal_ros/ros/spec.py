"""One parameter: its default, what is allowed, what it does."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum
from typing import Any, TypeAlias

from magcal_ros.files.reading import plain

Value: TypeAlias = "bool | int | float | str | tuple[float, ...]"

LONGEST_TEXT = 4096
"""Characters of a text, as many as a path may have: it is shown, published and handed on."""

MOST_SHOWN = 20
"""Items of a list that are shown where it is refused."""

TRUE_NORTH, MAGNETIC_NORTH = "true_north", "magnetic_north"
"""Choices of a north; plain `true` would be no text in YAML."""

UNSET = math.nan
"""Stands for a number that is not known; in YAML it is written .nan or left out."""


class Later(Enum):
    """What of a parameter may be changed while the node runs.

    Whoever reaches the node's network may change parameters. What they must not be able to do is
    said when the node starts.
    """

    ANYTHING = "anything"
    NOTHING = "nothing"
    FILE = "a file below the package's own folder, or the one that was given at start"
    FOLDER = "a folder below the package's own or the one that was given at start"
    SWITCH_OFF = "switched off, and on only where that was allowed at start"


@dataclass(frozen=True)
class Spec:
    """One row of the table."""

    name: str
    """Parameter name."""
    default: Value
    """Default, which also fixes the type."""
    description: str
    """What it does."""
    low: float = -math.inf
    high: float = math.inf
    """Allowed range, for numbers."""
    unit: str = ""
    """Unit, empty for none."""
    choices: tuple[str, ...] = ()
    """Allowed texts; empty for any."""
    later: Later = Later.ANYTHING
    """What may be changed while the node runs."""
    words: tuple[str, ...] = ("",)
    """Texts that are no place, of one that names a place otherwise."""

    @property
    def may_be_unset(self) -> bool:
        """Whether .nan is allowed and means "not known"."""
        default = self.default[0] if isinstance(self.default, tuple) else self.default
        return isinstance(default, float) and math.isnan(default)

    def parse(self, value: Any) -> Value:
        """Return a value in the right type.

        Raises
        ------
        ValueError
            If it has the wrong type or lies outside the range; the text says what is right.
        """
        if isinstance(self.default, bool):
            return self._parse_switch(value)
        if isinstance(self.default, str):
            return self._parse_text(value)
        if isinstance(self.default, tuple):
            return self._parse_list(value)
        if isinstance(self.default, int):
            return self._parse_whole(value)
        return self._parse_number(value)

    def _parse_switch(self, value: Any) -> bool:
        if not isinstance(value, bool):
            raise ValueError(f"{self.name} must be true or false, not {_shown(value)}")
        return value

    def _parse_text(self, value: Any) -> str:
        if not isinstance(value, str):
            raise ValueError(f"{self.name} must be a text, not {_shown(value)}")
        if self.choices and value not in self.choices:
            allowed = ", ".join(self.choices)
            raise ValueError(f"{self.name} must be one of {allowed}, not {_shown(value)}")
        if len(value) > LONGEST_TEXT:
            raise ValueError(f"{self.name} must be no longer than {LONGEST_TEXT} characters")
        return value

    def _parse_list(self, value: Any) -> tuple[float, ...]:
        assert isinstance(self.default, tuple)
        items = _items(value)
        if items is None or len(items) != len(self.default):
            raise ValueError(
                f"{self.name} must be {len(self.default)} numbers, as in {self.yaml_default}, "
                f"not {_shown(value)}"
            )
        numbers = tuple(self._parse_number(item) for item in items)
        if len({math.isnan(number) for number in numbers}) > 1:
            raise ValueError(f"{self.name} must be known as a whole or not, not {_shown(value)}")
        return numbers

    def _parse_whole(self, value: Any) -> int:
        number = _number(value)
        if number is None or not number.is_integer():
            raise ValueError(f"{self.name} must be a whole number, not {_shown(value)}")
        return int(self._within(number))

    def _parse_number(self, value: Any) -> float:
        number = _number(value)
        if number is None:
            raise ValueError(f"{self.name} must be a number, not {_shown(value)}")
        if math.isnan(number) and self.may_be_unset:
            return UNSET
        return self._within(number)

    def _within(self, number: float) -> float:
        if not self.low <= number <= self.high:
            raise ValueError(
                f"{self.name} must lie between {self.low:g} and {self.high:g}"
                f"{' ' + self.unit if self.unit else ''}, not {number:g}"
            )
        return number

    @property
    def constraints(self) -> str:
        """What is allowed, in words; empty for anything."""
        if self.choices:
            return "one of: " + ", ".join(self.choices)
        if math.isinf(self.low):
            return ""
        unset = " or .nan" if self.may_be_unset else ""
        return f"{self.low:g} to {self.high:g} {self.unit}".rstrip() + unset

    @property
    def full_description(self) -> str:
        """What it does and what is allowed."""
        limits = self.constraints
        return f"{self.description} ({limits})" if limits else self.description

    @property
    def yaml_default(self) -> str:
        """The default as it is written in YAML."""
        return _yaml(self.default)


def _yaml(value: Value) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, tuple):
        return "[" + ", ".join(_yaml(item) for item in value) + "]"
    if isinstance(value, str):
        return value or '""'
    return ".nan" if math.isnan(value) else repr(value)


def _number(value: Any) -> float | None:
    """Return a number, also one that came as text; None for anything else.

    `ros2 param load` and `ros2 param set` send NaN and 1e-5 as texts: they take each value through
    Python's notation and back through YAML 1.1, which knows neither `nan` nor `1e-05`.
    """
    if isinstance(value, str):
        text = value.strip().lower()
        try:
            return math.nan if text == ".nan" else float(text)
        except ValueError:
            return None
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        return None
    try:
        return float(value)
    except OverflowError:
        return math.inf if value > 0 else -math.inf


def _items(value: Any) -> list[Any] | None:
    """Return a list's items; None if it is none.

    A list of whole numbers and others comes as text from `ros2 param`.
    """
    if isinstance(value, str):
        text = value.strip()
        return text[1:-1].split(",") if text[:1] == "[" and text[-1:] == "]" else None
    if hasattr(value, "tolist"):
        return list(value.tolist())
    return list(value) if isinstance(value, Sequence) else None


def _shown(value: Any) -> str:
    """Write a value as a person would have typed it, or how it begins: it may be of any size."""
    items = None if isinstance(value, str) else _items(value)
    if items is not None:
        more = ", …]" if len(items) > MOST_SHOWN else "]"
        return "[" + ", ".join(map(_shown, items[:MOST_SHOWN])) + more
    if value is None:
        return "nothing"
    return plain(str(value).lower() if isinstance(value, bool) else repr(value))
