"""The state machine of a turn: events in, commands out, time passed in.

Its owner (a node, or a test in virtual time) passes the events in and carries the commands out;
fits, files and messages belong to the owner.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

from magcal_ros.core.calibrate import JOINS, Outcome
from magcal_ros.core.errors import Reason, Refusal
from magcal_ros.core.multi_turn.keep import Kept
from magcal_ros.core.samples.window import Window
from magcal_ros.core.session import turn_events as ev
from magcal_ros.core.session.rotation_plan import planned_duration
from magcal_ros.core.session.self_turn import SelfTurn, Steering
from magcal_ros.core.session.session import Progress, Session, Stage
from magcal_ros.core.session.turn_events import (
    STATES,
    Collecting,
    Fitting,
    Reporting,
    Saving,
    Stand,
    TurnState,
)


@dataclass(frozen=True)
class PreviewTuning:
    """When the heading sigma is predicted in mid-turn.

    Attributes
    ----------
    preview_arc : float
        Radians of arc before which no prediction is made.
    preview_share : float
        Share of one core that may go into predicting the heading sigma while the robot
        turns.
    """

    preview_arc: float = math.radians(120.0)
    preview_share: float = 0.25


TUNING = PreviewTuning()


NOBODY = ("", "")
"""The frames of magnetometer and IMU before either is heard; some drivers never name one."""

SET_BACK = "time was set back during the turn, and what came before was left out"
UNCHANGED = "the calibration in force is unchanged"


class TurnMachine:
    """One turn at a time, from the request to the calibration in force.

    Parameters
    ----------
    robot : SelfTurn or None
        Turns itself where a brief has an order for it.

    Attributes
    ----------
    progress : Progress or None
        How far the newest turn is, or was.
    last_window, last_outcome, last_conclusion : Window, Outcome, Conclusion or None
        The newest of each.
    """

    def __init__(self, robot: SelfTurn | None = None) -> None:
        self.robot = SelfTurn() if robot is None else robot
        self.progress: Progress | None = None
        self.last_window: Window | None = None
        self.last_outcome: Outcome | None = None
        self.last_conclusion: ev.Conclusion | None = None
        self._stand: Stand = None
        self._number = 0
        self._kept = Kept()
        self._sensors = self._sensors_of_kept = self._sensors_of_outcome = NOBODY
        self._commands: list[ev.Command] = []
        self._handlers: dict[type[Any], Callable[[Any, float], None]] = {
            ev.Opened: self._on_opened,
            ev.PairArrived: self._on_pair,
            ev.RateHeard: lambda event, now: self.robot.hear(event.rate, now),
            ev.Ticked: self._on_ticked,
            ev.Looked: self._on_looked,
            ev.PreviewFitted: self._on_preview,
            ev.FinishAsked: self._on_finish,
            ev.FitDone: self._on_fit,
            ev.FitFailed: self._on_fit_failed,
            ev.Reported: self._on_reported,
            ev.Saved: self._on_saved,
            ev.CancelAsked: self._on_cancel,
            ev.Faulted: self._on_fault,
            ev.Broken: self._on_broken,
            ev.ForgetAsked: lambda _, __: self._forget(),
            ev.SensorsMet: self._on_sensors,
        }

    @property
    def state(self) -> TurnState:
        """What is going on."""
        return TurnState.IDLE if self._stand is None else STATES[type(self._stand)]

    @property
    def outcome_is_of_others(self) -> bool:
        """Whether the last outcome is of other sensors than the present ones."""
        return bool(_changes(self._sensors_of_outcome, self._sensors))

    @property
    def turns_kept(self) -> int:
        """How many turns the next one would join."""
        return len(self._kept.windows)

    def handle(self, event: ev.Event, now: float) -> list[ev.Command]:
        """Return what is to be done about an event, in this order.

        Parameters
        ----------
        event : Event
            One of `magcal_ros.core.session.turn_events`.
        now : float
            Seconds on a steady clock.
        """
        self._handlers[type(event)](event, now)
        commands, self._commands = self._commands, []
        return commands

    def _do(self, command: ev.Command) -> None:
        self._commands.append(command)

    def _answer(self, success: bool, message: str) -> None:
        self._do(ev.Answer(ev.Conclusion(success, message)))

    def _forget(self) -> None:
        self._kept = Kept()

    def _on_opened(self, event: ev.Opened, now: float) -> None:
        brief = event.brief
        refusal = self._why_not(brief)
        if refusal:
            self._answer(False, refusal)
            return
        if not brief.accumulate:
            self._forget()
        self._number += 1
        self.last_window = None
        session = Session(brief.limits, brief.knowledge.mounting, now, brief.gyro)
        self._stand = Collecting(brief, session)
        self.progress = session.progress(now)
        self._do(ev.Prepare())
        if brief.order is None:
            words = "collecting: turn the robot once, a full circle, 0.5 rad/s or less"
        else:
            self._steer(self.robot.stop())
            self.robot.open(brief.order, now)
            words = "collecting: the robot turns itself, once each way; keep clear"
        self._answer(True, words)

    def _why_not(self, brief: ev.Brief) -> str:
        """Say why a turn cannot be opened; empty if it can."""
        if brief.order is not None:
            speed, longest = brief.order.speed, brief.order.longest
            needed = planned_duration(speed)
            if needed > longest:
                return (
                    f"a turn each way at rotate.speed_rad_s {speed:g} takes {needed:.0f} s,"
                    f" longer than window.timeout_s ({longest:g} s): raise one of them"
                )
        if self._stand is not None:
            return f"already {self.state.value}: wait for it to end, or call ~/cancel first"
        if brief.accumulate and brief.method != JOINS:
            return (
                f"the method {brief.method} does not join turns: set method to {JOINS}, or "
                "accumulate to false"
            )
        return ""

    def _on_pair(self, event: ev.PairArrived, now: float) -> None:
        if isinstance(self._stand, Collecting):
            self._stand.session.add(event.pair, now)
            self.robot.take(event.pair, now)

    def _on_ticked(self, event: ev.Ticked, now: float) -> None:
        stand = self._stand
        if not isinstance(stand, Collecting):
            return
        progress = self.progress = stand.session.progress(now)
        is_held = progress.stage is Stage.COMPLETE and self.robot.is_under_way
        if progress.stage is Stage.COLLECTING or is_held:
            self._look_ahead(stand, progress, now)
        elif progress.stage is Stage.SILENT and not stand.session.has_samples:
            self._leave_collecting()
            self._refuse(Refusal(Reason.TOO_FEW_SAMPLES, event.silence), "")
        else:
            why = {
                Stage.COMPLETE: "",
                Stage.TIMED_OUT: f"the time is up after {progress.elapsed:.0f} s",
                Stage.SILENT: event.silence,
            }[progress.stage]
            self._begin_fit(stand, why, now)

    def _look_ahead(self, stand: Collecting, progress: Progress, now: float) -> None:
        """Ask at intervals how certain a fit would be already, and once the circle is complete."""
        waits = progress.coverage.is_complete and not stand.session.was_seen_whole
        if (
            stand.previewed_since is None
            and progress.coverage.arc > TUNING.preview_arc
            and (now > stand.next_preview or waits)
        ):
            window = self.last_window = stand.session.look()
            self._stand = replace(stand, previewed_since=now)
            brief = stand.brief
            self._do(ev.Preview(self._number, window, brief.knowledge, brief.method))

    def _on_preview(self, event: ev.PreviewFitted, now: float) -> None:
        stand = self._stand
        if event.turn != self._number or not isinstance(stand, Collecting):
            return
        if stand.previewed_since is not None:
            stand.session.note_sigma(event.sigma)
            pause = (now - stand.previewed_since) * (1.0 / TUNING.preview_share - 1.0)
            self._stand = replace(stand, previewed_since=None, next_preview=now + pause)

    def _on_looked(self, event: ev.Looked, now: float) -> None:
        assert self.progress is not None
        steering = self.robot.look(now, self.progress, event.around)
        # Stopping comes first; what it leads to may take a moment.
        self._steer(steering)
        self._end_with(steering, now)

    def _end_with(self, steering: Steering, now: float) -> None:
        stand, end = self._stand, steering.end
        if end is None or not isinstance(stand, Collecting):
            return
        if not end.is_usable:
            self._leave_collecting()
            self._conclude(False, f"{end.reason}; {UNCHANGED}")
        elif end.reason:
            self._begin_fit(stand, end.reason, now)

    def _on_fault(self, event: ev.Faulted, now: float) -> None:
        if self.robot.is_under_way:
            steering = self.robot.break_off(event.reason)
            self._steer(steering)
            self._end_with(steering, now)

    def _steer(self, steering: Steering) -> None:
        if steering.rate is not None:
            self._do(ev.MoveBase(steering.rate))

    def _leave_collecting(self) -> None:
        self._steer(self.robot.stop())
        self._stand = None

    def _on_finish(self, _: ev.FinishAsked, now: float) -> None:
        if isinstance(self._stand, Collecting):
            self._begin_fit(self._stand, "finished by hand", now)
        elif self._stand is None:
            self._answer(False, "no turn is being collected: call ~/start first")

    def _begin_fit(self, stand: Collecting, why: str, now: float) -> None:
        session, brief = stand.session, stand.brief
        self.progress = session.progress(now)
        why = "; ".join(filter(None, (why, SET_BACK * session.was_set_back)))
        self._leave_collecting()
        try:
            window = self.last_window = session.window()
            self.progress.require_arc(session.limits.smallest_arc)
        except Refusal as refusal:
            self._refuse(refusal, why)
            return
        if self._sensors != self._sensors_of_kept:
            self._sensors_of_kept = self._sensors
            self._forget()
        self._stand = Fitting(why, window, self._kept)
        known, method, joins = brief.knowledge, brief.method, brief.accumulate
        self._do(ev.FitTurn(self._number, self._kept, window, known, method, joins))

    def _on_fit(self, event: ev.FitDone, _: float) -> None:
        stand = self._stand
        if event.turn != self._number or not isinstance(stand, Fitting):
            return
        # Turns that were forgotten while this one was fitted do not come back with it.
        if self._kept is stand.kept:
            self._kept = event.kept
        self.last_window = event.outcome.window or self.last_window
        self._judge(event.outcome, stand.why_ended)

    def _on_fit_failed(self, event: ev.FitFailed, _: float) -> None:
        if event.turn == self._number and isinstance(self._stand, Fitting):
            self._conclude(False, f"the fit failed unexpectedly: {event.words}")

    def _refuse(self, refusal: Refusal, why: str) -> None:
        self._judge(Outcome.refused(refusal), why)

    def _judge(self, outcome: Outcome, why: str) -> None:
        self.last_outcome, self._sensors_of_outcome = outcome, self._sensors
        words = outcome.verdict.summary
        if outcome.several is not None and outcome.calibration is not None:
            words = f"{words} {outcome.several.in_words}"
        words = f"{why}; {words}" if why else words
        self._stand = Reporting(outcome, words)
        if self.last_window is None:
            self._weigh(self._stand, "")
        else:
            self._do(ev.Report(self.last_window, outcome))

    def _on_reported(self, event: ev.Reported, _: float) -> None:
        if isinstance(self._stand, Reporting):
            self._weigh(self._stand, event.words)

    def _weigh(self, stand: Reporting, report: str) -> None:
        """Put the calibration in force if it is good enough; else say what can be done."""
        outcome = stand.outcome
        ending = f" {report}" if report else ""
        unchanged = UNCHANGED[0].upper() + UNCHANGED[1:]
        if outcome.calibration is None:
            self._conclude(False, f"{stand.words} {unchanged}.{ending}")
        elif outcome.verdict.accepted:
            self._stand = Saving(stand.words, ending)
            self._do(ev.PutInForce(outcome.calibration))
        else:
            remedy = "~/accept applies this one anyway"
            self._conclude(False, f"{stand.words} {unchanged}; {remedy}.{ending}")

    def _on_saved(self, event: ev.Saved, _: float) -> None:
        stand = self._stand
        if isinstance(stand, Saving):
            self._conclude(True, f"{stand.words} {event.words}{stand.report}")

    def _on_cancel(self, _: ev.CancelAsked, __: float) -> None:
        if isinstance(self._stand, Saving):
            self._answer(False, "too late to cancel: the new calibration is in force already")
        elif self._stand is None:
            self._answer(False, "nothing to cancel: no turn is being collected or fitted")
        else:
            self._leave_collecting()
            self._conclude(False, f"cancelled; {UNCHANGED}")
            self._answer(True, f"cancelled; {UNCHANGED}")

    def _on_sensors(self, event: ev.SensorsMet, _: float) -> None:
        (field, imu), before = self._sensors, self._sensors
        self._sensors = event.field or field, event.imu or imu
        changes = _changes(before, self._sensors)
        if changes and isinstance(self._stand, (Collecting, Fitting)):
            self._leave_collecting()
            self._conclude(
                False,
                f"{' and '.join(changes)} during the turn: let one sensor publish, and turn "
                f"again; {UNCHANGED}",
            )

    def _on_broken(self, event: ev.Broken, _: float) -> None:
        if self._stand is not None or event.was_under_way:
            self._leave_collecting()
            self._conclude(False, event.words)

    def _conclude(self, success: bool, message: str) -> None:
        self._stand = None
        self.last_conclusion = ev.Conclusion(success, message)
        self._do(ev.Conclude(self.last_conclusion))


def _changes(before: tuple[str, str], after: tuple[str, str]) -> list[str]:
    """Say which sensor is another one now."""
    return [
        f"the frame of {sensor} changed from {old!r} to {new!r}"
        for sensor, old, new in zip(("the magnetometer", "the IMU"), before, after, strict=True)
        if old and new and old != new
    ]
