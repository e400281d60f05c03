import math

import pytest

from magcal_ros.core.session import MeasuredTurn, Phase, RotationPlan, planned_duration
from magcal_ros.core.session.session_tuning import ROTATION

SPEED = 0.5
BEYOND = ROTATION.farthest_beyond


def by_gyro(turned):
    return MeasuredTurn(turned, 0.0, True, False)


def obeys(plan, turned=0.0, is_complete=False):
    """The turn by a compass whose rate is the commanded one, and whose angle may stand still."""
    return MeasuredTurn(turned, plan.command, False, is_complete)


@pytest.mark.parametrize("turned", [-BEYOND, 0.0, math.tau + BEYOND])
def test_a_full_turn_and_some_coasting_are_allowed(turned):
    assert not RotationPlan(SPEED, 0.0).objection(by_gyro(turned))


@pytest.mark.parametrize("turned", [-BEYOND - 0.01, math.tau + BEYOND + 0.01])
def test_a_gyro_angle_beyond_the_plan_ends_the_turn(turned):
    assert f"{math.degrees(turned):+.0f}°" in RotationPlan(SPEED, 0.0).objection(by_gyro(turned))


def test_commands_of_more_than_a_slipping_turn_end_it():
    plan, now, swept = RotationPlan(SPEED, 0.0), 0.0, 0.0
    while not plan.objection(obeys(plan)):
        now, swept = now + 0.1, swept + 0.1 * plan.command
        plan.step(now, obeys(plan))
        assert now < 1000.0
    assert swept == pytest.approx(ROTATION.leeway * math.tau, rel=0.02)


def test_a_late_command_counts_for_the_time_it_was_in_force():
    plan = RotationPlan(SPEED, 0.0)
    for now in (0.1, 0.2):
        plan.step(now, obeys(plan))
    assert not plan.objection(obeys(plan))
    plan.step(0.3 + ROTATION.leeway * math.tau / plan.command, obeys(plan))
    assert plan.objection(obeys(plan))


def test_commands_in_both_directions_are_added():
    plan, now, swept = RotationPlan(SPEED, 0.0), 0.0, 0.0
    while not plan.objection(obeys(plan)):
        # All headings are seen after a whole turn; on the way back the angle stands still.
        turned = min(swept, math.tau)
        swept, now = swept + 0.1 * abs(plan.command), now + 0.1
        plan.step(now, obeys(plan, turned, plan.phase is Phase.OUT and turned == math.tau))
        assert now < 1000.0
    assert plan.phase is Phase.BACK
    assert swept == pytest.approx(2.0 * ROTATION.leeway * math.tau, rel=0.1)


def test_the_time_limit_is_that_of_the_plan_or_the_users_if_shorter():
    longest = ROTATION.leeway * planned_duration(SPEED)
    assert not RotationPlan(SPEED, 7.0).is_late(7.0 + longest - 0.1)
    assert RotationPlan(SPEED, 7.0).is_late(7.0 + longest + 0.1)
    assert RotationPlan(SPEED, 7.0, 5.0).is_late(12.1)
