"""The samples of one turn as CSV, so that anyone can repeat the fit."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np

from magcal_ros.core.geometry.arrays import BoolArray
from magcal_ros.core.samples.window import Window
from magcal_ros.files.atomic import FileTrouble, write_atomically
from magcal_ros.files.reading import open_regular

COLUMNS = {
    "t": "s",
    "mx": "T",
    "my": "T",
    "mz": "T",
    "ax": "m/s^2",
    "ay": "m/s^2",
    "az": "m/s^2",
    "gx": "rad/s",
    "gy": "rad/s",
    "gz": "rad/s",
    "believed": "1/0",
}
"""Name and unit of each column; a header cell reads `mx [T]`."""

REMEDY = "Choose a writable folder, or correct its permissions."

NEEDED = ("t", "mx", "my", "mz", "ax", "ay", "az")
GYRO = ("gx", "gy", "gz")


def write_samples(path: Path, window: Window, believed: BoolArray | None = None) -> None:
    """Write a window, every number in full precision.

    Parameters
    ----------
    path : Path
        The file.
    window : Window
        The samples; without a gyro its columns hold `nan`.
    believed : ndarray of bool, shape (n,), optional
        Which samples the fit believed; without it none, because there was no fit.

    Raises
    ------
    FileTrouble
        If the file cannot be written.
    """
    n = len(window)
    rate = np.full((n, 3), np.nan) if window.angular_rate is None else window.angular_rate
    marks = [0] * n if believed is None else [int(mark) for mark in believed]
    numbers = np.column_stack([window.time, window.field, window.specific_force, rate]).tolist()
    lines = [",".join(f"{name} [{unit}]" for name, unit in COLUMNS.items())]
    lines += [
        ",".join([*map(repr, row), str(mark)]) for row, mark in zip(numbers, marks, strict=True)
    ]
    write_atomically(path, "\n".join(lines) + "\n", REMEDY)


def read_samples(path: Path) -> Window:
    """Read the window of a turn back, believed or not.

    Parameters
    ----------
    path : Path
        Has a header line with at least t, mx, my, mz, ax, ay and az, their order and the units
        in brackets at will; SI units.

    Returns
    -------
    Window
        The same numbers that were written, to the last bit.

    Raises
    ------
    FileTrouble
        If the file or a column is missing, or a line is not numbers.
    """
    try:
        with io.TextIOWrapper(open_regular(path), encoding="utf-8") as handle:
            names = [cell.split("[")[0].strip() for cell in handle.readline().split(",")]
            missing = [name for name in NEEDED if name not in names]
            if missing:
                raise FileTrouble(
                    f"{path} has no column {', '.join(missing)}; "
                    f"its first line should be {','.join(COLUMNS)}"
                )
            wanted = NEEDED + (GYRO if set(GYRO) <= set(names) else ())
            order = [names.index(name) for name in wanted]
            lines = handle.readlines()
        table = np.empty((0, len(order)))
        if lines:
            table = np.loadtxt(lines, delimiter=",", usecols=order, ndmin=2, comments=None)
        rate = table[:, 7:] if table.shape[1] > 7 and not np.isnan(table[:, 7:]).all() else None
        return Window(table[:, 0], table[:, 1:4], table[:, 4:7], rate)
    except OSError as error:
        raise FileTrouble(f"cannot read {path}: {error.strerror or error}") from error
    except ValueError as error:
        raise FileTrouble(f"{path} is damaged: {error}") from error
