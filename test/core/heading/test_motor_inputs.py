import math

import pytest

from magcal_ros.core.heading import MotionDetector

STILL = (0.001, -0.002, 0.001)
TURNS = (0.0, 0.0, 0.3)


def shares(rates, speed=math.nan, is_at_rest=False):
    sense = MotionDetector()
    return [
        sense.at(0.04 * k, rate, is_at_rest, speed, math.nan).moving for k, rate in enumerate(rates)
    ]


@pytest.mark.parametrize("speed", [0.0, math.nan])
def test_a_turn_begins_and_ends_at_once(speed):
    """Whether motors run a little longer, `MotorFieldFilter` sees."""
    found = shares([STILL] * 3 + [TURNS] * 6 + [STILL] * 6, speed, is_at_rest=True)
    assert found == [0.0] * 3 + [1.0] * 6 + [0.0] * 6


def test_wheels_show_a_straight_drive():
    assert shares([STILL], speed=0.5) == [1.0]
    assert shares([STILL], speed=-0.5) == [1.0]


def test_without_wheels_motion_is_uncertain_until_a_rest():
    assert shares([STILL] * 4) == [0.5] * 4
    assert shares([None] * 4, speed=0.0) == [0.5] * 4
    assert shares([STILL] * 4, is_at_rest=True) == [0.0] * 4


def test_a_jump_of_time_does_not_last():
    sense = MotionDetector()
    sense.at(100.0, TURNS, False, 0.0, 2.0)
    sense.at(100.1, STILL, False, 0.0, 2.0)
    found = sense.at(5.0, STILL, False, 0.0, 2.0)
    assert (found.moving, found.turn_rate, found.current) == (0.0, 0.0, 0.0)


def test_only_the_current_beyond_that_at_rest_counts():
    sense = MotionDetector()
    plan = [(STILL, -0.5)] * 40 + [(TURNS, -3.5)] * 20 + [(STILL, -3.5)] * 3 + [(STILL, -0.5)] * 30
    found = [
        sense.at(0.04 * k, rate, True, 0.0, amps).current for k, (rate, amps) in enumerate(plan)
    ]
    assert found[:40] == [0.0] * 40
    assert found[40:60] == pytest.approx([-3.0] * 20)
    assert found[60:] == [0.0] * 33
    assert sense.at(4.0, TURNS, False, 0.0, -3.5).current == pytest.approx(-3.0, abs=0.05)


def test_calibrations_at_one_stamp_have_each_its_own_reference():
    sense = MotionDetector()
    asked = -0.5, math.nan, -2.0
    found = [sense.at(1.0, STILL, True, 0.0, -3.0, each).current for each in asked]
    assert found == [-2.5, 0.0, -1.0]


def test_beyond_a_reference_a_current_at_rest_counts_too():
    sense = MotionDetector()
    for k, (rate, amps) in enumerate([(STILL, -0.5), (STILL, -2.5), (TURNS, -3.5)]):
        found = sense.at(k, rate, True, 0.0, amps, -0.5)
        assert found.current == amps + 0.5
        assert found.are_on is (k > 0)
    for stamp in (8.0, 9.0):
        found = sense.at(stamp, STILL, True, 0.0, math.nan, -0.5)
    assert math.isnan(found.current)
    assert not found.are_on


def test_wheels_show_that_a_robot_has_stopped():
    sense = MotionDetector()
    speeds = [0.5] * 5 + [0.04] * 5 + [0.0] * 5
    found = [sense.at(0.04 * k, STILL, False, v, math.nan).moving for k, v in enumerate(speeds)]
    assert found == [1.0] * 10 + [0.0] * 5


@pytest.mark.parametrize("rate", [0.5, -0.5])
def test_a_turn_keeps_its_side_until_its_end(rate):
    sense = MotionDetector()
    rates = [rate] * 10 + [0.1 * rate] * 2 + [0.0] * 10
    plan = [sense.at(0.04 * k, (0.0, 0.0, r), False, 0.0, math.nan) for k, r in enumerate(rates)]
    side = math.copysign(1.0, rate)
    assert all(each.side * side >= 0.5 for each in plan if each.moving > 0.0)
    assert [each.side for each in plan if each.moving == 0.0] == [0.0] * 10


def test_an_unreported_current_is_not_zero_at_rest():
    sense = MotionDetector()
    assert math.isnan(sense.at(0.0, STILL, True, 0.0, math.nan).current)
    assert sense.at(1.0, STILL, True, 0.0, 2.0).current == 0.0
