"""A simulated base in simulated time: where it stops, and how soon a fault stops it."""

import math

import pytest
from examples import examples
from hypothesis import given
from hypothesis import strategies as st

from magcal_ros.core.session import Fault, MeasuredTurn, Phase, RotationPlan, planned_duration
from magcal_ros.core.session.session_tuning import ROTATION

PERIOD = 0.05


class Base:
    """Follows commands with a lag, times a gain, and stops permanently at a time."""

    def __init__(self, gain=1.0, lag=0.1, stops_at=math.inf, gyro=True, complete_at=math.inf):
        self.gain, self.lag, self.stops_at = gain, lag, stops_at
        self.gyro, self.complete_at = gyro, complete_at
        self.rate = self.turned = self.farthest = 0.0

    def measured(self):
        complete = self.farthest >= self.complete_at
        if not self.gyro and self.farthest < math.radians(60.0):
            return MeasuredTurn(0.0, 0.0, False, complete)
        return MeasuredTurn(self.turned, self.rate, self.gyro, complete)

    def obey(self, command, now):
        wanted = 0.0 if now > self.stops_at else self.gain * command
        self.rate += (wanted - self.rate) * PERIOD / self.lag
        self.turned += self.rate * PERIOD
        self.farthest = max(self.farthest, self.turned)


def run(base, speed=0.4):
    """Run plan and base until the plan has ended; returns plan, seconds and commands."""
    plan, now, commands = RotationPlan(speed, 100.0), 100.0, []
    while plan.phase is not Phase.ENDED:
        commands.append(plan.step(now, base.measured()))
        base.obey(commands[-1], now)
        now += PERIOD
        assert now < 1000.0
    return plan, now - 100.0, commands


@pytest.mark.parametrize("speed", [0.1, 0.4, 1.0])
def test_the_robot_turns_a_full_circle_and_back(speed):
    base = Base()
    plan, took, commands = run(base, speed)
    assert plan.fault is None
    assert base.farthest == pytest.approx(math.tau, abs=0.15)
    assert base.turned == pytest.approx(0.0, abs=0.25)
    assert took == pytest.approx(planned_duration(speed), rel=0.1)
    assert (max(commands), min(commands)) == (speed, -speed)
    assert commands[-1] == 0.0


def test_the_first_direction_ends_when_all_headings_are_measured():
    base = Base(complete_at=5.0)
    run(base)
    assert base.farthest == pytest.approx(5.0, abs=0.3)
    assert base.turned == pytest.approx(0.0, abs=0.25)


@given(speed=st.floats(0.3, 1.0), gain=st.floats(0.8, 1.4), gyro=st.booleans())
@examples(25)
def test_rates_change_gradually_and_wheel_slip_is_no_fault(speed, gain, gyro):
    _, _, commands = run(Base(gain, gyro=gyro), speed)
    steps = [abs(b - a) for a, b in zip([0.0, *commands], commands, strict=False)]
    assert max(steps) <= ROTATION.acceleration * PERIOD + 1e-9
    assert commands[-1] == 0.0


@pytest.mark.parametrize("gyro", [True, False])
@pytest.mark.parametrize(
    ("gain", "fault"), [(0.0, Fault.NOT_TURNING), (-1.0, Fault.WRONG_WAY), (3.0, Fault.TOO_FAST)]
)
def test_a_base_that_disobeys_is_stopped_in_time(gyro, gain, fault):
    base = Base(gain, gyro=gyro)
    base.farthest = math.pi if gain < 0.0 else 0.0  # the compass measures both directions
    plan, took, commands = run(base)
    assert plan.fault is fault
    assert took < (4.0 if gyro else 7.0)
    assert commands[-1] == 0.0


@pytest.mark.parametrize("moment", [3.0, 10.0, 25.0])
def test_a_base_that_stops_during_the_turn_is_detected(moment):
    plan, took, _ = run(Base(stops_at=100.0 + moment))
    assert plan.fault is Fault.NOT_TURNING
    assert took < moment + 4.0


def test_the_command_is_zero_after_the_end():
    base = Base()
    plan, _, _ = run(base)
    assert [plan.step(1000.0 + k, base.measured()) for k in range(3)] == [0.0] * 3


def test_a_delayed_step_does_not_change_the_rate_abruptly():
    plan, base = RotationPlan(0.4, 0.0), Base()
    plan.step(0.05, base.measured())
    assert plan.step(5.0, base.measured()) <= 0.13
