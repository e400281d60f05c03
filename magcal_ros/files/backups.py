"""Backups of a calibration file's former content, beside it."""

from __future__ import annotations

import os
from pathlib import Path

from magcal_ros.core.calibration.calibration import Calibration
from magcal_ros.files.calibration_file import LARGEST_FILE, is_free_or_ours, read_calibration
from magcal_ros.files.disk import FileTrouble, read_small, write_atomically

KEPT = 3
"""Former files that are kept."""


def backup_files(path: Path) -> list[Path]:
    """Return the paths of a file's backups, the newest first; they need not exist."""
    return [path.with_name(f"{path.stem}.before_{k}{path.suffix}") for k in range(1, KEPT + 1)]


def keep_backup(path: Path, successor: Calibration) -> None:
    """Copy what a file holds to the newest of its backups; older ones move on.

    Nothing is done if the file holds no usable calibration, the successor's numbers, or what was
    kept last. A calibration that was kept earlier moves to the front and is not kept twice: two
    that alternate do not push out a third. Files of these names that do not say that they are ours
    stay where they are, and are not counted. After a FileTrouble the backups are as they were.
    """
    try:
        content = read_small(path, LARGEST_FILE)
        held, _ = read_calibration(path)
    except (OSError, ValueError, FileTrouble):
        return
    files = [file for file in backup_files(path) if is_free_or_ours(file) and not file.is_symlink()]
    if not files:
        raise FileTrouble("all names for it belong to files that are not ours")
    kept = next((k for k, file in enumerate(files) if _holds(file, held)), None)
    if kept == 0 or held.correction.is_same(successor.correction):
        return
    missing = (k for k, file in enumerate(files) if not file.exists())
    free = next(missing, len(files) - 1) if kept is None else kept
    text = content.decode("utf-8")
    write_atomically(files[0], text, when_written=lambda: _move_on(files, free))


def _holds(file: Path, calibration: Calibration) -> bool:
    """Whether a file can be loaded and has the same numbers."""
    try:
        return read_calibration(file)[0].correction.is_same(calibration.correction)
    except (OSError, ValueError, FileTrouble):
        return False


def _move_on(files: list[Path], free: int) -> None:
    """Move each file before a free name, or one that may go, to the next name."""
    for k in range(free, 0, -1):
        os.replace(files[k - 1], files[k])
