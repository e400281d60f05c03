"""What was in force before, beside the file of what is."""

from __future__ import annotations

import os
from pathlib import Path

from magcal_ros.core.calibration.calibration import Calibration
from magcal_ros.files.calibration_file import Origin, write_calibration


def former_files(path: Path, kept: int = 3) -> list[Path]:
    """Return where the calibrations before a file's lie, the newest first; they need not exist."""
    return [path.with_name(f"{path.stem}.before_{k}{path.suffix}") for k in range(1, kept + 1)]


def keep_former(path: Path, calibration: Calibration, origin: Origin, kept: int = 3) -> None:
    """Write what was in force before beside its successor's file; older ones move on.

    Raises
    ------
    FileTrouble
        If it cannot be written.
    OSError
        If the older ones cannot be moved.
    """
    files = former_files(path, kept)
    for newer, older in zip(files[-2::-1], files[:0:-1], strict=True):
        if newer.exists():
            os.replace(newer, older)
    write_calibration(files[0], calibration, origin)
