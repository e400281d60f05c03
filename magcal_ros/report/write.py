"""Writing a report, the page and its samples, into a folder of its own."""

from __future__ import annotations

import contextlib
import re
import signal
from datetime import datetime
from itertools import count
from pathlib import Path

from magcal_ros.files.disk import UNFINISHED, FileTrouble, write_atomically
from magcal_ros.files.recording import REMEDY, write_samples
from magcal_ros.report.gallery import pictures
from magcal_ros.report.page import render
from magcal_ros.report.turn import Subject, Turn

PAGE = "report.html"
SAMPLES = "samples.csv"


def write_report(folder: Path, subject: Subject) -> Path:
    """Write `report.html` and `samples.csv` into a folder; returns the page.

    Safe in any thread. Without matplotlib the page has no pictures and says what to install. A
    FileTrouble if the folder already holds a report, or cannot be written to.
    """
    page = folder / PAGE
    for path in (page, folder / SAMPLES):
        if path.exists():
            raise FileTrouble(f"{path} is there already and stays; choose another folder")
    turn = Turn.of(subject)
    inliers = None if subject.outcome.estimate is None else turn.inliers
    # The samples come first, because the rest can be made of them; the page comes last: where
    # there is one, the report is complete.
    write_samples(folder / SAMPLES, subject.window, inliers)
    write_atomically(page, render(subject, turn, pictures(turn)), REMEDY)
    return page


def write_to_the_end(folder: Path, subject: Subject) -> Path:
    """Write a report in a process of its own, which signals that end the node do not end."""
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    return write_report(folder, subject)


IN_FORCE = "in_force.txt"  # marks the report of a turn whose calibration was put in force

OURS = ".magcal_ros"
"""Marks a folder that `new_folder` made: others may have a date for a name as well."""

DATED = re.compile(r"(\d{4}-\d\d-\d\d_\d\d-\d\d-\d\d)(?:-(\d+))?")


def new_folder(parent: Path, created: datetime) -> Path:
    """Make a dated folder, marked as ours; a second one of the same second ends in `-2`."""
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
            (folder / OURS).write_text("a report by magcal_ros: removed when it is old\n")
            return folder
    except OSError as error:
        raise FileTrouble(
            f"cannot make a folder for the report in {parent}: {error.strerror or error}. "
            "Choose a writable place, or correct its permissions."
        ) from error
    raise AssertionError("counting does not end")


def mark_in_force(folder: Path) -> None:
    """Keep a report for good: its calibration is, or was, in force."""
    (folder / IN_FORCE).write_text("put in force: kept when older reports are removed\n")


def remove_old(parent: Path, keep: int) -> None:
    """Remove the oldest reports; those that were put in force stay, and whatever is not ours."""
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
    """Remove a report's own files, and its folder unless somebody put more into it."""
    with contextlib.suppress(OSError):
        own = (folder / PAGE, folder / SAMPLES, folder / OURS)
        for path in (*folder.glob(f".*{UNFINISHED}"), *own):
            path.unlink(missing_ok=True)
        folder.rmdir()
