"""Reports on turns, drawn by a process of their own."""

from __future__ import annotations

from collections.abc import Callable
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING

from magcal_ros.core.errors import MagcalError
from magcal_ros.files.places import chosen_path, ros_home

if TYPE_CHECKING:
    import subprocess

    from magcal_ros.report import Subject

NO_REPORTS = "none"


class Reporter:
    """Writes one report after another without holding up the node.

    Drawing takes a second or two of one core and loads a plotting library: neither belongs into
    a process that passes on messages for months. The other process has a session of its own, so
    that a report is finished although the node was ended right after the turn.

    Parameters
    ----------
    say : callable
        Told, in a thread of its own, what went wrong with a report after `begin` has returned.
    """

    def __init__(self, say: Callable[[str], object]) -> None:
        self._say = say

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
        import threading

        from magcal_ros.report import new_folder

        try:
            place = chosen_path(parent) if parent else ros_home() / "magcal" / "reports"
            folder = new_folder(place, subject.created)
            process = _draw_elsewhere(folder, subject)
        except MagcalError as error:
            return f"No report: {error}"
        except OSError as error:
            return f"No report: {error.strerror or error}."
        threading.Thread(target=self._wait_for, args=(process,), daemon=True).start()
        return f"Report: {folder / 'report.html'}."

    def _wait_for(self, process: subprocess.Popen[bytes]) -> None:
        _, words = process.communicate()
        if process.returncode:
            last = words.decode(errors="replace").strip().rpartition("\n")[2]
            self._say(f"no report: {last or f'its process ended with {process.returncode}'}")


def _draw_elsewhere(folder: Path, subject: Subject) -> subprocess.Popen[bytes]:
    import pickle
    import subprocess
    import sys
    import tempfile

    # A pipe would hold the node up until the other side has started and reads.
    with tempfile.TemporaryFile() as handover:
        pickle.dump((folder, subject), handover)
        handover.seek(0)
        return subprocess.Popen(
            [sys.executable, "-m", "magcal_ros.report"],
            stdin=handover,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            start_new_session=True,
        )


def now() -> datetime:
    """Return the local time of this moment, with its zone."""
    return datetime.now().astimezone()
