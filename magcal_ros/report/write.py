"""Writes reports into dated folders, with a page and its samples, and removes old ones."""

from __future__ import annotations

import contextlib
import re
import signal
from datetime import datetime
from itertools import chain, count
from pathlib import Path

from magcal_ros.files.disk import UNFINISHED, FileError, write_atomically
from magcal_ros.files.recording import REMEDY, write_samples
from magcal_ros.report.gallery import pictures
from magcal_ros.report.page import render
from magcal_ros.report.turn import Subject, Turn

PAGE = "report.html"
SAMPLES = "samples.csv"


def write_report(folder: Path, subject: Subject) -> Path:
    """Write `report.html` and `samples.csv` into a folder; returns the page.

    Thread-safe. Without matplotlib the page has no pictures and names the package to install.
    Raises FileError if the folder already contains a report, or cannot be written to.
    """
    page = folder / PAGE
    for path in (page, folder / SAMPLES):
        if path.exists():
            raise FileError(f"{path} exists already and is not overwritten; choose another folder")
    turn = Turn.of(subject)
    inliers = None if subject.outcome.estimate is None else turn.inliers
    # The samples are written first, because the rest can be computed from them. The page is written
    # last, so that a report with a page is complete.
    write_samples(folder / SAMPLES, subject.window, inliers)
    write_atomically(page, render(subject, turn, pictures(turn)), REMEDY)
    return page


def write_to_the_end(folder: Path, subject: Subject) -> Path:
    """Write a report in a worker process, and ignore the SIGTERM that ends the node."""
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    return write_report(folder, subject)


IN_FORCE = "in_force.txt"  # marks the report of a turn whose calibration was put in force

OURS = ".magcal_ros"
"""Marks a folder made by `new_folder`, because other folders may also have a date as a name."""

DATED = re.compile(r"(\d{4}-\d\d-\d\d_\d\d-\d\d-\d\d)(?:-(\d+))?")


def new_folder(parent: Path, created: datetime) -> Path:
    """Make a dated and marked folder; the second one in the same second ends in `-2`."""
    name = created.strftime("%Y-%m-%d_%H-%M-%S")
    try:
        parent.mkdir(parents=True, exist_ok=True)
        names = chain([name], (f"{name}-{number}" for number in count(2)))
        while True:
            folder = parent / next(names)
            try:
                # Creating the folder is an atomic test of whether the name is free.
                folder.mkdir()
            except FileExistsError:
                continue
            (folder / OURS).write_text("a report by magcal_ros: removed when it is old\n")
            return folder
    except OSError as error:
        raise FileError(
            f"cannot make a folder for the report in {parent}: {error.strerror or error}. "
            "Choose a writable folder, or correct its permissions."
        ) from error


def mark_in_force(folder: Path) -> None:
    """Mark a report as one to keep, because its calibration was put in force."""
    (folder / IN_FORCE).write_text("put in force: kept when older reports are removed\n")


def remove_old(parent: Path, keep: int) -> None:
    """Remove old reports except the newest `keep`; marked reports and other folders stay."""
    with contextlib.suppress(OSError):
        found = [
            (dated[1], int(dated[2] or 1), folder)
            for folder in parent.iterdir()
            if (dated := DATED.fullmatch(folder.name))
            and not folder.is_symlink()
            and (folder / OURS).is_file()
        ]
        mere = [folder for *_, folder in sorted(found) if not (folder / IN_FORCE).exists()]
        for folder in mere[: max(len(mere) - keep, 0)]:
            remove(folder)


def remove(folder: Path) -> None:
    """Remove the files of a report, and its folder if it contains no other files."""
    with contextlib.suppress(OSError):
        own = (folder / PAGE, folder / SAMPLES, folder / OURS)
        for path in (*folder.glob(f".*{UNFINISHED}"), *own):
            path.unlink(missing_ok=True)
        folder.rmdir()
