import math

import pytest

from magcal_ros.core.session import MeasuredTurn, RotationPlan, planned_duration
from magcal_ros.core.session.session_tuning import ROTATION

SPEED = 0.5
BEYOND = ROTATION.farthest_beyond


def by_gyro(turned):
    return MeasuredTurn(turned, 0.0, True, False)


BLIND = MeasuredTurn(0.0, 0.0, False, False)


@pytest.mark.parametrize("turned", [-BEYOND, 0.0, math.tau + BEYOND])
def test_a_full_turn_and_some_coasting_are_allowed(turned):
    limits = RotationPlan(SPEED, 0.0)
    limits.note(1.0, 0.0, by_gyro(turned))
    assert not limits.objection


@pytest.mark.parametrize(
    "turned",
    [-ROTATION.farthest_beyond - 0.01, math.tau + ROTATION.farthest_beyond + 0.01],
)
def test_a_gyro_angle_beyond_the_plan_ends_the_turn(turned):
    limits = RotationPlan(SPEED, 0.0)
    limits.note(1.0, 0.0, by_gyro(turned))
    assert f"{math.degrees(turned):+.0f}°" in limits.objection


@pytest.mark.parametrize("sense", [1.0, -1.0])
def test_commands_of_more_than_a_slipping_turn_end_it(sense):
    limits, now = RotationPlan(SPEED, 0.0), 0.0
    while not limits.objection:
        now += 0.1
        limits.note(now, sense * SPEED, BLIND)
        assert now < 1000.0
    assert now * SPEED == pytest.approx(ROTATION.leeway * math.tau, rel=0.02)


def test_a_late_command_counts_for_the_time_it_was_in_force():
    limits = RotationPlan(SPEED, 0.0)
    limits.note(1.0, SPEED, BLIND)
    limits.note(1.0 + ROTATION.leeway * math.tau / SPEED, SPEED, BLIND)
    assert limits.objection


def test_commands_in_both_directions_are_added():
    limits, now = RotationPlan(SPEED, 0.0), 0.0
    while not limits.objection:
        now += 1.0
        limits.note(now, SPEED * (-1.0) ** int(now / 5.0), BLIND)
        assert now < 1000.0
    assert now * SPEED == pytest.approx(2.0 * ROTATION.leeway * math.tau, rel=0.1)


def test_the_time_limit_is_that_of_the_plan_or_the_users_if_shorter():
    longest = ROTATION.leeway * planned_duration(SPEED)
    assert not RotationPlan(SPEED, 7.0).is_late(7.0 + longest - 0.1)
    assert RotationPlan(SPEED, 7.0).is_late(7.0 + longest + 0.1)
    assert RotationPlan(SPEED, 7.0, 5.0).is_late(12.1)
