"""A robot that turns itself: when it starts, its commands, and every reason to stop it.

Time and the surroundings are passed in, and the rate to command, if any, is returned. No command,
not even zero, is given before the robot starts, and none after the zeros that end the turn.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from magcal_ros.core.geometry.vec3 import Triple
from magcal_ros.core.samples.streams import Pair
from magcal_ros.core.session.rotation import Phase, RotationPlan, RotationProof
from magcal_ros.core.session.session import Brief, Progress


@dataclass(frozen=True)
class SelfTurnTuning:
    """How long a robot that turns itself may be without what it needs."""

    zeros: int = 10  # how often zero is sent at the end, for a single message may be lost
    silence: float = 1.0  # seconds without a sensor after which a moving robot is stopped
    gyro_silence: float = 0.5
    """Seconds without an angular velocity after which a robot that is controlled by the gyro is
    stopped, and between two looks at a moving robot: later it could not be stopped in time."""
    listeners_within: float = 3.0  # seconds within which the commands must have a listener
    stands_first: float = 3.0  # seconds at rest first: for the gyro's bias, the motors' field
    guarded_within: float = 10.0  # seconds for the guard: a small computer takes three


TUNING = SelfTurnTuning()


UNGUARDED = (
    "the robot does not start to turn: its guard, a second process that can stop it, was not "
    f"ready within {TUNING.guarded_within:g} s; end other programs that keep the machine busy, and "
    "see the log"
)
GUARD_GONE = (
    "its guard has ended, does not answer, or has stopped it because this node was silent for too "
    "long: end other programs that keep the machine busy"
)


@dataclass(frozen=True)
class Around:
    """The state of sensors, base and guard at one look."""

    imu_age: float  # seconds since the newest message; infinite before the first
    field_age: float  # the same
    listeners: int
    is_allowed: bool  # whether the user still lets the robot turn itself
    is_guarded: bool  # whether the guard would stop the robot if this node failed


@dataclass(frozen=True)
class Steering:
    """What a look at the robot leads to."""

    rate: float | None = None  # to command, rad/s, if any
    broken_off: str = ""  # why its turn is given up
    ended: str = ""  # why it goes no further, and what was seen is to be fitted


@dataclass(frozen=True)
class Moving:
    """The robot turns."""

    plan: RotationPlan
    proof: RotationProof


class SelfTurn:
    """Turns the robot from the first usable samples of a turn until its end.

    The texts are names of the sensors and the commands for messages.
    """

    def __init__(
        self, imu: str = "the IMU", field: str = "the field", command: str = "cmd_vel"
    ) -> None:
        self._imu, self._field, self._command = imu, field, command
        self._stage: Brief | Moving | None = None
        """A brief while it waits for both sensors, a subscriber of the commands and the guard."""
        self._zeros = 0  # so many zeros are still sent to end a turn
        self._opened = self._looked = self._paired = 0.0
        self._gyro_heard: float | None = None

    @property
    def is_under_way(self) -> bool:
        """Whether the robot is to turn, or turns."""
        return self._stage is not None

    @property
    def is_quiet(self) -> bool:
        """Whether the turn and its zeros are over."""
        return self._stage is None and not self._zeros

    def open(self, brief: Brief, now: float) -> None:
        """Let the robot turn as soon as it may."""
        self._stage = brief
        self._gyro_heard = None
        self._opened = self._looked = self._paired = now

    def hear(self, rate: Triple, now: float) -> None:
        """Note the angular velocity (rad/s, NaN without one) of an IMU message."""
        is_finite = all(map(math.isfinite, rate))
        # Without a gyro many drivers send zero; after another value zero is a rate like others.
        if is_finite and (self._gyro_heard is not None or any(rate)):
            self._gyro_heard = now

    def take(self, pair: Pair, now: float) -> None:
        """Take the next sample of the turn."""
        stage = self._stage
        if isinstance(stage, Moving):
            self._paired = now
            stage.proof.add(pair, stage.plan.command)

    def look(self, now: float, progress: Progress, around: Around) -> Steering:
        """Return the command at `now` (s, steady clock); to be called twenty times a second."""
        stage = self._stage
        since, self._looked = now - self._looked, now
        if self._zeros:
            self._zeros -= 1
            return Steering(0.0)
        if isinstance(stage, Brief):
            return self._wait(stage, now, around)
        if isinstance(stage, Moving):
            return self._lead(stage, now, since, progress, around)
        return Steering()

    def stop(self) -> Steering:
        """Stop the robot."""
        stage, self._stage = self._stage, None
        if not isinstance(stage, Moving):
            return Steering()
        self._zeros = TUNING.zeros
        return Steering(0.0)

    def break_off(self, reason: str) -> Steering:
        """Stop the robot and end its turn, with the reason."""
        moved = isinstance(self._stage, Moving) or self._zeros > 0
        rate = self.stop().rate
        return Steering(rate, f"the robot was stopped: {reason}" if moved else reason)

    def _wait(self, brief: Brief, now: float, around: Around) -> Steering:
        waited = now - self._opened
        if not around.is_allowed:
            return self.break_off("rotate.enabled was switched off")
        if max(around.imu_age, around.field_age) >= TUNING.silence:
            return Steering()
        if not around.listeners:
            if waited > TUNING.listeners_within:
                remedy = "remap cmd_vel to the base's topic"
                return self.break_off(f"nothing subscribes to {self._command}: {remedy}")
        elif around.is_guarded:
            if waited >= TUNING.stands_first:
                assert brief.speed is not None
                plan = RotationPlan(brief.speed, now, brief.limits.timeout)
                self._stage = Moving(plan, RotationProof(brief.knowledge.mounting.to_body))
                self._paired = now
        elif waited > TUNING.guarded_within:
            return self.break_off(UNGUARDED)
        return Steering()

    def _lead(
        self, stage: Moving, now: float, since: float, progress: Progress, around: Around
    ) -> Steering:
        plan, proof = stage.plan, stage.proof
        seen, commanded = proof.seen(progress), plan.command
        plan.note(now, commanded, seen)
        objection = self._objection(stage, now, since, around) or plan.objection
        if objection:
            return self.break_off(objection)
        if plan.is_late(now):
            words = "the robot did not complete its turn in time"
            return Steering(self.stop().rate, ended=words)
        rate = plan.step(now, seen)
        if plan.fault is not None:
            return self.break_off(proof.explain(plan.fault, seen, commanded))
        if plan.phase is Phase.ENDED:
            words = "" if seen.is_complete else "the robot has turned once each way"
            return Steering(self.stop().rate, ended=words)
        return Steering(rate)

    def _objection(self, stage: Moving, now: float, since: float, around: Around) -> str:
        """Say why the robot must not turn on; empty if it may."""
        if since > TUNING.gyro_silence:
            return (
                f"the machine was too busy to check it for {since:.1f} s: "
                "end other programs that keep the machine busy"
            )
        if not around.is_allowed:
            return "rotate.enabled was switched off"
        if not around.is_guarded:
            return GUARD_GONE
        return self._silence(stage, now, around) or stage.proof.objection(now)

    def _silence(self, stage: Moving, now: float, around: Around) -> str:
        is_pausing = stage.plan.phase is Phase.PAUSE
        is_unpaired = now - self._paired > TUNING.silence and not is_pausing
        by_gyro = self._gyro_heard is not None
        # Pairs end with the older of the two samples, a little before the sensor's silence.
        longest = TUNING.silence / 2.0 if is_unpaired else TUNING.silence
        for topic, age, limit in (
            (self._imu, around.imu_age, TUNING.gyro_silence if by_gyro else longest),
            (self._field, around.field_age, longest),
        ):
            if age > limit:
                return f"{topic} has been silent for {age:.1f} s"
        if self._gyro_heard is not None and now - self._gyro_heard > TUNING.gyro_silence:
            return (
                f"the gyro sends no data: {self._imu} has had no angular velocity for "
                f"{now - self._gyro_heard:.1f} s"
            )
        if is_unpaired:
            return "no new field sample with an acceleration has come while the robot turned"
        return ""
