"""Compares `results.json` with a fresh run: `python benchmarks/results.py [TABLE ...] [--write]`.

`results.json` holds every table of doc/measured: the commands that print it, the commit and the
seeds that it was measured with (null if unknown), columns and rows. `make docs`
writes the pages from it. A table with an entry `printed` can be compared: the entry says how each
row's name begins in what the commands print, and which of the words after it a cell is made of.
Columns of `times` differ from run to run and are shown, not judged. Without a table the names of
those that can be compared are listed. With `--write` the fresh figures are stored, with the commit.
"""

from __future__ import annotations

import argparse
import functools
import json
import shlex
import subprocess
import sys
from pathlib import Path
from typing import Any

HERE = Path(__file__).resolve().parent
RESULTS = HERE / "results.json"
MOST_WORDS = 20

Table = dict[str, Any]


def read_tables(path: Path = RESULTS) -> list[Table]:
    """Return all tables in the order of the file."""
    tables: list[Table] = json.loads(path.read_text(encoding="utf-8"))
    return tables


def write_tables(tables: list[Table], path: Path = RESULTS) -> None:
    """Write all tables, one row a line."""
    texts = []
    for table in tables:
        parts = [f"  {_text(key)}: {_text(value)}" for key, value in table.items() if key != "rows"]
        rows = ",\n".join(f"   {_text(row)}" for row in table["rows"])
        texts.append(" {\n" + ",\n".join([*parts, f'  "rows": [\n{rows}\n  ]']) + "\n }")
    path.write_text("[\n" + ",\n".join(texts) + "\n]\n", encoding="utf-8")


def fresh_rows(table: Table, printed: str) -> list[list[str]]:
    """Return the rows as a run prints them; a row that was not printed has no cells.

    Words beyond the end of a line are empty.
    """
    known = table["printed"]
    lines = [line.split() for line in printed.splitlines()]
    rows = []
    for name in known["names"]:
        words = name.split()
        found = [line[len(words) :] for line in lines if line[: len(words)] == words]
        line = [*found[0], *[""] * MOST_WORDS] if found else []
        cells = [cell.format(*line) for cell in known["cells"]] if found else []
        rows.append([cell.strip().rstrip("°") for cell in cells])
    return rows


def differences(table: Table, fresh: list[list[str]]) -> list[str]:
    """Return in words which cells differ from what was measured before."""
    found = []
    columns = table["columns"][1:]
    for name, row, cells in zip(table["printed"]["names"], table["rows"], fresh, strict=True):
        if not cells:
            found.append(f"{name}: not printed")
        # What is not printed alone (an empty pattern, columns beyond the patterns) stays.
        for column, old, new in zip(columns, row[1:], cells, strict=False):
            if new and _number(new) != _number(old) and column not in table["printed"]["times"]:
                found.append(f"{name}: {column} was {old}, is {new}")
    return found


def run(commands: list[str]) -> str:
    """Return what the commands print, one after another."""
    return "".join(map(_printed, commands))


@functools.cache
def _printed(command: str) -> str:
    script, *arguments = shlex.split(command)
    called = [sys.executable, str(HERE / script), *arguments]
    return subprocess.run(called, check=True, stdout=subprocess.PIPE, text=True).stdout


def with_fresh(table: Table, fresh: list[list[str]], commit: str | None) -> Table:
    """Return a table with the cells of a run."""
    rows = []
    for row, cells in zip(table["rows"], fresh, strict=True):
        measured = [new or old for old, new in zip(row[1:], cells, strict=False)]
        rows.append([row[0], *measured, *row[1 + len(cells) :]])
    return {**table, "commit": commit, "rows": rows}


def commit_of_checkout() -> str | None:
    """Return the commit that is checked out; None where files differ from it."""
    state = _git("status", "--porcelain", "--untracked-files=no")
    return None if state else _git("rev-parse", "--short", "HEAD")


def _git(*arguments: str) -> str:
    done = subprocess.run(["git", *arguments], cwd=HERE, check=True, capture_output=True, text=True)
    return done.stdout.strip()


def _text(value: object) -> str:
    return json.dumps(value, ensure_ascii=False)


def _number(cell: str) -> str:
    """Return a cell with numbers written in one way: pages say .5 and 0.5."""
    return " ".join(f"0{word}" if word.startswith(".") else word for word in cell.split())


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("tables", nargs="*")
    parser.add_argument("--write", action="store_true", help="store the fresh figures")
    arguments = parser.parse_args()
    tables = read_tables()
    comparable = {table["table"]: table for table in tables if "printed" in table}
    if unknown := set(arguments.tables) - set(comparable):
        parser.error(f"no such table, or none that can be compared: {', '.join(sorted(unknown))}")
    if not arguments.tables:
        print(*comparable, sep="\n")
        return 0
    differs, commit = 0, commit_of_checkout()
    for name in arguments.tables:
        fresh = fresh_rows(comparable[name], run(comparable[name]["commands"]))
        found = differences(comparable[name], fresh)
        print(f"{name}: {len(found)} cells differ", *found, sep="\n  ", flush=True)
        differs += len(found)
        comparable[name].update(with_fresh(comparable[name], fresh, commit))
    if arguments.write:
        write_tables(tables)
    return 1 if differs and not arguments.write else 0


if __name__ == "__main__":
    sys.exit(main())
