"""Shared by the commands: exit statuses, options, output folders and printing."""

from __future__ import annotations

import argparse
import inspect
import json
import math
import re
import shutil
import sys
import textwrap
import time
from collections.abc import Callable, Mapping, Sequence
from datetime import datetime
from enum import IntEnum
from pathlib import Path
from typing import Any, TextIO

from magcal_ros.core.earth_field.reference import GivenReference, Reference, resolve
from magcal_ros.core.earth_field.wmm import Place, decimal_year, year_of
from magcal_ros.core.errors import UsageError
from magcal_ros.files.disk import FileError, printable_lines
from magcal_ros.ros.parameter_table import PARAMETERS

CALIBRATION = "calibration.yaml"
REMEDY = "Choose a writable place with --output, or correct its permissions."


class Exit(IntEnum):
    """The exit status. FAULT is an error of this package; the last two are those of the shell."""

    GOOD = 0
    FAILED = 1
    USAGE = 2
    TOO_LITTLE_DATA = 3
    REFUSED = 4
    FILE_TROUBLE = 5
    FAULT = 70
    INTERRUPTED = 130
    PIPE_CLOSED = 141


def command(
    commands: Any, name: str, run: Callable[[argparse.Namespace], int], words: str
) -> argparse.ArgumentParser:
    """Add a command; its description is the docstring of `run`."""
    parser: argparse.ArgumentParser = commands.add_parser(
        name, help=words, description=inspect.getdoc(run)
    )
    parser.set_defaults(run=run)
    return parser


def number(low: float, high: float) -> Callable[[str], float]:
    """Return a parser of arguments that are numbers from `low` to `high`."""

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
    """Add the option for the output folder, which `new_or_named` takes."""
    words = f"folder for {content} (default: a new {prefix}_DATE_TIME here)"
    parser.add_argument("--output", type=Path, metavar="DIR", help=words)


def new_or_named(chosen: Path | None, prefix: str) -> Path:
    """Return the folder the user named, or a new dated one in the working directory."""
    if chosen is None:
        name = datetime.now().strftime(f"{prefix}_%Y%m%d_%H%M%S")
        names = [name, *(f"{name}_{k}" for k in range(2, 100))]
        return next(Path(name) for name in names if not Path(name).exists())
    if chosen.exists() and not chosen.is_dir():
        raise FileError(f"{chosen} is a file: name a folder with --output")
    return chosen


def table(rows: Sequence[Sequence[str]]) -> str:
    """Return rows as a text table: the first column left-aligned, the others right-aligned."""
    width, *widths = (max(map(len, column)) for column in zip(*rows, strict=True))
    lines = (["", row[0].ljust(width), *map(str.rjust, row[1:], widths)] for row in rows)
    return "\n".join("  ".join(cells).rstrip() for cells in lines)


def bullets(title: str, items: Sequence[str]) -> str:
    """Return a list with a title, or an empty text without items."""
    return "".join([f"\n{title}\n", *(f"  - {item}\n" for item in items)]) if items else ""


HEAD = re.compile(r"(?:.*\s{2,}|\s*)(?:- )?")
"""The beginning of a line before its prose: columns separated by two spaces, and a list's dash."""


def tell(text: str, out: TextIO | None = None) -> None:
    """Print a text without control characters, wrapped to the width of a terminal."""
    out = sys.stdout if out is None else out
    shown = printable_lines(text)
    if out.isatty():
        shown = wrapped(shown, shutil.get_terminal_size().columns)
    print(shown, file=out, flush=True)


def tell_result(facts: Mapping[str, Any], words: str, *, as_json: bool) -> None:
    """Print a result as one JSON document, or in words."""
    if as_json:
        print(document(facts))
    else:
        tell(words)


def wrapped(text: str, width: int) -> str:
    """Return a text with long lines wrapped between words and indented below their last column."""
    lines = []
    for line in text.split("\n"):
        found = HEAD.match(line)
        head = found.group() if found else ""
        prose = line[len(head) :]
        if len(line) <= width or " " not in prose:
            lines.append(line)
            continue
        hanging = " " * (len(head) if 2 * len(head) <= width else 4)
        about: dict[str, Any] = {"break_on_hyphens": False, "break_long_words": False}
        lines += textwrap.wrap(
            prose, width, initial_indent=head, subsequent_indent=hanging, **about
        )
    return "\n".join(lines)


