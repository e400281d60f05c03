import math

import pytest

from magcal_ros.core.up import REST, BlockMeans, SteadyInterval

NOISE = 0.002
RATE_NOISE = 0.002
UP, ZERO = (0.0, 0.0, 1.0), (0.0, 0.0, 0.0)


def spell(force, seconds, rate=(0.0, 0.0, 0.002)):
    found = SteadyInterval()
    for _ in range(int(seconds / 0.04)):
        found.add(BlockMeans(force, rate, 4, 0.04), NOISE, RATE_NOISE)
    return found


def shows_up(found, tilt=0.03):
    odds = found.evidence(UP, tilt**2, (1.0, 5e-4), NOISE)
    return odds + found.seconds / REST.constant_for > REST.sure


def test_a_tilt_keeps_the_length_of_the_force_and_is_soon_accepted():
    assert shows_up(spell((math.sin(0.1), 0.0, math.cos(0.1)), 0.3), tilt=0.005)


def test_an_acceleration_changes_the_length_and_is_not_accepted():
    assert not shows_up(spell((0.2, 0.0, 1.0), 4.2))


def test_a_constant_force_is_accepted_after_a_time_although_its_length_is_wrong():
    assert shows_up(spell((0.0, 0.0, 1.003), 6.0))


@pytest.mark.parametrize(("seconds", "accepted"), [(0.6, False), (2.0, True)])
def test_if_the_length_is_undecided_the_duration_decides(seconds, accepted):
    assert shows_up(spell((0.03, 0.0, 1.0), seconds)) is accepted


def test_where_up_is_known_a_force_along_it_is_soon_accepted():
    assert shows_up(spell((0.005, 0.0, 1.0), 0.6), tilt=0.005)
    assert not shows_up(spell((0.03, 0.0, 1.0), 1.2), tilt=0.005)


def test_a_constant_rate_is_steady():
    assert spell(UP, 5.0, rate=(0.06, -0.05, 0.04)).seconds > 4.9


def test_the_begin_of_a_turn_ends_the_steady_interval():
    found = spell(UP, 5.0)
    assert not found.add(BlockMeans(UP, (0.0, 0.0, 0.05), 4, 0.04), NOISE, RATE_NOISE)


def test_a_change_begins_a_new_steady_interval():
    found = spell(UP, 2.0)
    assert not found.add(BlockMeans((0.1, 0.0, 1.0), ZERO, 4, 0.04), NOISE, RATE_NOISE)
    assert found.seconds == 0.04
