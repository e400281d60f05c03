"""Columns of numbers from a CSV file with a header line."""

from __future__ import annotations

import io
from collections.abc import Iterator
from pathlib import Path
from typing import TextIO

import numpy as np

from magcal_ros.core.geometry.arrays import FloatArray
from magcal_ros.files.atomic import FileTrouble
from magcal_ros.files.plain import plain
from magcal_ros.files.reading import open_regular

LONGEST_LINE = 10_000
"""Characters."""

LATEST_STAMP = 2.0**33
"""Seconds, whichever sign: the stamps of ROS end at a quarter of that."""


def read_columns(path: Path, *choices: tuple[str, ...]) -> tuple[tuple[str, ...], FloatArray]:
    """Return the first choice of columns that a file has, and its rows, one column each.

    Parameters
    ----------
    path : Path
        Has a header line; columns may come in any order, and others beside them.
    choices : tuple of str
        Names of columns; the first is stamps in seconds.

    Raises
    ------
    FileTrouble
        If a column is missing, or a line is not numbers.
    """
    try:
        with io.TextIOWrapper(open_regular(path), encoding="utf-8") as handle:
            lines = _lines(handle)
            header = [name.strip() for name in next(lines, "").split(",")]
            columns = next((each for each in choices if set(each) <= set(header)), None)
            if columns is None:
                missing = [name for name in choices[-1] if name not in header]
                lines_like = " or ".join(",".join(each) for each in choices)
                raise FileTrouble(
                    f"{path} has no column {', '.join(missing)}; its first line should be "
                    f"{lines_like}"
                )
            order = [header.index(name) for name in columns]
            table = np.loadtxt(lines, delimiter=",", usecols=order, ndmin=2)
    except OSError as error:
        raise FileTrouble(f"cannot read {path}: {error.strerror or error}") from error
    except ValueError as error:
        raise FileTrouble(f"{plain(str(path))} is damaged: {error}") from error
    except IndexError as error:  # numpy before 1.23
        raise FileTrouble(f"{plain(str(path))} is damaged: a line has too few columns") from error
    stamps = table[:, 0]
    if (np.abs(stamps[np.isfinite(stamps)]) > LATEST_STAMP).any():
        raise FileTrouble(
            f"{plain(str(path))} is damaged: {columns[0]} must be seconds, and it reaches "
            f"{np.nanmax(np.abs(stamps)):.3g}"
        )
    if not len(table):
        raise FileTrouble(f"{path} holds no samples")
    return columns, np.asarray(table, dtype=np.float64)


def _lines(handle: TextIO) -> Iterator[str]:
    """Yield the lines; one that does not end would fill the memory."""
    while line := handle.readline(LONGEST_LINE):
        if len(line) == LONGEST_LINE:
            raise ValueError(f"a line has {LONGEST_LINE} characters or more")
        yield line