OPTIONS = {
    "strength_ut": "--reference-strength-ut",
    "inclination_deg": "--reference-inclination-deg",
    "declination_deg": "--reference-declination-deg",
    "latitude_deg": "--latitude",
    "longitude_deg": "--longitude",
    "mount_rpy_deg": "--mount-rpy-deg",
    "soft_iron_gains": "--soft-iron-gains",
}
"""The option for each parameter of the node, named without its prefix."""
PARAMETER = re.compile(rf"\b(?:reference\.)?({'|'.join(OPTIONS)})\b")
SET_MOUNTING = re.compile(r"set `mount_rpy_deg: \[([^]]*)\]`")
"""Advice for the node's parameter file, to be replaced by the option."""


def with_options(words: str) -> str:
    """Return a message with the names of the node's parameters replaced by command-line options."""

    def mounting(found: re.Match[str]) -> str:
        angles = " ".join(f"{float(angle):g}" for angle in found[1].split(","))
        return f"repeat with `--mount-rpy-deg {angles}`"

    return PARAMETER.sub(lambda found: OPTIONS[found[1]], SET_MOUNTING.sub(mounting, words))


def document(content: Mapping[str, Any]) -> str:
    """Return one JSON document; a number that is not finite becomes null."""
    finite = json.loads(json.dumps(content), parse_constant=lambda _: None)
    return json.dumps(finite, ensure_ascii=False, indent=2, allow_nan=False)


def add_reference_options(parser: argparse.ArgumentParser) -> None:
    """Add the options for the Earth's field, with the ranges and defaults of the node."""
    group = parser.add_argument_group(
        "reference field",
        "Values given here have priority; the others are from the World Magnetic Model at the "
        "given position, else at the first fix in a bag.",
    )
    specs = {spec.name: spec for spec in PARAMETERS}

    def add(option: str, name: str, words: str) -> None:
        spec = specs[f"reference.{name}"]
        within = number(spec.span.low, spec.span.high)
        about: dict[str, Any] = {"type": within, "default": spec.default, "metavar": "NUMBER"}
        group.add_argument(option, dest=name, help=words, **about)

    add("--reference-strength-ut", "strength_ut", "strength of the Earth's field, µT")
    add("--reference-strength-sigma-ut", "strength_sigma_ut", "local deviation (1 σ), µT")
    add("--reference-inclination-deg", "inclination_deg", "inclination, positive down, °")
    add("--reference-inclination-sigma-deg", "inclination_sigma_deg", "local deviation (1 σ), °")
    add("--reference-declination-deg", "declination_deg", "declination, positive east, °")
    add("--reference-declination-sigma-deg", "declination_sigma_deg", "local deviation (1 σ), °")
    add("--latitude", "latitude_deg", "latitude of the recording, positive north, °")
    add("--longitude", "longitude_deg", "longitude of the recording, positive east, °")
    add("--altitude", "altitude_m", "altitude of the recording, m")
    group.add_argument(
        "--date",
        type=_year,
        metavar="DATE",
        help="date, 2026-11-21 or 2026.9 (default: by the recording's stamps, else today)",
    )


def reference_in_use(
    options: argparse.Namespace, recorded: Place | None, stamp: float
) -> Reference:
    """Return the reference field by the options, with missing values from the model.

    `recorded` is the place by fixes in the recording, `stamp` (s) the newest in the recording.
    """
    given = GivenReference.of(vars(options))
    if given.half_place:
        raise UsageError("give --latitude and --longitude together, or neither")
    year = year_of([stamp], time.time()) if options.date is None else options.date
    return resolve(given.field, given.local, given.place or recorded, year)


def _year(text: str) -> float:
    try:
        if "-" in text[1:]:
            year = decimal_year(datetime.fromisoformat(f"{text}T12:00+00:00").timestamp())
        else:
            year = float(text)
    except ValueError:
        year = math.nan
    if 1900.0 <= year <= 2200.0:
        return year
    raise argparse.ArgumentTypeError(f"{text!r} is not a date: write 2026-11-21 or 2026.9")
