"""What the commands share: exit statuses, options, where files go, and how numbers are printed."""

from __future__ import annotations

import argparse
import json
import math
from collections.abc import Callable, Mapping, Sequence
from datetime import datetime
from enum import IntEnum
from pathlib import Path
from typing import Any

from magcal_ros.files.atomic import FileTrouble


class Exit(IntEnum):
    """What the shell sees.

    FAULT is an error of this package itself; the last two are the shell's own for SIGINT and
    SIGPIPE.
    """

    GOOD = 0
    FAILED = 1
    USAGE = 2
    TOO_LITTLE_DATA = 3
    REFUSED = 4
    FILE_TROUBLE = 5
    FAULT = 70
    INTERRUPTED = 130
    PIPE_CLOSED = 141


def number(low: float, high: float) -> Callable[[str], float]:
    """Return what turns an argument into a number from `low` to `high`, or says what is wrong."""

    def parse(text: str) -> float:
        try:
            value = float(text)
        except ValueError:
            raise argparse.ArgumentTypeError(f"{text!r} is not a number") from None
        if not low <= value <= high:
            raise argparse.ArgumentTypeError(f"must lie between {low:g} and {high:g}, not {text}")
        return value

    return parse


def add_output_option(parser: argparse.ArgumentParser, content: str, prefix: str) -> None:
    """Add the folder that `new_or_named` takes."""
    words = f"folder for {content} (default: a new {prefix}_DATE_TIME here)"
    parser.add_argument("--output", type=Path, metavar="DIR", help=words)


def new_or_named(chosen: Path | None, prefix: str) -> Path:
    """Return the folder the user named, or a new dated one in the working directory.

    Raises
    ------
    FileTrouble
        If the name belongs to a file.
    """
    if chosen is None:
        name = datetime.now().strftime(f"{prefix}_%Y%m%d_%H%M%S")
        names = [name, *(f"{name}_{k}" for k in range(2, 100))]
        return next(Path(name) for name in names if not Path(name).exists())
    if chosen.exists() and not chosen.is_dir():
        raise FileTrouble(f"{chosen} is a file: name a folder with --output")
    return chosen


def table(rows: Sequence[Sequence[str]]) -> str:
    """Lay out rows of equal length: the first column to the left, the others to the right."""
    widths = [max(len(row[k]) for row in rows) for k in range(len(rows[0]))]
    lines = []
    for first, *others in rows:
        cells = [first.ljust(widths[0])]
        cells += [cell.rjust(width) for cell, width in zip(others, widths[1:], strict=True)]
        lines.append("  " + "  ".join(cells).rstrip())
    return "\n".join(lines)


def bullets(title: str, items: Sequence[str]) -> str:
    """Return a titled list, or nothing if there are no items."""
    return "".join([f"\n{title}\n", *(f"  - {item}\n" for item in items)]) if items else ""


def document(content: Mapping[str, Any]) -> str:
    """Return one JSON document; a number that is not finite becomes null."""
    return json.dumps(_finite(content), ensure_ascii=False, indent=2, allow_nan=False)


def _finite(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {key: _finite(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_finite(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
