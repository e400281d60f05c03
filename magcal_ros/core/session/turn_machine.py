"""The state machine of a turn: calls in, commands out, time passed in.

Its owner (a node, or a test in virtual time) reports events and carries out the commands; fits,
files and messages belong to the owner.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from enum import Enum
from typing import ClassVar, TypeAlias

from magcal_ros.core.calibrate import JOINS, Outcome
from magcal_ros.core.calibration.calibration import Calibration
from magcal_ros.core.errors import Reason, Refusal
from magcal_ros.core.multi_turn.result import Kept
from magcal_ros.core.samples.battery import Messages
from magcal_ros.core.samples.streams import Pair
from magcal_ros.core.samples.window import Window
from magcal_ros.core.session.rotation import planned_duration
from magcal_ros.core.session.self_turn import Around, SelfTurn, Steering
from magcal_ros.core.session.session import TUNING, Brief, Progress, Session, Stage


@dataclass(frozen=True)
class Conclusion:
    """How a turn ended, or what a request led to.

    As a command: answer everyone who waits for the turn, and release what computes for it.
    """

    success: bool
    message: str


@dataclass(frozen=True, eq=False)
class Preview:
    """Predict how certain a fit would be; answered by `note_preview`."""

    window: Window
    brief: Brief


@dataclass(frozen=True, eq=False)
class FitTurn:
    """Fit a turn on top of those kept; answered by `note_fit` or `note_failed_fit`."""

    kept: Kept
    window: Window
    brief: Brief


@dataclass(frozen=True, eq=False)
class PutInForce:
    """Use a calibration from now on and store it; answered by `note_saved`."""

    calibration: Calibration


@dataclass(frozen=True)
class MoveBase:
    """Tell the base to turn at a rate, rad/s, left positive."""

    rate: float


class TurnState(str, Enum):
    """The state of a turn."""

    IDLE = "idle"
    COLLECTING = "collecting"
    FITTING = "fitting"
    SAVING = "saving"


@dataclass(frozen=True, eq=False)
class Collecting:
    """Samples arrive; a preview of the fit is running or is planned."""

    brief: Brief
    session: Session
    state: ClassVar = TurnState.COLLECTING
    asked: Preview | None = None
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
"""Something that the owner of the state machine has to do."""


NO_SENSORS = ("", "")
"""The frames of magnetometer and IMU before either is heard; some drivers never name one."""

SET_BACK = "the time was set back during the turn; samples from before that were left out"
UNCHANGED = "the calibration in force is unchanged"


class TurnMachine:
    """One turn at a time, from the request to the calibration in force.

    `report` begins the report on a turn, and returns where it will lie, in words.
    """

    def __init__(
        self,
        robot: SelfTurn | None = None,
        report: Callable[[Window, Outcome], str] = lambda _, __: "",
    ) -> None:
        self.robot, self._report = SelfTurn() if robot is None else robot, report
        self.progress: Progress | None = None  # like the next ones the newest; None before any
        self.last_window: Window | None = None
        self.last_outcome: Outcome | None = None
        self.last_conclusion: Conclusion | None = None
        self._stage: Collecting | Fitting | Saving | None = None
        self._kept = Kept()
        self._sensors = self._sensors_of_kept = self._sensors_of_outcome = NO_SENSORS
        self._commands: list[Command] = []

    @property
    def state(self) -> TurnState:
        """What is going on."""
        return TurnState.IDLE if self._stage is None else self._stage.state

    @property
    def outcome_is_of_others(self) -> bool:
        """Whether the last outcome is of other sensors than the present ones."""
        return bool(_changes(self._sensors_of_outcome, self._sensors))

    @property
    def turns_kept(self) -> int:
        """How many turns the next one would join."""
        return len(self._kept.windows)

    def commands(self) -> list[Command]:
        """Return what is to be done about what happened, in this order."""
        commands, self._commands = self._commands, []
        return commands

    def forget(self) -> None:
        """Discard the turns kept so far."""
        self._kept = Kept()

    def open(self, brief: Brief, now: float) -> Conclusion:
        """Begin a turn, at `now`, seconds on a steady clock; returns whether it has begun."""
        refusal = self._why_not(brief)
        if refusal:
            return Conclusion(False, refusal)
        if not brief.accumulate:
            self.forget()
        self.last_window = None
        session = Session(brief.limits, brief.knowledge.mounting, now, brief.gyro)
        self._stage = Collecting(brief, session)
        self.progress = session.progress(now)
        words = "turn the robot once, a full circle, 0.5 rad/s or less"
        if brief.speed is not None:
            self._steer(self.robot.stop())
            self.robot.open(brief, now)
            words = "the robot turns itself, once each way; keep clear"
        return Conclusion(True, f"collecting: {words}")

    def _why_not(self, brief: Brief) -> str:
        """Say why a turn cannot be opened; empty if it can."""
        longest = brief.limits.timeout
        if brief.speed is not None and planned_duration(brief.speed) > longest:
            return (
                f"a turn each way at rotate.speed_rad_s {brief.speed:g} takes"
                f" {planned_duration(brief.speed):.0f} s,"
                f" longer than window.timeout_s ({longest:g} s): raise one of them"
            )
        if self._stage is not None:
            return f"already {self.state.value}: wait for it to end, or call ~/cancel first"
        if brief.accumulate and brief.method != JOINS:
            return (
                f"the method {brief.method} does not join turns: set method to {JOINS}, or "
                "accumulate to false"
            )
        return ""

    def take(
        self, pair: Pair, now: float, speed: float = math.nan, currents: Messages = ()
    ) -> None:
        """Take a field sample with the IMU at its stamp, speed (m/s or NaN), new currents."""
        if isinstance(self._stage, Collecting):
            self._stage.session.note_currents(*currents)
            self._stage.session.add(pair, now, speed)
            self.robot.take(pair, now)

    def tick(self, silence: str, now: float) -> None:
        """See that time has passed; `silence` says what is wrong, should nothing come."""
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
                Stage.TIMED_OUT: f"{BY_TIME} {progress.elapsed:.0f} s",
                Stage.SILENT: silence,
            }[progress.stage]
            self._begin_fit(stage, why, now)

    def _look_ahead(self, stage: Collecting, progress: Progress, now: float) -> None:
        """Ask at intervals how certain a fit would be already, and once the circle is complete."""
        waits = progress.coverage.is_complete and not stage.session.was_seen_whole
        is_due = now > stage.next_preview or waits
        if stage.asked is None and is_due and progress.coverage.arc > TUNING.preview_arc:
            window = self.last_window = stage.session.look()
            asked = Preview(window, stage.brief)
            self._stage = replace(stage, asked=asked, asked_at=now)
            self._commands.append(asked)

    def note_preview(self, asked: Preview, sigma: float, now: float) -> None:
        """Take the heading sigma (radians) that a fit of the samples so far predicts."""
        stage = self._stage
        if isinstance(stage, Collecting) and stage.asked is asked:
            stage.session.note_sigma(sigma)
            pause = (now - stage.asked_at) * (1.0 / TUNING.preview_share - 1.0)
            self._stage = replace(stage, asked=None, next_preview=now + pause)

    def look(self, around: Around, now: float) -> None:
        """Look at a robot that turns itself."""
        assert self.progress is not None
        self._follow(self.robot.look(now, self.progress, around), now)

    def _follow(self, steering: Steering, now: float) -> None:
        # Stopping comes first; what it leads to may take a moment.
        self._steer(steering)
        if not isinstance(self._stage, Collecting):
            return
        if steering.broken_off:
            self.break_off(f"{steering.broken_off}; {UNCHANGED}")
        elif steering.ended:
            self._begin_fit(self._stage, steering.ended, now)

    def stop_robot(self, reason: str, now: float) -> None:
        """Stop a robot that turns itself: what has failed may be what supervises it."""
        if self.robot.is_under_way:
            self._follow(self.robot.break_off(reason), now)

    def _steer(self, steering: Steering) -> None:
        if steering.rate is not None:
            self._commands.append(MoveBase(steering.rate))

    def _leave_collecting(self) -> None:
        self._steer(self.robot.stop())
        self._stage = None

    def finish(self, now: float) -> Conclusion | None:
        """Fit what there is; None where a fit is under way."""
        if isinstance(self._stage, Collecting):
            self._begin_fit(self._stage, "finished by hand", now)
        elif self._stage is None:
            return Conclusion(False, "no turn is being collected: call ~/start first")
        return None

    def _begin_fit(self, stage: Collecting, why: str, now: float) -> None:
        session = stage.session
        self.progress = session.progress(now)
        why = "; ".join(filter(None, (why, SET_BACK * session.was_set_back)))
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
        asked = FitTurn(self._kept, window, stage.brief)
        self._stage = Fitting(why, asked)
        self._commands.append(asked)

    def note_fit(self, asked: FitTurn, outcome: Outcome, kept: Kept) -> None:
        """Take the fit of a turn, and what is kept for the next one to join."""
        stage = self._stage
        if not isinstance(stage, Fitting) or stage.asked is not asked:
            return
        # Turns that were forgotten while this one was fitted do not come back with it.
        if self._kept is asked.kept:
            self._kept = kept
        self.last_window = outcome.window or self.last_window
        self._judge(outcome, stage.why_ended)

    def note_failed_fit(self, asked: FitTurn, words: str) -> None:
        """Take note that a fit ended with an error of the program."""
        if isinstance(self._stage, Fitting) and self._stage.asked is asked:
            self._conclude(False, f"the fit failed unexpectedly: {words}")

    def _judge(self, outcome: Outcome, why: str) -> None:
        """Put the calibration in force if it is good enough; else say what can be done."""
        self.last_outcome, self._sensors_of_outcome = outcome, self._sensors
        words = outcome.verdict.summary
        if outcome.several is not None and outcome.calibration is not None:
            words = f"{words} {outcome.several.in_words}"
        words = _with_ending(words, why, outcome.verdict.accepted)
        report = "" if self.last_window is None else self._report(self.last_window, outcome)
        ending = f" {report}" if report else ""
        unchanged = UNCHANGED[0].upper() + UNCHANGED[1:]
        if outcome.calibration is None:
            self._conclude(False, f"{words} {unchanged}.{ending}")
        elif outcome.verdict.accepted:
            self._stage = Saving(words, ending)
            self._commands.append(PutInForce(outcome.calibration))
        else:
            remedy = "~/accept applies this one anyway"
            self._conclude(False, f"{words} {unchanged}; {remedy}.{ending}")

    def note_saved(self, words: str) -> None:
        """Take whether the calibration in force is stored, in words."""
        stage = self._stage
        if isinstance(stage, Saving):
            self._conclude(True, f"{stage.words} {words}{stage.report}")

    def cancel(self) -> Conclusion:
        """Cancel the turn."""
        if isinstance(self._stage, Saving):
            words = "too late to cancel: the new calibration is in force already"
            return Conclusion(False, words)
        if self._stage is None:
            words = "nothing to cancel: no turn is being collected or fitted"
            return Conclusion(False, words)
        words = f"cancelled; {UNCHANGED}"
        self.break_off(words)
        return Conclusion(True, words)

    def note_sensors(self, field: str, imu: str) -> None:
        """Take the frames of the sensors: turns of others are not joined, nor one turn of two."""
        before = self._sensors
        self._sensors = field or before[0], imu or before[1]
        changes = _changes(before, self._sensors)
        if changes and isinstance(self._stage, (Collecting, Fitting)):
            self.break_off(
                f"{' and '.join(changes)} during the turn: let one sensor publish, and turn "
                f"again; {UNCHANGED}"
            )

    def break_off(self, words: str, was_under_way: bool = False) -> None:
        """End the turn, also one that was under way and was left already: something has failed."""
        if self._stage is not None or was_under_way:
            self._leave_collecting()
            self._conclude(False, words)

    def _conclude(self, success: bool, message: str) -> None:
        self._stage = None
        self.last_conclusion = Conclusion(success, message)
        self._commands.append(self.last_conclusion)


BY_TIME = "ended by the time limit of"


def _with_ending(words: str, why: str, accepted: bool) -> str:
    """Add why a turn ended; what is no fault stands behind a success, lest it seem a failure."""
    if accepted and why.startswith(BY_TIME):
        return f"{words} ({why[0].upper()}{why[1:]}.)"
    return f"{why}; {words}" if why else words


def _changes(before: tuple[str, str], after: tuple[str, str]) -> list[str]:
    """Say which sensor is another one now."""
    return [
        f"the frame of {sensor} changed from {old!r} to {new!r}"
        for sensor, old, new in zip(("the magnetometer", "the IMU"), before, after, strict=True)
        if old and new and old != new
    ]
