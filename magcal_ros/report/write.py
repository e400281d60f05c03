"""Writing a report: the page, and the samples beside it."""

from __future__ import annotations

from pathlib import Path

from magcal_ros.files.atomic import FileTrouble, write_atomically
from magcal_ros.files.samples import REMEDY, write_samples
from magcal_ros.report.figures.gallery import pictures
from magcal_ros.report.page import render
from magcal_ros.report.subject import Subject
from magcal_ros.report.turn import Turn

PAGE = "report.html"
SAMPLES = "samples.csv"


def write_report(folder: Path, subject: Subject) -> Path:
    """Write `report.html` and `samples.csv` into a folder.

    Safe in any thread. Without matplotlib the page has no pictures and says what to install.

    Parameters
    ----------
    folder : Path
        Where they go; made if it is missing. `new_folder` gives one that is not in use.
    subject : Subject
        The calibration, or the attempt that was refused.

    Returns
    -------
    Path
        The page.

    Raises
    ------
    FileTrouble
        If the folder already holds a report, or cannot be written to.
    """
    page = folder / PAGE
    for path in (page, folder / SAMPLES):
        if path.exists():
            raise FileTrouble(f"{path} is there already and stays; choose another folder")
    turn = Turn.of(subject)
    believed = None if subject.outcome.estimate is None else turn.believed
    # The samples come first, because the rest can be made of them; the page comes last: where
    # there is one, the report is complete.
    write_samples(folder / SAMPLES, subject.window, believed)
    write_atomically(page, render(subject, turn, pictures(turn)), REMEDY)
    return page
