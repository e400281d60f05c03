"""A turn in virtual time: a simulated robot, its base, the fit and the storage."""

import math
from dataclasses import replace
from itertools import count

import numpy as np
from simulated.turns import measure, turn

from magcal_ros.core import Knowledge, Outcome, Reason, Refusal, calibrate
from magcal_ros.core.multi_turn import KeptTurns
from magcal_ros.core.samples import ImuSample, Pairer, Streams
from magcal_ros.core.session import (
    Conclusion,
    FitTurn,
    Limits,
    MoveBase,
    Preview,
    PutInForce,
    SelfTurn,
    TurnConditions,
    TurnMachine,
    TurnRequest,
)
from magcal_ros.core.simulation import Ride, Robot

STEP = 0.02
ROBOT = Robot()
WINDOW = measure(ROBOT, turn(), np.random.default_rng(1))
# By the quickest method: every process that collects the tests imports this.
GOOD = calibrate(WINDOW, ROBOT.knowledge(), "design_tip")
BAD = Outcome.refused(Refusal(Reason.NO_MOTION, "no good"))
SHORT = replace(GOOD, verdict=replace(GOOD.verdict, checks=()))
NO_RATE = (math.nan,) * 3


class Scene:
    """Runs robot, base and state machine, and keeps the messages.

    The base follows its commands with a lag, times `gain`; `mangle` makes of each sample what
    arrives in its place, or None.
    """

    def __init__(self, speed=None, gain=1.0, gyro=True, outcome=GOOD, sigma=0.001, **limits):
        self.now = 500.0
        self.gain, self.outcome, self.sigma = gain, outcome, sigma
        robot, report = SelfTurn("/imu", "/mag", "/cmd_vel"), lambda *_: "Report: here."
        self.turn = TurnMachine(robot, report, lambda: bool(self.in_force))
        self.ride = Ride(
            ROBOT,
            np.random.default_rng(3),
            start=1000.0,
            imu_rate=1.0 / STEP,
            steps_per_field=2,
            gyro=gyro,
        )
        self.streams = Streams(0.2)
        self.pairer = Pairer(self.streams)
        self.mangle = lambda sample: sample
        self.listeners, self.is_allowed, self.is_guarded = 1, True, True
        self.command = self.rate = self.turned = self.farthest = self.swept = 0.0
        self.saved = Conclusion(True, "In force and saved.")
        self.stated, self.concluded, self.asked, self.in_force = [], [], [], []
        self.fit_takes, self.preview_takes, self.saving_takes = 0.3, 0.2, 0.05
        self._later = []
        self._steps = count()
        self._heard = {ImuSample: -math.inf, "field": -math.inf}
        limits = Limits(**{"timeout": 90.0, **limits})
        self.request = TurnRequest(limits, Knowledge(), "maximum_likelihood", False, speed)

    @property
    def conclusion(self):
        return self.concluded[-1]

    def open(self, **changes):
        return self.tell("open", replace(self.request, **changes), self.now)

    def tell(self, happened, *facts):
        """Pass an event to the machine and carry out its commands; returns its answer."""
        answer = getattr(self.turn, happened)(*facts)
        for command in self.turn.commands():
            self.asked.append(command)
            if isinstance(command, Conclusion):
                self.concluded.append(command)
            elif isinstance(command, MoveBase):
                self.command = command.rate
                self.stated.append((self.now, command.rate))
            elif isinstance(command, PutInForce):
                self.in_force.append(command.calibration)
                self.later(self.saving_takes, "note_saved", self.saved)
            elif isinstance(command, FitTurn):
                self.later(self.fit_takes, *self.fitted(command))
            elif isinstance(command, Preview):
                when = self.now + self.preview_takes
                self.later(self.preview_takes, "note_preview", command, self.sigma, when)
        return answer

    def fitted(self, command):
        if isinstance(self.outcome, Exception):
            return "note_failed_fit", command, repr(self.outcome)
        outcome = replace(self.outcome, window=command.window)
        return "note_fit", command, outcome, KeptTurns(count=command.kept.count + 1)

    def later(self, seconds, *event):
        self._later.append((self.now + seconds, event))

    def live(self, seconds, yaw_rate=None, stop=lambda: False):
        """Go on for so long, turned by hand at a rate or by the base as it is told."""
        end = self.now + seconds
        while self.now < end and not stop():
            self._step(yaw_rate)
        return self

    def until_moving(self, rate=0.2):
        self.live(5.0, stop=lambda: abs(self.command) > rate)
        assert abs(self.command) > rate

    def until_concluded(self, patience=100.0, yaw_rate=None):
        self.live(patience, yaw_rate, stop=lambda: bool(self.concluded))
        return self.conclusion

    def freeze(self, seconds):
        """Let time pass while the node is not served."""
        for _ in range(round(seconds / STEP)):
            self.now += STEP
            self._move(None)

    def _move(self, yaw_rate):
        wanted = self.gain * self.command
        self.rate += (wanted - self.rate) * STEP / 0.1
        rate = self.rate if yaw_rate is None else yaw_rate
        self.turned += rate * STEP
        self.swept += abs(rate) * STEP
        self.farthest = max(self.farthest, abs(self.turned))
        return self.ride.step(rate)

    def _step(self, yaw_rate):
        self.now += STEP
        due = [event for moment, event in self._later if moment <= self.now]
        self._later = [(moment, event) for moment, event in self._later if moment > self.now]
        for event in due:
            self.tell(*event)
        for sample in self._move(yaw_rate):
            arrived = self.mangle(sample)
            if arrived is not None:
                self._arrive(arrived)
        number = next(self._steps)
        if number % 3 == 0:
            ages = self._heard[ImuSample], self._heard["field"]
            ages = [self.now - moment for moment in ages]
            conditions = TurnConditions(*ages, self.listeners, self.is_allowed, self.is_guarded)
            self.tell("look", conditions, self.now)
        if number % 20 == 0:
            # A quarter as often as the node: what has been seen of a turn is most of the time here.
            self.tell("tick", "/mag has been silent", self.now)

    def _arrive(self, sample):
        if isinstance(sample, ImuSample):
            self._heard[ImuSample] = self.now
            if self.streams.add_imu(sample):
                self.turn.robot.add_rate(sample.rate, self.now)
        else:
            self._heard["field"] = self.now
            if self.streams.add_field(sample):
                self.pairer.offer(sample)
        for pair in self.pairer.take():
            self.tell("take", pair, self.now)

    def assert_stopped_and_silent(self):
        """The last commands are several zeros, and then none."""
        self.live(1.5)
        assert [rate for _, rate in self.stated[-5:]] == [0.0] * 5
        received = len(self.stated)
        self.live(2.0)
        assert len(self.stated) == received
