"""Reports on turns, written by a worker process."""

from __future__ import annotations

import contextlib
import threading
from pathlib import Path
from typing import TYPE_CHECKING

from rclpy.node import Node

from magcal_ros.core.calibrate import Outcome
from magcal_ros.core.errors import MagcalError, in_words
from magcal_ros.core.samples.window import Window
from magcal_ros.files.default_paths import chosen_path, identifier, own_folder
from magcal_ros.ros.heading_pipeline import Inputs
from magcal_ros.ros.parameters import Settings
from magcal_ros.ros.threads import BackgroundThread
from magcal_ros.ros.vehicle import Travel
from magcal_ros.ros.worker_process import WorkerProcess, WorkerStopped

if TYPE_CHECKING:
    from magcal_ros.report import Subject

NO_REPORTS = "none"

LONGEST = 60.0
"""Longest time for a report, seconds; usually it takes one or two."""


class Reporter:
    """Writes one report after another without delaying the node.

    A report takes a second or two of one core and imports a plotting library, so it is written by a
    worker process, which ends afterwards. A report is finished even if the node ends. Of waiting
    reports only the newest is written.
    """

    def __init__(self, node: Node, inputs: Inputs, travel: Travel) -> None:
        self._thread, self._say = BackgroundThread(node, "magcal-report"), node.get_logger().error
        self._inputs, self._travel = inputs, travel
        self._worker = WorkerProcess()
        self._newest: Path | None = None

    def report(self, window: Window, settings: Settings, outcome: Outcome) -> str:
        """Start the report on a turn in a new folder; returns its location in words, or nothing.

        The modules for reports are imported here, so that starting the node does not import them.
        """
        self._newest = None
        if settings.report_folder == NO_REPORTS:
            return ""
        from magcal_ros.report import Subject, new_folder, remove_old

        imu, field, yaw = self._inputs.imu, self._inputs.field, self._travel.yaw
        subject = Subject(
            window,
            settings.knowledge,
            outcome,
            source=f"{field.topic} and {imu.topic}",
            method=settings.method,
            magnetometer_frame=identifier(field.frame),
            imu_frame=identifier(imu.frame),
            vehicle=yaw.words if yaw else "",
        )
        try:
            place = reports_of(settings.report_folder)
            folder = self._newest = new_folder(place, subject.created)
            if outcome.verdict.accepted:
                self.put_in_force()
            remove_old(place, settings.reports_kept)
        except MagcalError as error:
            return f"No report: {error}"
        except OSError as error:
            return f"No report: {error.strerror or error}."
        self._thread.run(
            lambda: self._draw(folder, subject),
            lambda _: None,
            lambda error: self._say(f"no report in {folder}: {in_words(error)}"),
        )
        return f"Report: {folder / 'report.html'}."

    def put_in_force(self) -> None:
        """Mark the newest report as one to keep, because its calibration was put in force."""
        from magcal_ros.report import mark_in_force

        if self._newest is not None:
            with contextlib.suppress(OSError):
                mark_in_force(self._newest)

    def _draw(self, folder: Path, subject: Subject) -> None:
        from magcal_ros.report import remove
        from magcal_ros.report.write import write_to_the_end

        if folder != self._newest:
            remove(folder)
            raise MagcalError("there were newer turns before the report was written")
        watchdog = threading.Timer(LONGEST, self._worker.stop)
        watchdog.daemon = True
        watchdog.start()
        try:
            self._worker.run_once(write_to_the_end, folder, subject)
        except WorkerStopped:
            raise MagcalError(
                f"its process took more than {LONGEST:g} s and was ended: check that the disk of "
                "report_folder works, and end other programs that keep the machine busy"
            ) from None
        finally:
            watchdog.cancel()


def reports_of(parent: str) -> Path:
    """Return the folder of all reports for a value of the parameter report_folder."""
    return chosen_path(parent) if parent else own_folder() / "reports"
