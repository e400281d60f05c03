"""What a calibration file held before, beside it."""

from __future__ import annotations

import os
from pathlib import Path

from magcal_ros.core.calibration.calibration import Calibration
from magcal_ros.files.atomic import FileTrouble, write_atomically
from magcal_ros.files.calibration_file import LARGEST_FILE, is_free_or_ours, read_calibration
from magcal_ros.files.reading import read_small


def former_files(path: Path, kept: int = 3) -> list[Path]:
    """Return where the calibrations before a file's lie, the newest first; they need not exist."""
    return [path.with_name(f"{path.stem}.before_{k}{path.suffix}") for k in range(1, kept + 1)]


def keep_former(path: Path, successor: Calibration) -> None:
    """Copy what a file holds to the newest of its former files; older ones move on.

    Nothing is done where the file holds no calibration that can be loaded, the successor's
    numbers, or what was kept last. Former files that do not say that they are ours stay where
    they are, and are not counted.

    Parameters
    ----------
    path : Path
        The file, which is about to be replaced.
    successor : Calibration
        What will replace it.

    Raises
    ------
    FileTrouble
        If it cannot be kept; the former files are as they were.
    """
    try:
        content = read_small(path, LARGEST_FILE)
        held, _ = read_calibration(path)
    except (OSError, ValueError, FileTrouble):
        return
    files = [file for file in former_files(path) if is_free_or_ours(file) and not file.is_symlink()]
    if not files:
        raise FileTrouble("all names for it belong to files that are not ours")
    newest = files[0]
    is_kept = newest.exists() and read_small(newest, LARGEST_FILE) == content
    if is_kept or held.correction.is_same(successor.correction):
        return
    text = content.decode("utf-8")
    write_atomically(newest, text, when_written=lambda: _move_on(files))


def _move_on(files: list[Path]) -> None:
    """Move each file to the next name, as far as it takes to free the first."""
    free = next((k for k, file in enumerate(files) if not file.exists()), len(files) - 1)
    for k in range(free, 0, -1):
        os.replace(files[k - 1], files[k])
