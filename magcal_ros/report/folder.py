"""A folder of its own for each calibration."""

from __future__ import annotations

from datetime import datetime
from itertools import count
from pathlib import Path

from magcal_ros.files.atomic import FileTrouble


def new_folder(parent: Path, created: datetime) -> Path:
    """Make a dated folder that was not there before.

    Parameters
    ----------
    parent : Path
        Holds the folders; made if it is missing.
    created : datetime
        Names the folder, `2024-05-31_14-03-07`; a second one of the same second ends in `-2`.

    Returns
    -------
    Path
        The new, empty folder.

    Raises
    ------
    FileTrouble
        If it cannot be made.
    """
    name = created.strftime("%Y-%m-%d_%H-%M-%S")
    try:
        parent.mkdir(parents=True, exist_ok=True)
        for number in count(1):
            folder = parent / (name if number == 1 else f"{name}-{number}")
            try:
                # Making it is the only test that two processes cannot both pass.
                folder.mkdir()
            except FileExistsError:
                continue
            return folder
    except OSError as error:
        raise FileTrouble(
            f"cannot make a folder for the report in {parent}: {error.strerror or error}. "
            "Choose a writable place, or mend its permissions."
        ) from error
    raise AssertionError("counting does not end")
