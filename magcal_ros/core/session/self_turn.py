"""A robot that turns itself: conditions for the start, commands, and reasons to stop the robot.

Time and the states of sensors and base are passed in, and the rate to command, if any, is returned.
There is no command, not even zero, before the start and after the zeros that end the turn.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from magcal_ros.core.geometry.vec3 import Triple
from magcal_ros.core.samples.streams import Pair
from magcal_ros.core.session.rotation import Phase, RotationPlan, TurnMonitor
from magcal_ros.core.session.session import Progress, TurnRequest
from magcal_ros.core.session.session_tuning import SELF_TURN, SESSION

UNGUARDED = (
    "the robot does not start to turn: the guard, a second process that can stop the robot, was "
    f"not ready within {SELF_TURN.guarded_within:g} s; end other programs that keep the machine "
    "busy, and see the log"
)
GUARD_GONE = (
    "the guard process has ended, does not answer, or has stopped the robot because this node was "
    "silent for too long: end other programs that keep the machine busy"
)


@dataclass(frozen=True)
class TurnConditions:
    """The state of sensors, base and guard at one moment."""

    imu_age: float  # seconds since the newest IMU message; infinite before the first
    field_age: float  # the same for the field
    listeners: int  # subscriptions of the command topic
    is_allowed: bool  # whether the parameter rotate.enabled is true
    is_guarded: bool  # whether the guard would stop the robot if this node failed


@dataclass(frozen=True)
class ControlStep:
    """The result of one control step."""

    rate: float | None = None  # to command, rad/s, if any
    aborted: str = ""  # why the turn is given up, if it is
    ended: str = ""  # why the turn ends before it is complete; its samples are fitted


class SelfTurn:
    """Turns the robot from the first usable samples of a turn until its end.

    The arguments are names of both sensors and of the command topic, for messages.
    """

    def __init__(
        self, imu: str = "the IMU", field: str = "the field", command: str = "cmd_vel"
    ) -> None:
        self._imu, self._field, self._command = imu, field, command
        self._stage: TurnRequest | RotationPlan | None = None
        """The request while it waits for sensors, a subscription of the commands, and the guard;
        the plan while the robot turns."""
        self._monitor = TurnMonitor(np.eye(3))
        self._zeros = 0  # zeros that are still to be sent
        self._opened = self._looked = self._paired = 0.0
        self._gyro_heard: float | None = None

    @property
    def is_under_way(self) -> bool:
        """Whether the robot turns or waits for its start."""
        return self._stage is not None

    @property
    def is_quiet(self) -> bool:
        """Whether the turn is over and all zeros are sent."""
        return self._stage is None and not self._zeros

    def open(self, request: TurnRequest, now: float) -> None:
        """Start the turn as soon as its conditions are met."""
        self._stage = request
        self._gyro_heard = None
        self._opened = self._looked = self._paired = now

    def add_rate(self, rate: Triple, now: float) -> None:
        """Note the angular velocity (rad/s, NaN without one) of an IMU message."""
        is_finite = all(map(math.isfinite, rate))
        # Many drivers without a gyro send zeros; after another value, zero is a measured rate.
        if is_finite and (self._gyro_heard is not None or any(rate)):
            self._gyro_heard = now

    def take(self, pair: Pair, now: float) -> None:
        """Take the next sample of the turn."""
        if isinstance(self._stage, RotationPlan):
            self._paired = now
            self._monitor.add(pair, self._stage.command)

    def look(self, now: float, progress: Progress, conditions: TurnConditions) -> ControlStep:
        """Return the control step at `now` (s, steady clock); called twenty times a second."""
        plan, monitor = self._stage, self._monitor
        since, self._looked = now - self._looked, now
        if self._zeros:
            self._zeros -= 1
            return ControlStep(0.0)
        if isinstance(plan, TurnRequest):
            return self._wait(plan, now, conditions)
        if plan is None:
            return ControlStep()
        measured, commanded = monitor.measured(progress), plan.command
        rate = plan.step(now, measured)
        objection = self._objection(plan, now, since, conditions) or plan.objection(measured)
        if objection:
            return self.abort(objection)
        if plan.is_late(now):
            words = "the robot did not complete its turn in time"
            return ControlStep(self.stop().rate, ended=words)
        if plan.fault is not None:
            return self.abort(monitor.explain(plan.fault, measured, commanded))
        if plan.phase is Phase.ENDED:
            words = "" if measured.is_complete else "the robot has turned once each way"
            return ControlStep(self.stop().rate, ended=words)
        return ControlStep(rate)

    def stop(self) -> ControlStep:
        """Stop the robot."""
        stage, self._stage = self._stage, None
        if not isinstance(stage, RotationPlan):
            return ControlStep()
        self._zeros = SELF_TURN.zeros
        return ControlStep(0.0)

    def abort(self, reason: str) -> ControlStep:
        """Stop the robot and end its turn, with the reason."""
        moved = isinstance(self._stage, RotationPlan) or self._zeros > 0
        rate = self.stop().rate
        return ControlStep(rate, f"the robot was stopped: {reason}" if moved else reason)

    def _wait(self, request: TurnRequest, now: float, conditions: TurnConditions) -> ControlStep:
        waited = now - self._opened
        if not conditions.is_allowed:
            return self.abort("rotate.enabled was switched off")
        if max(conditions.imu_age, conditions.field_age) >= SELF_TURN.silence:
            return ControlStep()
        if not conditions.listeners:
            if waited > SELF_TURN.listeners_within:
                remedy = "remap cmd_vel to the base's topic"
                return self.abort(f"nothing subscribes to {self._command}: {remedy}")
        elif conditions.is_guarded:
            if waited >= SESSION.rest:
                assert request.speed is not None
                self._stage = RotationPlan(request.speed, now, request.limits.timeout)
                self._monitor = TurnMonitor(request.knowledge.mounting.to_body)
                self._paired = now
        elif waited > SELF_TURN.guarded_within:
            return self.abort(UNGUARDED)
        return ControlStep()

    def _objection(
        self, plan: RotationPlan, now: float, since: float, conditions: TurnConditions
    ) -> str:
        """Return why the turn must not continue; empty if it may."""
        if since > SELF_TURN.gyro_silence:
            return (
                f"the machine was too busy to supervise the robot for {since:.1f} s: "
                "end other programs that keep the machine busy"
            )
        if not conditions.is_allowed:
            return "rotate.enabled was switched off"
        if not conditions.is_guarded:
            return GUARD_GONE
        is_pausing = plan.phase is Phase.PAUSE
        is_unpaired = now - self._paired > SELF_TURN.silence and not is_pausing
        by_gyro = self._gyro_heard is not None
        # A pair needs both sensors, so pairs end a little before a sensor counts as silent.
        longest = SELF_TURN.silence / 2.0 if is_unpaired else SELF_TURN.silence
        for topic, age, limit in (
            (self._imu, conditions.imu_age, SELF_TURN.gyro_silence if by_gyro else longest),
            (self._field, conditions.field_age, longest),
        ):
            if age > limit:
                return f"{topic} has been silent for {age:.1f} s"
        if self._gyro_heard is not None and now - self._gyro_heard > SELF_TURN.gyro_silence:
            return (
                f"the gyro sends no data: {self._imu} has had no angular velocity for "
                f"{now - self._gyro_heard:.1f} s"
            )
        if is_unpaired:
            return "no new pair of field and acceleration samples has come while the robot turned"
        return self._monitor.objection()
