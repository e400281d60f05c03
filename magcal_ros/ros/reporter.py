"""Reports on turns, drawn by a process of their own."""

from __future__ import annotations

import contextlib
import signal
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING

from magcal_ros.core.errors import MagcalError
from magcal_ros.files.places import ros_home

if TYPE_CHECKING:
    from multiprocessing.process import BaseProcess

    from magcal_ros.report import Subject

NO_REPORTS = "none"


class Reporter:
    """Writes one report after another without holding up the node.

    Drawing takes a second or two of one core and loads a plotting library: neither belongs into
    a process that passes on messages for months.
    """

    def __init__(self) -> None:
        self._process: BaseProcess | None = None

    def begin(self, parent: str, subject: Subject) -> str:
        """Start a report in a new folder and say where it will lie; empty if there is none.

        Parameters
        ----------
        parent : str
            As the parameter report_folder has it.
        subject : Subject
            What to report.
        """
        if parent == NO_REPORTS:
            return ""
        import multiprocessing

        from magcal_ros.report import new_folder

        place = Path(parent).expanduser() if parent else ros_home() / "magcal" / "reports"
        try:
            folder = new_folder(place, subject.created)
        except MagcalError as error:
            return f"No report: {error}"
        self._process = multiprocessing.get_context("spawn").Process(
            target=_write, args=(folder, subject), name="magcal-report", daemon=True
        )
        self._process.start()
        return f"Report: {folder / 'report.html'}."

    def wait(self, patience: float) -> None:
        """Give the report under way so many seconds to end."""
        if self._process is not None:
            self._process.join(patience)


def _write(folder: Path, subject: Subject) -> None:
    # Ctrl-C in the node's terminal reaches this process too; a report is quick to finish.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    from magcal_ros.report import write_report

    with contextlib.suppress(MagcalError):
        write_report(folder, subject)


def now() -> datetime:
    """Return the local time of this moment, with its zone."""
    return datetime.now().astimezone()
