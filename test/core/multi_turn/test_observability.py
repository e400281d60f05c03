import math

import pytest
from long_form import first_of
from slope_turns import EAST, KNOWN, LEVEL, NORTH, ROBOT, WEST, windows_on

from magcal_ros.core import calibrate_turns


@pytest.fixture(scope="module")
def level():
    return calibrate_turns(windows_on([LEVEL], 1), KNOWN).multi_turn


def best_slope(multi_turn):
    return next(a for a in multi_turn.advice if "slope" in a.pose)


@pytest.mark.nightly
def test_after_a_level_turn_a_slope_across_north_is_advised(level):
    assert best_slope(level).pose.endswith(("east", "west"))
    assert "installation yaw from ±5° to ±0." in level.advice_in_words


@pytest.mark.nightly
@pytest.mark.parametrize("direction", first_of(["north", "east", "west"]))
def test_the_advised_turn_gives_the_expected_accuracy(level, direction):
    slope = {"east": EAST, "north": NORTH, "west": WEST}[direction]
    promise = next(a.after for a in level.advice if a.pose.endswith(direction))
    # The compass that shows the direction of the slope errs by the installation yaw.
    kept = calibrate_turns(windows_on([LEVEL, slope - ROBOT.yaw], 1), KNOWN).multi_turn.shown
    for name in ("installation_yaw", "inclination", "absolute_level", "absolute_tilted"):
        assert getattr(kept, name) == pytest.approx(getattr(promise, name), rel=0.35)


@pytest.mark.nightly
def test_after_a_slope_to_the_east_one_to_the_north_or_south_is_advised():
    multi_turn = calibrate_turns(windows_on([LEVEL, EAST], 2), KNOWN).multi_turn
    assert best_slope(multi_turn).pose.endswith(("north", "south"))


def test_another_level_turn_does_not_determine_the_installation_yaw(level):
    again = next(a.after for a in level.advice if "level" in a.pose)
    assert math.degrees(again.installation_yaw) == pytest.approx(5.0, abs=0.1)
