"""Reports on turns, drawn by a process of their own."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, TypeAlias

from magcal_ros.core.calibrate import Outcome
from magcal_ros.core.errors import MagcalError
from magcal_ros.core.samples.window import Window
from magcal_ros.files.default_paths import chosen_path, known_as, own_folder
from magcal_ros.processes import start
from magcal_ros.ros.heading_pipeline import Sensor
from magcal_ros.ros.parameters import Settings

if TYPE_CHECKING:
    import subprocess

    from magcal_ros.report import Subject

    Draw: TypeAlias = Callable[[Path, Subject], subprocess.Popen[bytes]]

NO_REPORTS = "none"

LONGEST = 60.0
"""Seconds that a report may take. It takes a second or two; longer, the next ones would wait."""

ENDING = 1.0
"""Seconds in which a process that was killed is gone."""


class Reporter:
    """Writes one report after another without delaying the node.

    Drawing takes a second or two of one core and loads a plotting library: neither belongs into a
    process that passes on messages for months. The other process has a session of its own, so that
    a report is finished although the node was ended right after the turn. There is one such process
    at a time; of the reports that come meanwhile, the newest waits for its end.
    """

    def __init__(self, say: Callable[[str], object], draw: Draw | None = None) -> None:
        self._say = say
        self._draw = draw or _draw_elsewhere
        self._lock = threading.Lock()
        self._drawing = False
        self._waiting: tuple[Path, Subject] | None = None
        self._newest: Path | None = None

    def begin(self, parent: str, subject: Subject, keep: int) -> str:
        """Start a report in a new folder and say where it will lie; empty if there is none."""
        self._newest = None
        if parent == NO_REPORTS:
            return ""
        from magcal_ros.report import new_folder, remove_old

        try:
            place = reports_of(parent)
            folder = self._newest = new_folder(place, subject.created)
            if subject.outcome.verdict.accepted:
                self.put_in_force()
            remove_old(place, keep)
            self._draw_in_turn(folder, subject)
        except MagcalError as error:
            return f"No report: {error}"
        except OSError as error:
            return f"No report: {error.strerror or error}."
        return f"Report: {folder / 'report.html'}."

    def report(
        self,
        window: Window,
        settings: Settings,
        outcome: Outcome,
        field: Sensor,
        imu: Sensor,
        vehicle: str,
    ) -> str:
        """Begin the report on a turn; returns where it will lie, in words."""
        # A node that never calibrates should not load what draws reports.
        from magcal_ros.report import Subject

        subject = Subject(
            window,
            settings.knowledge,
            outcome,
            source=f"{field.topic} and {imu.topic}",
            method=settings.method,
            magnetometer_frame=known_as(field.frame),
            imu_frame=known_as(imu.frame),
            vehicle=vehicle,
        )
        return self.begin(settings.report_folder, subject, settings.reports_kept)

    def put_in_force(self) -> None:
        """Keep the newest turn's report: its calibration was put in force."""
        from magcal_ros.report import mark_in_force

        if self._newest is not None:
            with contextlib.suppress(OSError):
                mark_in_force(self._newest)

    def _draw_in_turn(self, folder: Path, subject: Subject) -> None:
        with self._lock:
            if self._drawing:
                passed_over, self._waiting = self._waiting, (folder, subject)
            else:
                process = self._draw(folder, subject)
                thread = threading.Thread(target=self._draw_on, args=(process,), daemon=True)
                # Without room for a thread this report is drawn all the same, and none is queued.
                with contextlib.suppress(RuntimeError):
                    thread.start()
                    self._drawing = True
                return
        if passed_over is not None:
            from magcal_ros.report import remove

            remove(passed_over[0])
            self._say(f"no report in {passed_over[0]}: newer turns came before it was drawn")

    def _draw_on(self, process: subprocess.Popen[bytes] | None) -> None:
        """Wait for a report, and draw those that came meanwhile."""
        while process is not None:
            fault = _fault_of(process)
            if fault:
                self._say(f"no report: {fault}")
            process = self._next()

    def _next(self) -> subprocess.Popen[bytes] | None:
        while True:
            with self._lock:
                waiting, self._waiting = self._waiting, None
                if waiting is None:
                    self._drawing = False
                    return None
            try:
                return self._draw(*waiting)
            except OSError as error:
                self._say(f"no report in {waiting[0]}: {error.strerror or error}")


def reports_of(parent: str) -> Path:
    """Return where reports go, by the parameter report_folder."""
    return chosen_path(parent) if parent else own_folder() / "reports"


def _fault_of(process: subprocess.Popen[bytes]) -> str:
    """Wait for a report to be drawn; returns what went wrong, empty if nothing did."""
    import subprocess

    try:
        _, words = process.communicate(timeout=LONGEST)
    except subprocess.TimeoutExpired:
        process.kill()
        # A disk that does not answer holds even a killed process.
        with contextlib.suppress(subprocess.TimeoutExpired):
            process.communicate(timeout=ENDING)
        return (
            f"its process was not done after {LONGEST:g} s, and the node has ended it; "
            "see whether the disk of report_folder answers, and what keeps the machine busy"
        )
    if not process.returncode:
        return ""
    last = words.decode(errors="replace").strip().rpartition("\n")[2]
    return last or f"its process ended with {process.returncode}"


def _draw_elsewhere(folder: Path, subject: Subject) -> subprocess.Popen[bytes]:
    import pickle
    import subprocess
    import tempfile

    # A pipe would hold the node up until the other side has started and reads.
    with tempfile.TemporaryFile() as handover:
        pickle.dump((folder, subject), handover)
        handover.seek(0)
        return start(
            "magcal_ros.report.write",
            stdin=handover,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            start_new_session=True,
        )
