"""Self-calibration in the node: fits in a worker process, decisions in log and status."""

from __future__ import annotations

import os
from dataclasses import replace
from datetime import datetime, timezone
from pathlib import Path
from typing import TYPE_CHECKING, Any

from magcal_ros.core.calibration.calibration import Calibration
from magcal_ros.core.errors import in_words
from magcal_ros.core.samples.streams import FieldSample, Pairer
from magcal_ros.core.samples.window import Window
from magcal_ros.core.self_calibration.jobs import DecisionKind, DriveJob, DriveResult, Watch
from magcal_ros.core.self_calibration.self_calibration import SelfCalibration
from magcal_ros.core.session.turn_machine import TurnState
from magcal_ros.ros.magnetometer import Magnetometer
from magcal_ros.ros.reporter import NO_REPORTS, reports_of
from magcal_ros.ros.threads import BackgroundThread
from magcal_ros.ros.worker_process import WorkerProcess, WorkerStopped

if TYPE_CHECKING:
    from magcal_ros.core.calibrate import Outcome
    from magcal_ros.core.self_calibration.drive_replay import DriveReplay

NICENESS = 10  # of the worker process, so that other processes have priority
NEWER_FIT = "a calibration is proposed, but ~/accept puts the fit of the later turn in force"
IDLE_HEARTBEATS = 300  # heartbeats without a job after which the worker process is ended


class SelfCalibrationRunner:
    """Runs self-calibration for one magnetometer."""

    def __init__(self, magnetometer: Magnetometer) -> None:
        self._magnetometer, self._pipeline = magnetometer, magnetometer.pipeline
        node = self._pipeline.node
        self._say = node.get_logger().info
        self.machine = SelfCalibration(self._pipeline.settings.self_calibration)
        self._pairer = Pairer(magnetometer.inputs.streams, counts=False)
        self._jobs = BackgroundThread(node, "magcal-keep")
        self.worker = WorkerProcess()
        self._idle = 0
        self._fit_before: Outcome | None = None  # the last fit of a turn before the proposal
        self.lost = 0  # number of fits that failed
        self.problem = ""  # the failure of the last fit; empty if it succeeded

    def on_field(self, sample: FieldSample) -> None:
        """Take a field sample, and the state of the vehicle."""
        if not self._magnetometer.inputs.streams.is_repeated:
            self._pairer.offer(sample)
        for pair in self._pairer.take():
            speed = self._pipeline.travel.estimator.speed_near(pair.field.stamp)
            if self.machine.add(pair, speed):
                self._look()

    def follow(self) -> None:
        """Take the mode, once a second."""
        mode = self._pipeline.settings.self_calibration
        self._jobs.deliver()
        self._idle += 1
        if self.machine.mode is not mode:
            self.machine.mode = mode
            self.machine.forget()
        if self._idle == IDLE_HEARTBEATS:
            self.worker.stop()

    @property
    def proposal(self) -> Calibration | None:
        """The calibration that `~/accept` puts in force; None if there is none, or a newer fit.

        A turn after the proposal that is refused offers its own fit to `~/accept`.
        """
        magnetometer = self._magnetometer
        is_older = magnetometer.control.turn.last_outcome is not self._fit_before
        has_fit = isinstance(magnetometer.acceptable, Calibration)
        return None if is_older and has_fit else self.machine.proposal

    @property
    def watch(self) -> Watch | None:
        """What the drive says about the calibration in force; None without one."""
        is_calibrated = self._magnetometer.store.calibration is not None
        return self.machine.watch if is_calibrated else None

    def facts(self) -> dict[str, Any]:
        """Return the part of `~/status` on self-calibration."""
        machine, proposal = self.machine, self.proposal
        is_waiting = proposal is not machine.proposal
        return {
            "mode": machine.mode.value,
            "doing": NEWER_FIT if is_waiting else machine.in_words,
            "fits_lost": self.lost,
            "proposal": None
            if proposal is None
            else {
                "summary": proposal.evidence.summary,
                "why": " ".join(proposal.evidence.reasons),
            },
            "decisions": [
                {"decision": made.kind.value, "at_s": round(made.clock, 1), "why": made.words}
                for made in list(machine.decisions)[-5:]
            ],
        }

    def _look(self) -> None:
        if self._magnetometer.control.turn.state is not TurnState.IDLE:
            return
        self._idle = 0
        job = self.machine.job(self._pipeline.current_settings().knowledge)
        self._jobs.run(lambda: self.worker.run(run_with_low_priority, job), self._note, self._lost)

    def _lost(self, error: Exception) -> None:
        self.machine.fail()
        if not isinstance(error, WorkerStopped):
            self.lost += 1
            self.problem = f"self-calibration: the last fit has failed: {in_words(error)}"
            self._say(f"{self.problem}; the next fit follows after a drive twice as long")

    def _note(self, findings: DriveResult) -> None:
        self.problem = ""
        for decision in self.machine.note(findings):
            kind, calibration = decision.kind, decision.calibration
            self._tell(f"{kind.value.replace('_', ' ')}: {decision.words}")
            if calibration is None:
                continue
            self._leave_page(calibration)
            if kind is DecisionKind.PROPOSED:
                self._fit_before = self._magnetometer.control.turn.last_outcome
                self._tell("call ~/accept to put it in force")
                continue
            # A refined calibration needs no backup: the backup of the one before it is kept.
            is_another = kind is not DecisionKind.REFINED
            self._magnetometer.use(calibration, lambda done: self._tell(done.message), is_another)

    def _tell(self, words: str) -> None:
        self._say(f"self-calibration: {words}")

    def _leave_page(self, calibration: Calibration) -> None:
        """Start to write a page on the drive, its samples and the decisions."""
        reports = self._pipeline.settings.report_folder
        if reports == NO_REPORTS:
            return
        from magcal_ros.core.self_calibration.drive_replay import DriveReplay

        machine, moved = self.machine, self.machine.recorder.seconds
        decisions = tuple((made.clock, made) for made in machine.decisions)
        before = self._magnetometer.store.calibration
        replay = DriveReplay(decisions, before, calibration, moved, moved, machine.in_words, None)
        log = machine.recorder.log()
        self._jobs.run(
            lambda: self.worker.run(write_page, reports_of(reports), replay, log),
            lambda page: self._tell(f"report: {page}"),
            lambda error: self._tell(f"no report: {in_words(error)}"),
        )


def run_with_low_priority(job: DriveJob) -> DriveResult:
    """Do a job in the worker process at low priority; its modules are imported only there."""
    from magcal_ros.core.self_calibration.drive_replay import examine_drive

    os.setpriority(os.PRIO_PROCESS, 0, NICENESS)
    return examine_drive(job)


def write_page(parent: Path, replay: DriveReplay, log: Window) -> Path:
    """Write the page on a decision, with a map of the recorded drive; returns its path."""
    from magcal_ros.core.self_calibration.drive_replay import path_of_log
    from magcal_ros.report import new_folder
    from magcal_ros.report.drive_page import write_drive_page

    assert replay.last_calibration is not None
    folder = new_folder(parent, datetime.now(timezone.utc))
    whole = replace(replay, path=path_of_log(log, replay.last_calibration))
    return write_drive_page(folder, whole, "decided while driving")
