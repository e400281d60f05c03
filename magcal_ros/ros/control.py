"""A turn in the running node: reports events to the state machine and carries out its commands.

Collecting happens in the executor's thread, a few microseconds a sample. The fit has a process of
its own and the disk a thread, so the corrected field and the yaw are not interrupted.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable
from time import monotonic as now
from typing import Any, Protocol, TypeVar

from magcal_ros.core.calibrate import Outcome, predicted_sigma, take_turn
from magcal_ros.core.calibration.calibration import Calibration
from magcal_ros.core.errors import in_words
from magcal_ros.core.samples import FieldSample, ImuSample, Pairer, Streams, Window
from magcal_ros.core.samples.rest import GyroAtRest
from magcal_ros.core.session import turn_events as ev
from magcal_ros.core.session.self_turn import Around, Order, SelfTurn
from magcal_ros.core.session.turn_events import TurnState
from magcal_ros.core.session.turn_machine import TurnMachine
from magcal_ros.ros.keeper import Runner, Tell
from magcal_ros.ros.parameters import Settings
from magcal_ros.ros.worker_process import WorkerProcess

SAVING_PATIENCE = 1.5
"""Seconds that a disk may take to store a calibration while the node is being ended."""

T = TypeVar("T")


def _broken_off(error: Exception) -> str:
    return f"the turn was broken off by an error ({error}); the node's log says where"


class Robot(Protocol):
    """What a turn needs of the node."""

    def move(self, rate: float) -> None:
        """Command the base to turn at a rate, rad/s."""

    def look_around(self) -> Around:
        """Return the state of sensors, base and guard."""

    def note_error(self, error: Exception) -> None:
        """Note an error that ends a turn."""


class House(Protocol):
    """What a turn needs of its magnetometer."""

    def use(self, calibration: Calibration, tell: Tell) -> None:
        """Apply a calibration at once and store it; answers when that is done."""

    def begin_report(self, window: Window, settings: Settings, outcome: Outcome) -> str:
        """Begin the report on a turn; returns where it will lie, in words."""

    def describe_silence(self) -> str:
        """Say which sensor is missing, and what to look at."""

    def turn_ended(self) -> None:
        """Publish how a turn ended, before those who wait for it are answered."""


class Control:
    """Runs one turn at a time; `turn` is the state machine, to be read."""

    def __init__(
        self,
        streams: Streams,
        house: House,
        node: Robot,
        robot: SelfTurn,
        fits: Runner,
        files: Runner,
    ) -> None:
        self._house, self._node, self._fits, self._files = house, node, fits, files
        self._streams = streams
        self._pairer = Pairer(streams)
        self._worker = WorkerProcess()
        self.turn = TurnMachine(robot)
        self._settings: Settings | None = None
        self._listeners: list[Callable[[ev.Conclusion], None]] = []
        self._unreported: ev.Conclusion | None = None

    @property
    def state(self) -> TurnState:
        """What is going on."""
        return self.turn.state

    def when_done(self, listener: Callable[[ev.Conclusion], None]) -> None:
        """Call back once with the conclusion of the turn that is under way."""
        self._listeners.append(listener)

    def forget_turns(self) -> None:
        """Let the next turn start afresh."""
        self._tell(self.turn.forget)

    def note_sensors(self, field: str, imu: str) -> None:
        """Note the frames of the sensors that are there; turns of others are not joined."""
        self._tell(self.turn.note_sensors, field, imu)

    def start(self, settings: Settings, gyro: GyroAtRest | None = None) -> ev.Conclusion:
        """Open a session; refused while another is under way."""
        rotation, limits = settings.rotation, settings.limits
        order = None
        if rotation.enabled:
            to_body = settings.knowledge.mounting.to_body
            order = Order(rotation.speed, limits.timeout, to_body)
        knowledge, method = settings.knowledge, settings.method
        brief = ev.Brief(limits, knowledge, method, settings.accumulate, order, gyro)
        was_idle = self.state is TurnState.IDLE
        answer = self._tell(self.turn.open, brief, now())
        if was_idle and answer.success:
            self._settings, self._pairer = settings, Pairer(self._streams)
            self._unreported = None
        return answer

    def add(self, sample: FieldSample) -> None:
        """Take a field sample of the stream, if a session wants it."""
        if self.state is TurnState.COLLECTING:
            self._pairer.offer(sample)
            self._collect()

    def hear(self, sample: ImuSample) -> None:
        """Take an IMU sample, if the robot turns itself."""
        if self.turn.robot.is_under_way:
            self._tell(self.turn.hear, sample.rate, now())

    def finish(self) -> ev.Conclusion | None:
        """End the session now and fit what there is; None means the fit is under way.

        The verdict on a turn that ended by itself, and that nobody waited for, is returned once.
        """
        self._collect()
        unreported, self._unreported = self._unreported, None
        if unreported is not None:
            return unreported
        return self._tell(self.turn.finish, now())

    def cancel(self) -> ev.Conclusion:
        """Give up the turn under way; the calibration in force stays."""
        return self._tell(self.turn.cancel)

    def tick(self) -> bool:
        """Let a turn see that time has passed; returns whether one is under way."""
        if self.state is TurnState.COLLECTING:
            self._collect()
            self._tell(self.turn.tick, self._house.describe_silence(), now())
        return self.state is not TurnState.IDLE

    def look(self) -> bool:
        """Look at a robot that turns itself; returns whether there is still one to look at."""
        self._collect()
        if self.turn.progress is not None:
            self._tell(self.turn.look, self._node.look_around(), now())
        return not self.turn.robot.is_quiet

    def give_up(self, reason: str) -> None:
        """Stop a robot that turns itself and break off its turn."""
        self._tell(self.turn.stop_robot, reason, now())

    def shut_down(self) -> None:
        """Drop a turn under way; what is in force already is saved before this returns."""
        if self.state is TurnState.SAVING:
            self._files.finish_within(SAVING_PATIENCE)
        self._worker.end()

    def _collect(self) -> None:
        if self.state is TurnState.COLLECTING:
            for pair in self._pairer.take():
                self._tell(self.turn.take, pair, now())

    def _tell(self, happened: Callable[..., T], *facts: Any) -> T:
        """Report an event to the turn and carry out its commands; returns its answer."""
        before = self.state
        try:
            answer = happened(*facts)
            commands = self.turn.commands()
        except Exception as error:  # short of files even a median fails: its code must be read
            if happened != self.turn.break_off:
                was_under_way = {before, self.state} != {TurnState.IDLE}
                self._tell(self.turn.break_off, _broken_off(error), was_under_way)
            raise
        for command in commands:
            self._do(command)
        return answer

    def _do(self, command: ev.Command) -> None:
        try:
            self._carry_out(command)
        except Exception as error:  # whatever has failed, all who wait are answered
            self._node.note_error(error)
            self._tell(self.turn.break_off, _broken_off(error))

    def _carry_out(self, command: ev.Command) -> None:
        if isinstance(command, ev.MoveBase):
            self._node.move(command.rate)
        elif isinstance(command, ev.Prepare):
            self._fits.run(self._worker.start, lambda _: None, lambda _: None)
        elif isinstance(command, ev.Preview):
            self._preview(command)
        elif isinstance(command, ev.FitTurn):
            self._fit(command)
        elif isinstance(command, ev.Report):
            self._tell(self.turn.note_report, self._report(command))
        elif isinstance(command, ev.PutInForce):
            # The calibration is in force; a fault in storing it is only said.
            self._house.use(
                command.calibration, lambda done: self._tell(self.turn.note_saved, done.message)
            )
        elif isinstance(command, ev.Conclude):
            self._conclude(command.conclusion)

    def _preview(self, asked: ev.Preview) -> None:
        known, method = asked.brief.knowledge, asked.brief.method
        self._fits.run(
            lambda: self._worker.run(predicted_sigma, asked.window, known, method),
            lambda sigma: self._tell(self.turn.note_preview, asked.turn, sigma, now()),
            # A preview that failed predicts nothing; the fit will tell.
            lambda _: self._tell(self.turn.note_preview, asked.turn, math.inf, now()),
        )

    def _fit(self, asked: ev.FitTurn) -> None:
        brief = asked.brief
        turn = (asked.kept, asked.window, brief.knowledge, brief.method, brief.accumulate)
        self._fits.run(
            lambda: self._worker.run(take_turn, *turn),
            lambda found: self._tell(self.turn.note_fit, asked.turn, *found),
            lambda error: self._tell(self.turn.note_failed_fit, asked.turn, in_words(error)),
        )

    def _report(self, asked: ev.Report) -> str:
        assert self._settings is not None
        try:
            return self._house.begin_report(asked.window, self._settings, asked.outcome)
        except Exception as error:  # the calibration matters more than a page about it
            self._node.note_error(error)
            return f"No report: {error}."

    def _conclude(self, conclusion: ev.Conclusion) -> None:
        listeners, self._listeners = self._listeners, []
        self._unreported = None if listeners else conclusion
        # Whatever fails here, all who wait are answered.
        with contextlib.ExitStack() as at_last:
            for listener in listeners:
                at_last.callback(listener, conclusion)
            self._worker.stop()
            self._house.turn_ended()
