import math

import pytest

from magcal_ros.core.heading.running import MotionSense

STILL = (0.001, -0.002, 0.001)
TURNS = (0.0, 0.0, 0.3)


def shares(rates, speed=math.nan, is_at_rest=False):
    sense = MotionSense()
    return [
        sense.at(0.04 * k, rate, is_at_rest, speed, math.nan).moving for k, rate in enumerate(rates)
    ]


@pytest.mark.parametrize("speed", [0.0, math.nan])
def test_a_turn_begins_and_ends_with_a_moment_of_doubt(speed):
    found = shares([STILL] * 3 + [TURNS] * 6 + [STILL] * 6, speed, is_at_rest=True)
    assert found == [0.0] * 3 + [0.5] * 3 + [1.0] * 3 + [0.5] * 3 + [0.0] * 3


def test_wheels_tell_a_straight_drive():
    assert shares([STILL], speed=0.5) == [1.0]
    assert shares([STILL], speed=-0.5) == [1.0]


def test_without_wheels_a_straight_drive_and_a_rest_are_in_doubt_until_a_rest_is_seen():
    assert shares([STILL] * 4) == [0.5] * 4
    assert shares([None] * 4, speed=0.0) == [0.5] * 4
    assert shares([STILL] * 4, is_at_rest=True) == [0.0] * 4


def test_a_jump_of_time_does_not_last():
    sense = MotionSense()
    sense.at(100.0, TURNS, False, 0.0, 2.0)
    sense.at(100.1, STILL, False, 0.0, 2.0)
    found = sense.at(5.0, STILL, False, 0.0, 2.0)
    assert (found.moving, found.turn_rate, found.current) == (0.0, 0.0, 2.0)
