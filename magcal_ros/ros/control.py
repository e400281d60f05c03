"""A turn from the service call to the calibration in force.

Collecting happens in the executor's thread, a few microseconds a sample; the fit and the disk
have a thread of their own, so the corrected field and the yaw keep flowing.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from concurrent.futures import Future as Job
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from enum import Enum

from magcal_ros.core.calibrate import Outcome, calibrate, predicted_sigma
from magcal_ros.core.calibration import Calibration
from magcal_ros.core.errors import Reason, Refusal
from magcal_ros.core.session import Progress, Session, Stage
from magcal_ros.core.streams import FieldSample, Pair, Pairer, Streams
from magcal_ros.core.window import Window
from magcal_ros.ros.settings import Settings

PREVIEW_ARC = math.radians(120.0)
PREVIEW_SHARE = 0.25
"""Share of one core that may go into predicting the heading sigma while the robot turns."""


class State(str, Enum):
    """What the node is busy with."""

    IDLE = "idle"
    COLLECTING = "collecting"
    FITTING = "fitting"
    SAVING = "saving"


@dataclass(frozen=True)
class Conclusion:
    """How a turn ended, as a service answers it."""

    success: bool
    message: str


class Control:
    """Runs one turn at a time.

    Parameters
    ----------
    streams : Streams
        The cleaned sensor streams.
    put_in_force : callable
        Applies a calibration at once and returns the work of storing it, which may take long and
        returns what to add to the answer ("saved to ...").
    describe_silence : callable
        Says which sensor is missing, and what to look at.
    report : callable
        Begins the report on a window and its outcome and returns where it will lie, in words.

    Attributes
    ----------
    on_pair : callable
        Sees every pair that a session takes.
    is_held : callable
        Whether a complete turn is not over yet, because the robot is on its way back.
    """

    def __init__(
        self,
        streams: Streams,
        put_in_force: Callable[[Calibration], Callable[[], str]],
        describe_silence: Callable[[], str],
        report: Callable[[Window, Settings, Outcome], str],
    ) -> None:
        self._streams = streams
        self._put_in_force = put_in_force
        self._describe_silence = describe_silence
        self._report = report
        self._worker = ThreadPoolExecutor(1, thread_name_prefix="magcal-fit")
        self._session: Session | None = None
        self._pairer = Pairer(streams)
        self._settings: Settings | None = None
        self._job: Job[Outcome] | None = None
        self._saving: Job[str] | None = None
        self._preview: Job[float] | None = None
        self._preview_began = self._next_preview = 0.0
        self._why_ended = ""
        self._words = self._words_of_report = ""
        self._listeners: list[Callable[[Conclusion], None]] = []
        self.on_pair: Callable[[Pair], None] = lambda _: None
        self.is_held: Callable[[], bool] = lambda: False
        self.progress: Progress | None = None
        self.last_window: Window | None = None
        self.last_outcome: Outcome | None = None
        self.last_conclusion: Conclusion | None = None

    @property
    def state(self) -> State:
        """What is going on."""
        if self._job is not None:
            return State.FITTING
        if self._saving is not None:
            return State.SAVING
        return State.IDLE if self._session is None else State.COLLECTING

    def when_done(self, listener: Callable[[Conclusion], None]) -> None:
        """Call back once with the conclusion of the turn that is under way."""
        self._listeners.append(listener)

    def start(self, settings: Settings) -> Conclusion:
        """Open a session; refused while another is under way."""
        if self.state is not State.IDLE:
            return Conclusion(
                False,
                f"already {self.state.value}: wait for it to end, or call ~/cancel first",
            )
        self._settings = settings
        self.last_window = None
        self._preview = None
        self._pairer = Pairer(self._streams)
        self._session = Session(settings.limits, settings.knowledge.mounting, time.monotonic())
        self.progress = self._session.progress(time.monotonic())
        return Conclusion(True, "collecting: turn the robot once, a full circle, 0.5 rad/s or less")

    def add(self, sample: FieldSample) -> None:
        """Take a field sample of the stream, if a session wants it."""
        if self._session is not None:
            self._pairer.offer(sample)
            self._collect(self._session)

    def finish(self) -> Conclusion | None:
        """End the session now and fit what there is; None means the fit is under way."""
        if self._session is None:
            if self.state is State.IDLE:
                return Conclusion(False, "no turn is being collected: call ~/start first")
            return Conclusion(False, f"already {self.state.value}")
        self._begin_fit(self._session, "finished by hand")
        return None

    def cancel(self) -> Conclusion:
        """Give up the turn under way; the calibration in force stays."""
        if self.state is State.SAVING:
            return Conclusion(False, "too late to cancel: the new calibration is in force already")
        if self.state is State.IDLE:
            return Conclusion(False, "nothing to cancel: no turn is being collected or fitted")
        self._session = None
        if self._job is not None:
            self._job.cancel()
            self._job = None
        self._conclude(Conclusion(False, "cancelled; the calibration in force is unchanged"))
        return Conclusion(True, "cancelled; the calibration in force is unchanged")

    def break_off(self, reason: str) -> None:
        """Give up the turn that is being collected; the reason is its conclusion."""
        if self._session is not None:
            self._session = None
            self._conclude(Conclusion(False, f"{reason}; the calibration in force is unchanged"))

    def end_turn(self, why: str) -> None:
        """Fit what was seen of the turn that is being collected, for it will not get longer."""
        if self._session is not None:
            self._collect(self._session)
            self._begin_fit(self._session, why)

    def tick(self) -> bool:
        """Move on what is ready to move; returns whether a session or a fit is under way."""
        if self._job is not None:
            if self._job.done():
                job, self._job = self._job, None
                self._use(job)
        elif self._saving is not None:
            if self._saving.done():
                saving, self._saving = self._saving, None
                self._conclude(Conclusion(True, f"{self._words} {_result_or_fault(saving)}"))
        elif self._session is not None:
            self._collect(self._session)
            self.progress = self._session.progress(time.monotonic())
            is_held = self.progress.stage is Stage.COMPLETE and self.is_held()
            if self.progress.stage is Stage.COLLECTING or is_held:
                self._look_ahead(self._session, self.progress)
            else:
                self._end_collection(self._session, self.progress)
        return self.state is not State.IDLE

    def shut_down(self) -> None:
        """Drop what is under way without waiting for it."""
        self._session = None
        self._worker.shutdown(wait=False, cancel_futures=True)

    def _collect(self, session: Session) -> None:
        now = time.monotonic()
        for pair in self._pairer.take():
            session.add(pair, now)
            self.on_pair(pair)

    def _look_ahead(self, session: Session, progress: Progress) -> None:
        """Let the worker predict, now and then, how certain a fit would be already."""
        if self._preview is not None:
            if not self._preview.done():
                return
            session.note_sigma(_sigma_or_none(self._preview))
            self._preview = None
            took = time.monotonic() - self._preview_began
            self._next_preview = time.monotonic() + took * (1.0 / PREVIEW_SHARE - 1.0)
        elif progress.coverage.arc > PREVIEW_ARC and time.monotonic() > self._next_preview:
            self._preview_began = time.monotonic()
            assert self._settings is not None
            self.last_window = session.window()
            work = (self.last_window, self._settings.knowledge, self._settings.method)
            self._preview = self._worker.submit(predicted_sigma, *work)

    def _end_collection(self, session: Session, progress: Progress) -> None:
        why = {
            Stage.COMPLETE: "",
            Stage.TIMED_OUT: f"the time is up after {progress.elapsed:.0f} s",
            Stage.SILENT: self._describe_silence(),
        }[progress.stage]
        if progress.stage is Stage.SILENT and not session.has_samples:
            self._session, self._why_ended = None, ""
            self._refuse(Refusal(Reason.TOO_FEW_SAMPLES, why))
            return
        self._begin_fit(session, why)

    def _begin_fit(self, session: Session, why: str) -> None:
        assert self._settings is not None
        self.progress = session.progress(time.monotonic())
        self._why_ended = why
        self._session = None
        try:
            window = self.last_window = session.window()
            self.progress.require_arc(session.limits.smallest_arc)
        except Refusal as refusal:
            self._refuse(refusal)
            return
        settings = self._settings
        self._job = self._worker.submit(calibrate, window, settings.knowledge, settings.method)

    def _use(self, job: Job[Outcome]) -> None:
        try:
            outcome = job.result()
        except Exception as error:  # a fault of ours must not take the node down
            self._conclude(Conclusion(False, f"the fit failed unexpectedly: {error!r}"))
            return
        self._judge(outcome)

    def _judge(self, outcome: Outcome) -> None:
        self.last_outcome = outcome
        self._words = outcome.verdict.summary
        if self._why_ended:
            self._words = f"{self._why_ended}; {self._words}"
        if self.last_window is not None and self._settings is not None:
            self._words_of_report = self._report(self.last_window, self._settings, outcome)
        unchanged = "The calibration in force is unchanged"
        if outcome.calibration is None:
            self._conclude(Conclusion(False, f"{self._words} {unchanged}."))
        elif outcome.verdict.accepted:
            self._saving = self._worker.submit(self._put_in_force(outcome.calibration))
        else:
            remedy = "~/accept applies this one anyway"
            self._conclude(Conclusion(False, f"{self._words} {unchanged}; {remedy}."))

    def _refuse(self, refusal: Refusal) -> None:
        self._judge(Outcome.refused(refusal))

    def _conclude(self, conclusion: Conclusion) -> None:
        if self._words_of_report:
            message = f"{conclusion.message} {self._words_of_report}"
            conclusion = Conclusion(conclusion.success, message)
            self._words_of_report = ""
        self.last_conclusion = conclusion
        listeners, self._listeners = self._listeners, []
        for listener in listeners:
            listener(conclusion)


def _result_or_fault(saving: Job[str]) -> str:
    try:
        return saving.result()
    except Exception as error:  # the calibration is in force; a fault in storing it is only said
        return f"In force, but not saved: {error!r}"


def _sigma_or_none(preview: Job[float]) -> float:
    """Return the predicted sigma; a preview that failed predicts nothing, the fit will tell."""
    return math.inf if preview.exception() is not None else preview.result()
