"""The state machine of a turn: it takes events and time, and returns commands.

Its owner (a node, or a test in virtual time) reports events and carries out the commands. Fits,
files and messages are the owner's part.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from enum import Enum
from typing import ClassVar, TypeAlias

from magcal_ros.core.calibrate import JOINS, Outcome
from magcal_ros.core.calibration.calibration import Calibration, FittedGyroBias
from magcal_ros.core.errors import Reason, Refusal
from magcal_ros.core.multi_turn.result import KeptTurns
from magcal_ros.core.samples.battery import Messages
from magcal_ros.core.samples.streams import Pair
from magcal_ros.core.samples.window import Window
from magcal_ros.core.session.rotation import planned_duration
from magcal_ros.core.session.self_turn import ControlStep, SelfTurn, TurnConditions
from magcal_ros.core.session.session import Progress, Session, Stage, TurnRequest
from magcal_ros.core.session.session_tuning import SESSION


@dataclass(frozen=True)
class Conclusion:
    """The result of a turn or of a request.

    As a command: answer all callers that wait for the turn, and release its computing resources.
    """

    success: bool
    message: str


@dataclass(frozen=True, eq=False)
class Preview:
    """Predict the heading sigma of a fit; answered by `note_preview`."""

    window: Window
    request: TurnRequest
    turned: float  # radians that the window covers


@dataclass(frozen=True, eq=False)
class FitTurn:
    """Fit a turn together with the kept ones; answered by `note_fit` or `note_failed_fit`."""

    kept: KeptTurns
    window: Window
    request: TurnRequest


@dataclass(frozen=True, eq=False)
class PutInForce:
    """Use a calibration from now on and store it; answered by `note_saved`."""

    calibration: Calibration
    gyro: FittedGyroBias | None = None  # the gyro's error by the same fit


@dataclass(frozen=True)
class MoveBase:
    """Command the base to turn at a rate, rad/s, left positive."""

    rate: float


class TurnState(str, Enum):
    """The state of a turn."""

    IDLE = "idle"
    COLLECTING = "collecting"
    FITTING = "fitting"
    SAVING = "saving"


@dataclass(frozen=True, eq=False)
class Collecting:
    """Samples are collected; a preview of the fit is running or will be."""

    request: TurnRequest
    session: Session
    state: ClassVar = TurnState.COLLECTING
    asked: Preview | None = None  # the preview that is running
    asked_at: float = 0.0
    next_preview: float = 0.0


@dataclass(frozen=True, eq=False)
class Fitting:
    """A window is being fitted."""

    why_ended: str
    asked: FitTurn
    state: ClassVar = TurnState.FITTING


@dataclass(frozen=True)
class Saving:
    """The new calibration is in force and is being written to disk."""

    words: str
    report: str
    state: ClassVar = TurnState.SAVING


Command: TypeAlias = Conclusion | Preview | FitTurn | PutInForce | MoveBase
"""An action for the owner of the state machine."""


class TurnMachine:
    """One turn at a time, from the request to the calibration in force.

    `report` starts to write the report on a turn, and returns its location in words.
    `is_calibrated` returns whether a calibration is in force.
    """

    def __init__(
        self,
        robot: SelfTurn | None = None,
        report: Callable[[Window, Outcome], str] = lambda _, __: "",
        is_calibrated: Callable[[], bool] = lambda: False,
    ) -> None:
        self.robot, self._report = SelfTurn() if robot is None else robot, report
        self._is_calibrated = is_calibrated
        self.progress: Progress | None = None  # of the newest turn, as the following attributes
        self.last_window: Window | None = None
        self.last_outcome: Outcome | None = None
        self.last_conclusion: Conclusion | None = None
        self._stage: Collecting | Fitting | Saving | None = None
        self._kept = KeptTurns()
        # The frames of magnetometer and IMU, which some drivers leave empty.
        self._sensors = self._sensors_of_kept = self._sensors_of_outcome = "", ""
        self._commands: list[Command] = []

    @property
    def state(self) -> TurnState:
        """The state of the turn."""
        return TurnState.IDLE if self._stage is None else self._stage.state

    @property
    def outcome_is_of_others(self) -> bool:
        """Whether the last outcome is of sensors other than the present ones."""
        return bool(_changes(self._sensors_of_outcome, self._sensors))

    @property
    def turns_kept(self) -> int:
        """Number of turns that the next turn would be joined with."""
        return len(self._kept.windows)

    def commands(self) -> list[Command]:
        """Return the new commands, to be carried out in this order."""
        commands, self._commands = self._commands, []
        return commands

    def forget(self) -> None:
        """Discard the turns kept so far."""
        self._kept = KeptTurns()

    def open(self, request: TurnRequest, now: float) -> Conclusion:
        """Begin a turn at `now`, seconds on a steady clock; returns whether the turn has begun."""
        refusal = self._why_not(request)
        if refusal:
            return Conclusion(False, refusal)
        if not request.accumulate:
            self.forget()
        self.last_window = None
        session = Session(request.limits, request.knowledge.mounting, now, request.gyro)
        self._stage = Collecting(request, session)
        self.progress = session.progress(now)
        words = "turn the robot once, a full circle, 0.5 rad/s or less"
        if request.speed is not None:
            self._steer(self.robot.stop())
            self.robot.open(request, now)
            words = "the robot turns itself, once each way; keep clear"
        return Conclusion(True, f"collecting: {words}")

    def _why_not(self, request: TurnRequest) -> str:
        """Return why a turn cannot begin; empty if it can."""
        longest = request.limits.timeout
        if request.speed is not None and planned_duration(request.speed) > longest:
            return (
                f"a turn each way at rotate.speed_rad_s {request.speed:g} takes"
                f" {planned_duration(request.speed):.0f} s,"
                f" longer than window.timeout_s ({longest:g} s): raise one of them"
            )
        if self._stage is not None:
            return f"already {self.state.value}: wait for the end, or call ~/cancel first"
        if request.accumulate and request.method != JOINS:
            return (
                f"the method {request.method} does not join turns: set method to {JOINS}, or "
                "accumulate to false"
            )
        return ""

    def take(
        self, pair: Pair, now: float, speed: float = math.nan, currents: Messages = ()
    ) -> None:
        """Take a pair, the speed of the wheels (m/s or NaN), and new currents of the battery."""
        if isinstance(self._stage, Collecting):
            self._stage.session.note_currents(*currents)
            self._stage.session.add(pair, now, speed)
            self.robot.take(pair, now)

    def tick(self, silence: str, now: float) -> None:
        """Check the progress at `now`; `silence` is the explanation if no samples arrive."""
        stage = self._stage
        if not isinstance(stage, Collecting):
            return
        progress = self.progress = stage.session.progress(now)
        is_held = progress.stage is Stage.COMPLETE and self.robot.is_under_way
        if progress.stage is Stage.COLLECTING or is_held:
            self._look_ahead(stage, progress, now)
        elif progress.stage is Stage.SILENT and not stage.session.has_samples:
            self._leave_collecting()
            self._judge(Outcome.refused(Refusal(Reason.TOO_FEW_SAMPLES, silence)), "")
        else:
            why = {
                Stage.COMPLETE: "",
                Stage.TIMED_OUT: f"{ENDED_BY_TIME} {progress.elapsed:.0f} s",
                Stage.SILENT: silence,
            }[progress.stage]
            self._begin_fit(stage, why, now)

    def _look_ahead(self, stage: Collecting, progress: Progress, now: float) -> None:
        """Request a preview at intervals, and once the circle is complete."""
        waits = progress.coverage.is_complete and not stage.session.covers_whole_turn
        is_due = now > stage.next_preview or waits
        if stage.asked is None and is_due and progress.coverage.arc > SESSION.preview_arc:
            window = self.last_window = stage.session.window()
            asked = Preview(window, stage.request, progress.coverage.turned)
            self._stage = replace(stage, asked=asked, asked_at=now)
            self._commands.append(asked)

    def note_preview(self, asked: Preview, sigma: float, now: float) -> None:
        """Take the heading sigma (radians) that the fit for a preview predicts."""
        stage = self._stage
        if isinstance(stage, Collecting) and stage.asked is asked:
            stage.session.note_sigma(sigma, asked.turned)
            pause = (now - stage.asked_at) * (1.0 / SESSION.preview_share - 1.0)
            self._stage = replace(stage, asked=None, next_preview=now + pause)

    def look(self, conditions: TurnConditions, now: float) -> None:
        """Make a control step of a robot that turns itself."""
        assert self.progress is not None
        self._follow(self.robot.look(now, self.progress, conditions), now)

    def _follow(self, step: ControlStep, now: float) -> None:
        # The robot is stopped first, because the rest may take a moment.
        self._steer(step)
        if not isinstance(self._stage, Collecting):
            return
        if step.aborted:
            self.abort(f"{step.aborted}; {self._unchanged}")
        elif step.ended:
            self._begin_fit(self._stage, step.ended, now)

    def stop_robot(self, reason: str, now: float) -> None:
        """Stop a robot that turns itself, because its supervision may have failed."""
        if self.robot.is_under_way:
            self._follow(self.robot.abort(reason), now)

    def _steer(self, step: ControlStep) -> None:
        if step.rate is not None:
            self._commands.append(MoveBase(step.rate))

    def _leave_collecting(self) -> None:
        self._steer(self.robot.stop())
        self._stage = None

    def finish(self, now: float) -> Conclusion | None:
        """Fit the samples so far; None if a fit is running or will be."""
        if isinstance(self._stage, Collecting):
            self._begin_fit(self._stage, "finished by the user", now)
        elif self._stage is None:
            return Conclusion(False, "no turn is being collected: call ~/start first")
        return None

    def _begin_fit(self, stage: Collecting, why: str, now: float) -> None:
        session = stage.session
        self.progress = session.progress(now)
        why = "; ".join(filter(None, (why, session.restarted)))
        self._leave_collecting()
        try:
            window = self.last_window = session.window()
            self.progress.require_arc(session.limits.smallest_arc)
        except Refusal as refusal:
            self._judge(Outcome.refused(refusal), why)
            return
        if self._sensors != self._sensors_of_kept:
            self._sensors_of_kept = self._sensors
            self.forget()
        asked = FitTurn(self._kept, window, stage.request)
        self._stage = Fitting(why, asked)
        self._commands.append(asked)

    def note_fit(self, asked: FitTurn, outcome: Outcome, kept: KeptTurns) -> None:
        """Take the fit of a turn, and the turns to keep for the next one."""
        stage = self._stage
        if not isinstance(stage, Fitting) or stage.asked is not asked:
            return
        # If the kept turns were discarded during this fit, they stay discarded.
        if self._kept is asked.kept:
            self._kept = kept
        self.last_window = outcome.window or self.last_window
        self._judge(outcome, stage.why_ended)

    def note_failed_fit(self, asked: FitTurn, words: str) -> None:
        """Note that a fit ended with an error of the program."""
        if isinstance(self._stage, Fitting) and self._stage.asked is asked:
            self._conclude(False, f"the fit failed unexpectedly: {words}")

    @property
    def _unchanged(self) -> str:
        """What a turn without a result leaves in force."""
        is_any = self._is_calibrated()
        return "the calibration in force is unchanged" if is_any else "no calibration is in force"

    def _judge(self, outcome: Outcome, why: str) -> None:
        """Put the calibration in force if it is accepted; otherwise name the remedy."""
        self.last_outcome, self._sensors_of_outcome = outcome, self._sensors
        words = outcome.verdict.summary
        if outcome.multi_turn is not None and outcome.calibration is not None:
            words = f"{words} {outcome.multi_turn.in_words}"
        if outcome.verdict.accepted and why.startswith(ENDED_BY_TIME):
            # A time limit comes after a success, because it is no fault.
            words = f"{words} ({why[0].upper()}{why[1:]}.)"
        elif why:
            words = f"{why}; {words}"
        report = "" if self.last_window is None else self._report(self.last_window, outcome)
        ending = f" {report}" if report else ""
        unchanged = self._unchanged.capitalize()
        if outcome.calibration is None:
            self._conclude(False, f"{words} {unchanged}.{ending}")
        elif outcome.verdict.accepted:
            self._stage = Saving(words, ending)
            gyro = None if outcome.estimate is None else outcome.estimate.gyro
            self._commands.append(PutInForce(outcome.calibration, gyro))
        else:
            remedy = "~/accept puts the new one in force anyway"
            self._conclude(False, f"{words} {unchanged}; {remedy}.{ending}")

    def note_saved(self, saved: Conclusion) -> None:
        """Note whether the calibration in force is stored; if not, the answer begins with that."""
        stage = self._stage
        if isinstance(stage, Saving):
            words = (stage.words, saved.message)
            first, last = words if saved.success else words[::-1]
            self._conclude(saved.success, f"{first} {last}{stage.report}")

    def cancel(self) -> Conclusion:
        """Cancel the turn."""
        if isinstance(self._stage, Saving):
            return Conclusion(False, "too late to cancel: the new calibration is in force already")
        if self._stage is None:
            return Conclusion(False, "nothing to cancel: no turn is being collected or fitted")
        words = f"cancelled; {self._unchanged}"
        self.abort(words)
        return Conclusion(True, words)

    def note_sensors(self, field: str, imu: str) -> None:
        """Take the frames of the sensors.

        Turns of different sensors are not joined, and a change of a sensor ends the turn.
        """
        before = self._sensors
        self._sensors = field or before[0], imu or before[1]
        changes = _changes(before, self._sensors)
        if changes and isinstance(self._stage, (Collecting, Fitting)):
            self.abort(
                f"{' and '.join(changes)} during the turn: let one sensor publish, and turn "
                f"again; {self._unchanged}"
            )

    def abort(self, words: str, was_under_way: bool = False) -> None:
        """End the turn after a failure, also a turn that has left its stage already."""
        if self._stage is not None or was_under_way:
            self._leave_collecting()
            self._conclude(False, words)

    def _conclude(self, success: bool, message: str) -> None:
        self._stage = None
        self.last_conclusion = Conclusion(success, message)
        self._commands.append(self.last_conclusion)


ENDED_BY_TIME = "ended by the time limit of"


def _changes(before: tuple[str, str], after: tuple[str, str]) -> list[str]:
    """Return which sensors have changed, in words."""
    return [
        f"the frame of {sensor} changed from {old!r} to {new!r}"
        for sensor, old, new in zip(("the magnetometer", "the IMU"), before, after, strict=True)
        if old and new and old != new
    ]
