"""One parameter: its default, what is allowed, what it does."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

Value: TypeAlias = "bool | float | str | tuple[float, ...]"

UNSET = math.nan
"""Stands for a number that is not known; in YAML it is written .nan or left out."""


@dataclass(frozen=True)
class Spec:
    """One row of the table.

    Parameters
    ----------
    name : str
        Parameter name.
    default : bool, float, str or tuple of float
        Default, which also fixes the type.
    low, high : float
        Allowed range, for numbers.
    unit : str
        Unit, empty for none.
    description : str
        What it does.
    choices : tuple of str
        Allowed texts; empty for any.
    """

    name: str
    default: Value
    description: str
    low: float = -math.inf
    high: float = math.inf
    unit: str = ""
    choices: tuple[str, ...] = ()

    @property
    def may_be_unset(self) -> bool:
        """Whether .nan is allowed and means "not known"."""
        return isinstance(self.default, float) and math.isnan(self.default)

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
        return self._parse_number(value)

    def _parse_switch(self, value: Any) -> bool:
        if not isinstance(value, bool):
            raise ValueError(f"{self.name} must be true or false, not {value!r}")
        return value

    def _parse_text(self, value: Any) -> str:
        if not isinstance(value, str):
            raise ValueError(f"{self.name} must be a text, not {value!r}")
        if self.choices and value not in self.choices:
            raise ValueError(f"{self.name} must be one of {', '.join(self.choices)}, not {value!r}")
        return value

    def _parse_list(self, value: Any) -> tuple[float, ...]:
        assert isinstance(self.default, tuple)
        is_list = isinstance(value, Sequence) or hasattr(value, "tolist")
        if isinstance(value, str) or not is_list or len(value) != len(self.default):
            raise ValueError(f"{self.name} must be {len(self.default)} numbers, not {value!r}")
        return tuple(self._parse_number(item) for item in value)

    def _parse_number(self, value: Any) -> float:
        if isinstance(value, bool) or not isinstance(value, (int, float)):
            raise ValueError(f"{self.name} must be a number, not {value!r}")
        number = float(value)
        if math.isnan(number) and self.may_be_unset:
            return UNSET
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
    if isinstance(value, float):
        return ".nan" if math.isnan(value) else repr(value)
    return value or '""'
