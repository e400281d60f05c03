"""Where a command leaves its files."""

from __future__ import annotations

from datetime import datetime
from pathlib import Path

from magcal_ros.files.atomic import FileTrouble


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
